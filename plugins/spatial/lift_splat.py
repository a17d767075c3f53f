"""Lift-splat, the paper's Spatial-Semantic Aggregator (Section III-C, eqs. 4, 9, 10)."""

from __future__ import annotations

from typing import Literal, Self

import torch
from pydantic import Field, PositiveInt, model_validator
from torch import Tensor, nn

from me3bev_cli.api import Calibration, GridSpec, Rig, SpatialOutput, TokenSpec
from me3bev_plugins.spatial.bev_trunk import BEVTrunk
from me3bev_plugins.spatial.frustum import Grid, cells_of, depth_edges, feature_size, frame_cells, frustum
from me3bev_plugins.spatial.frustum import calibration as rig_calibration
from me3bev_plugins.spatial.ground import GroundIndex, Sampling, find_ground, ground_index, ranks, warp
from me3bev_plugins.spatial.precision import ComputeConfig, arrange, computing, laid_out, unhalved
from me3bev_plugins.spatial.splat import SplatIndex, build_index, splat
from me3bev_plugins.spatial.stretch import stretched
from me3bev_plugins.spatial.trunks import Trunk, check_trunk

Range = tuple[float, float]


class LiftSplat(nn.Module):
    """Six calibrated images to a bird's-eye view and its tokens.

    One trunk reads every image; a 1 x 1 convolution gives each feature cell a distribution over depth bins and
    a context vector (eq. 9); the depth-weighted context is summed into the ego-frame grid (eq. 10); a residual
    trunk on the grid gives the feature map and h_BEV (eq. 4).

    The rig's calibration is fixed: where its points lie is found once. Calibration per frame takes the same path over
    tables that are made anew at each call.

    `depth_edges` (bins + 1,) holds the borders of the depth bins, metres along the optical axis; a bin's
    features are put at its middle.
    """

    class Config(ComputeConfig):
        """Settings of the aggregator; the defaults are the paper's full size."""

        trunk: str = Field(
            default="efficientnet_b0", description="`tiny`, a torchvision model, or `timm:` and a model of timm"
        )
        stride: PositiveInt = Field(default=16, description="image pixels per feature cell")
        neck: PositiveInt | None = Field(
            default=128, description="width of the neck that adds the next coarser level; null for none"
        )
        pretrained: bool | str = Field(
            default=False, description="published weights (true) or a file of weights for the trunk"
        )
        depth_range: Range = Field(default=(4.0, 45.0), description="metres along the optical axis")
        depth_bins: PositiveInt = Field(default=41, description="bins of equal length in depth_range")
        channels: PositiveInt = Field(default=64, description="width of the context vectors")
        x_range: Range = Field(default=(-50.0, 50.0), description="metres ahead of the vehicle")
        y_range: Range = Field(default=(-50.0, 50.0), description="metres to its left")
        z_range: Range = Field(default=(-10.0, 10.0), description="metres above the ground")
        cell: float = Field(default=0.5, gt=0, description="side of a grid cell, metres")
        ground_plane: bool = Field(default=True, description="give the images warped to the ground to the grid's trunk")
        ground_samples: PositiveInt = Field(default=2, description="colours of the ground per cell and axis")
        ground_points: PositiveInt = Field(
            default=1, description="points per colour and axis, whose mean it is: so that narrow lines are not missed"
        )
        bev_channels: tuple[PositiveInt, PositiveInt, PositiveInt] = Field(
            default=(48, 96, 128), description="widths of the grid's trunk at 1/2, 1/4 and 1/8 resolution"
        )
        bev_stride: Literal[1, 2] = Field(
            default=2, description="cells of the grid per cell of the feature map; with 1 the trunk is twice as fine"
        )
        bev_blocks: PositiveInt = Field(default=2, description="residual blocks per stage of the grid's trunk")
        token_rows: PositiveInt = Field(default=8, description="tokens ahead to behind")
        token_columns: PositiveInt = Field(default=8, description="tokens left to right")
        token_width: PositiveInt = Field(default=64, description="numbers per token")
        token_focus: float = Field(
            default=1.0, ge=1, le=8, description="how much finer tokens are at the vehicle than on average, per axis"
        )

        @model_validator(mode="after")
        def _check(self) -> Self:
            for name in ("depth_range", "x_range", "y_range", "z_range"):
                low, high = getattr(self, name)
                if not low < high:
                    raise ValueError(f"{name}: {low} must be below {high}")
            if self.depth_range[0] <= 0:
                raise ValueError(f"depth_range: {self.depth_range[0]} must be positive")
            for name in ("x_range", "y_range"):
                cells = (getattr(self, name)[1] - getattr(self, name)[0]) / self.cell
                if abs(cells - round(cells)) > 1e-6 or round(cells) < 8:
                    raise ValueError(
                        f"{name}: {cells:g} cells of {self.cell} m; a whole number of at least 8 is needed"
                    )
            return self

        def grid(self) -> Grid:
            """The bird's-eye grid."""
            return Grid(self.x_range, self.y_range, self.z_range, self.cell)

        def tokens(self) -> TokenSpec:
            """The token grid."""
            return TokenSpec(self.token_rows, self.token_columns, self.token_width, self.token_focus)

        def sampling(self) -> Sampling:
            """How finely the ground is looked at."""
            return Sampling(self.ground_samples, self.ground_points)

    depth_edges: Tensor

    def __init__(self, config: Config, rig: Rig) -> None:
        super().__init__()
        self.output_spec(config, rig)
        self.config, self.rig, self.grid = config, rig, config.grid()
        self.trunk = Trunk(config.trunk, config.stride, config.pretrained, config.neck)
        self.head = nn.Conv2d(self.trunk.channels, config.depth_bins + config.channels, 1)
        ground = 3 * config.ground_samples**2 + 1 if config.ground_plane else 0
        tokens = config.tokens()
        self.bev_trunk = BEVTrunk(
            config.channels + ground, config.bev_channels, config.bev_blocks, tokens, config.bev_stride
        )
        edges = depth_edges(*config.depth_range, config.depth_bins)
        self.register_buffer("depth_edges", edges.float(), persistent=False)
        self._keep_tables()
        arrange(self, config.channels_last)

    @classmethod
    def output_spec(cls, config: Config, rig: Rig) -> TokenSpec:
        """The token grid.

        Raises:
            ValueError: when the cameras differ in size or are too small for the stride, the trunk does not exist
                or has no such stride, or the tokens are finer than the grid's map.
        """
        if len({(camera.height, camera.width) for camera in rig.cameras}) > 1:
            raise ValueError("the cameras' images must all have one size")
        height, width = rig.image_size
        if min(height, width) < config.stride:
            raise ValueError(f"images of {height} x {width} are smaller than the stride {config.stride}")
        check_trunk(config.trunk, config.stride, config.neck)
        grid = config.grid()
        if config.token_rows > grid.rows // 4 or config.token_columns > grid.columns // 4:
            raise ValueError(
                f"{config.token_rows} x {config.token_columns} tokens are more than a quarter of the grid's "
                f"{grid.rows} x {grid.columns} cells per axis"
            )
        return config.tokens()

    @classmethod
    def grid_spec(cls, config: Config, rig: Rig) -> GridSpec:
        """The feature map: the grid's cells, or half as many per axis."""
        grid = config.grid()
        rows, columns = -(-grid.rows // config.bev_stride), -(-grid.columns // config.bev_stride)
        return GridSpec(config.bev_channels[0], rows, columns, config.x_range, config.y_range)

    def _keep_tables(self) -> None:
        """Find each point's cell once; the tables follow the module across devices and stay out of its state."""
        for name, table in self._splat_index(None)._asdict().items():
            self.register_buffer(f"splat_{name}", table, persistent=False)
        if self.config.ground_plane:
            for name, table in ground_index(self.rig, self.grid, self.config.sampling())._asdict().items():
                self.register_buffer(f"ground_{name}", table, persistent=False)

    def point_cells(self, calibration: Calibration | None = None) -> Tensor:
        """The flat grid cell of every (camera, depth bin, feature cell), -1 outside: (N * C, D, h, w).

        N is 1, and the tensor on the CPU, for the rig's own calibration.
        """
        config = self.config
        if calibration is None:
            intrinsics, extrinsics = rig_calibration(self.rig)
        else:
            intrinsics, extrinsics = (part.detach().double().flatten(0, 1) for part in calibration)
        edges = depth_edges(*config.depth_range, config.depth_bins)
        size = feature_size(*self.rig.image_size, config.stride)
        points = frustum(intrinsics, extrinsics, size, config.stride, (edges[1:] + edges[:-1]) / 2)
        return cells_of(points, self.grid)

    def _splat_index(self, calibration: Calibration | None) -> SplatIndex:
        """Of the rig, or of N frames whose grids follow each other."""
        frames = 1 if calibration is None else len(calibration.intrinsics)
        count = self.grid.rows * self.grid.columns
        return build_index(frame_cells(self.point_cells(calibration), frames, count), frames * count)

    def forward(
        self, images: Tensor, calibration: Calibration | None = None, *, stretch: Tensor | None = None
    ) -> SpatialOutput:
        """Images to tokens, depth, and the feature map (as `grid_spec` tells), all in the images' type.

        Args:
            images: (N, C, 3, H, W), ImageNet-normalised.
            calibration: of each frame, on the images' device; None for the rig's.
            stretch: (N, 2, max(X, Y)), where the grid's rows and columns are taken from, from -1 to 1.
        """
        count, config = len(images), self.config
        self._check(images, calibration)
        flat = laid_out(images.flatten(0, 1), config.channels_last)
        with computing(config.precision, images.device):
            lifted = self.head(self.trunk(flat))
            logits, context = lifted.unflatten(0, (count, -1)).split([config.depth_bins, config.channels], dim=2)
            wide = torch.promote_types(logits.dtype, torch.float32)
            cells = self.pool(logits.to(wide).softmax(2), context, calibration)
            if config.ground_plane:
                cells = torch.cat([cells, self._ground(flat.to(cells.dtype), calibration)], dim=2)
            bev = cells.view(count, self.grid.rows, self.grid.columns, -1).permute(0, 3, 1, 2)
            if stretch is not None:
                bev = stretched(bev, stretch)
            tokens, grid = self.bev_trunk(laid_out(bev, config.channels_last))
        return SpatialOutput(*(part.to(images.dtype) for part in (tokens, grid, logits)))

    def pool(self, probability: Tensor, context: Tensor, calibration: Calibration | None = None) -> Tensor:
        """The splat (eq. 10): depth-weighted context summed into the grid, in float32 or wider.

        Args:
            probability: (N, C, D, h, w), each feature cell's distribution over depth.
            context: (N, C, channels, h, w).
            calibration: of each frame; None for the rig's.

        Returns:
            (N, X * Y, channels).
        """
        count, channels = len(context), context.shape[2]
        with unhalved(context.device):
            vectors = context.to(probability.dtype).permute(0, 1, 3, 4, 2)
            if calibration is None:
                index = SplatIndex(*(self.get_buffer(f"splat_{name}") for name in SplatIndex._fields))
                return splat(probability.flatten(1), vectors.reshape(count, -1, channels), index)
            # One large frame whose cameras are those of all frames.
            index = self._splat_index(calibration)
            cells = splat(probability.reshape(1, -1), vectors.reshape(1, -1, channels), index)
            return cells.view(count, -1, channels)

    def _ground(self, images: Tensor, calibration: Calibration | None) -> Tensor:
        """Images (N * C, 3, H, W) warped to the ground: (N, X * Y, 3 * samples^2 + 1)."""
        pixels = images.permute(0, 2, 3, 1).reshape(len(images) // len(self.rig.cameras), -1, 3)
        if calibration is None:
            return warp(pixels, GroundIndex(*(self.get_buffer(f"ground_{name}") for name in GroundIndex._fields)))
        # Frame by frame: the search holds every ground point in every camera's frame.
        order, size, sampling = ranks(self.rig).to(images.device), self.rig.image_size, self.config.sampling()
        intrinsics, extrinsics = (part.detach().double() for part in calibration)
        views = [
            warp(frame[None], find_ground(k, e, order, size, self.grid, sampling))
            for frame, k, e in zip(pixels, intrinsics, extrinsics, strict=True)
        ]
        return torch.cat(views)

    def _check(self, images: Tensor, calibration: Calibration | None) -> None:
        """Shapes that would otherwise be gathered from wrongly, without an error."""
        cameras = len(self.rig.cameras)
        expected = (len(images), cameras, 3, *self.rig.image_size)
        if tuple(images.shape) != expected:
            raise ValueError(f"images of shape {tuple(images.shape)}; this rig gives {('N', *expected[1:])}")
        for name, part, side in zip(Calibration._fields, calibration or (), (3, 4), strict=False):
            if tuple(part.shape) != (len(images), cameras, side, side):
                wanted = (len(images), cameras, side, side)
                raise ValueError(f"{name} of shape {tuple(part.shape)}; these images need {wanted}")

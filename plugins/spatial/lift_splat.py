"""Lift-splat, the paper's Spatial-Semantic Aggregator (Section III-C, eqs. 4, 9, 10)."""

from __future__ import annotations

from typing import Self

import torch
from pydantic import Field, PositiveInt, model_validator
from torch import Tensor, nn

from me3bev_cli.api import PluginConfig, Rig, SpatialOutput, TokenSpec
from me3bev_plugins.spatial.bev_trunk import BEVTrunk
from me3bev_plugins.spatial.frustum import Grid, calibration, cells_of, depth_edges, feature_size, frustum
from me3bev_plugins.spatial.ground import GroundIndex, ground_index, warp
from me3bev_plugins.spatial.splat import SplatIndex, build_index, splat
from me3bev_plugins.spatial.trunks import Trunk, check_trunk

Range = tuple[float, float]


class LiftSplat(nn.Module):
    """Six calibrated images to a bird's-eye view and its tokens.

    One trunk reads every image; a 1 x 1 convolution gives each feature cell a distribution over depth bins and
    a context vector (eq. 9); the depth-weighted context is summed into the ego-frame grid (eq. 10); a residual
    trunk on the grid gives the feature map and h_BEV (eq. 4).

    `depth_edges` (bins + 1,) holds the borders of the depth bins, metres along the optical axis; a bin's
    features are put at its middle.
    """

    class Config(PluginConfig):
        """Settings of the aggregator; the defaults are the paper's full size."""

        trunk: str = Field(default="efficientnet_b0", description="`tiny` or a torchvision model")
        stride: PositiveInt = Field(default=16, description="image pixels per feature cell")
        neck: PositiveInt | None = Field(
            default=128, description="width of the neck that adds the next coarser level; null for none"
        )
        pretrained: bool | str = Field(
            default=False, description="torchvision's weights (true) or a file of weights for the trunk"
        )
        depth_range: Range = Field(default=(4.0, 45.0), description="metres along the optical axis")
        depth_bins: PositiveInt = Field(default=41, description="bins of equal length in depth_range")
        channels: PositiveInt = Field(default=64, description="width of the context vectors")
        x_range: Range = Field(default=(-50.0, 50.0), description="metres ahead of the vehicle")
        y_range: Range = Field(default=(-50.0, 50.0), description="metres to its left")
        z_range: Range = Field(default=(-10.0, 10.0), description="metres above the ground")
        cell: float = Field(default=0.5, gt=0, description="side of a grid cell, metres")
        ground_plane: bool = Field(default=True, description="give the images warped to the ground to the grid's trunk")
        ground_samples: PositiveInt = Field(default=2, description="ground points per cell and axis")
        bev_channels: tuple[PositiveInt, PositiveInt, PositiveInt] = Field(
            default=(48, 96, 128), description="widths of the grid's trunk at 1/2, 1/4 and 1/8 resolution"
        )
        bev_blocks: PositiveInt = Field(default=2, description="residual blocks per stage of the grid's trunk")
        token_rows: PositiveInt = Field(default=8, description="tokens ahead to behind")
        token_columns: PositiveInt = Field(default=8, description="tokens left to right")
        token_width: PositiveInt = Field(default=64, description="numbers per token")

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

    depth_edges: Tensor

    def __init__(self, config: Config, rig: Rig) -> None:
        super().__init__()
        self.output_spec(config, rig)
        self.config, self.grid = config, config.grid()
        self.trunk = Trunk(config.trunk, config.stride, config.pretrained, config.neck)
        self.head = nn.Conv2d(self.trunk.channels, config.depth_bins + config.channels, 1)
        ground = 3 * config.ground_samples**2 + 1 if config.ground_plane else 0
        tokens = (config.token_rows, config.token_columns, config.token_width)
        self.bev_trunk = BEVTrunk(config.channels + ground, config.bev_channels, config.bev_blocks, tokens)
        edges = depth_edges(*config.depth_range, config.depth_bins)
        self.register_buffer("depth_edges", edges.float(), persistent=False)
        self._set_calibration(rig, edges)

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
        return TokenSpec(config.token_rows, config.token_columns, config.token_width)

    def _set_calibration(self, rig: Rig, edges: Tensor) -> None:
        """Find each point's cell once; the tables follow the module across devices and stay out of its state."""
        config = self.config
        size = feature_size(*rig.image_size, config.stride)
        middles = (edges[1:] + edges[:-1]) / 2
        cells = cells_of(frustum(*calibration(rig), size, config.stride, middles), self.grid)
        index = build_index(cells, self.grid.rows * self.grid.columns)
        for name, table in index._asdict().items():
            self.register_buffer(f"splat_{name}", table, persistent=False)
        if config.ground_plane:
            for name, table in ground_index(rig, self.grid, config.ground_samples)._asdict().items():
                self.register_buffer(f"ground_{name}", table, persistent=False)

    def forward(self, images: Tensor) -> SpatialOutput:
        """Images (N, C, 3, H, W), ImageNet-normalised -> tokens, depth, and the feature map (half the grid's cells)."""
        count, config = len(images), self.config
        # Channels innermost suits the convolutions and makes every pixel a row that can be gathered.
        images = images.flatten(0, 1).contiguous(memory_format=torch.channels_last)
        lifted = self.head(self.trunk(images))
        logits, context = lifted.split([config.depth_bins, config.channels], dim=1)
        cells = self._pool(logits.unflatten(0, (count, -1)), context)
        if config.ground_plane:
            index = GroundIndex(*(self.get_buffer(f"ground_{name}") for name in GroundIndex._fields))
            pixels = images.permute(0, 2, 3, 1).reshape(count, -1, 3)
            cells = torch.cat([cells, warp(pixels.to(cells.dtype), index)], dim=2)
        bev = cells.view(count, self.grid.rows, self.grid.columns, -1).permute(0, 3, 1, 2)
        tokens, grid = self.bev_trunk(bev)
        return SpatialOutput(tokens, grid, logits.unflatten(0, (count, -1)))

    def _pool(self, logits: Tensor, context: Tensor) -> Tensor:
        """Logits (N, C, D, h, w) and context (N * C, channels, h, w) to cells (N, X * Y, channels)."""
        index = SplatIndex(*(self.get_buffer(f"splat_{name}") for name in SplatIndex._fields))
        with torch.autocast(logits.device.type, enabled=False):
            wide = torch.promote_types(logits.dtype, torch.float32)
            probability = logits.to(wide).softmax(2).flatten(1)
            vectors = context.to(wide).permute(0, 2, 3, 1).reshape(len(logits), -1, self.config.channels)
            return splat(probability, vectors, index)

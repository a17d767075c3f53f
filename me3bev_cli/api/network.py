"""The contracts of the three stages of the network: spatial, temporal, fusion."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, Protocol

from me3bev_cli.api.base import PluginConfig
from me3bev_cli.api.camera import Rig

if TYPE_CHECKING:
    from torch import Tensor


class TokenSpec(NamedTuple):
    """What a spatial plugin gives per frame: a grid of `rows` x `columns` tokens of `width` numbers."""

    rows: int
    columns: int
    width: int
    focus: float = 1.0
    """How much finer tokens are in the middle of the map than on average, per axis; 1: they are all of one size."""

    def place(self, at: Any) -> Any:
        """Where a point of the grid of tokens lies on the map, both from -1 to 1 along an axis; numbers or arrays."""
        return at / self.focus + (1 - 1 / self.focus) * at**3

    @property
    def total(self) -> int:
        """Number of tokens, K."""
        return self.rows * self.columns


class GridSpec(NamedTuple):
    """The bird's-eye feature map that a spatial plugin gives per frame: `rows` x `columns` cells of `channels`."""

    channels: int
    rows: int
    columns: int
    x_range: tuple[float, float]
    """Metres ahead of the ego, least and greatest."""
    y_range: tuple[float, float]
    """Metres to its left."""


class SpatialOutput(NamedTuple):
    """What a spatial plugin returns."""

    tokens: Tensor
    """h_BEV, (N, K, D)."""
    grid: Tensor | None = None
    """The BEV feature map (N, channels, X, Y), row 0 farthest ahead, column 0 farthest left; None if there is none."""
    depth_logits: Tensor | None = None
    """(N, C, bins, h, w) before the softmax over bins; None if depth is not predicted."""


class Calibration(NamedTuple):
    """Calibration per frame, where it differs from the rig's: jittered, or of several vehicles."""

    intrinsics: Tensor
    """(N, C, 3, 3), camera frame -> pixels, as `Camera.intrinsics`."""
    extrinsics: Tensor
    """(N, C, 4, 4), camera frame -> ego frame, as `Camera.camera_to_ego`."""


class SpatialPlugin(Protocol):
    """Images of one time step to h_BEV (eq. 4). Frames are independent: no state, no mixing over N.

    `forward` may take a second, optional argument `calibration: Calibration | None = None`, on the images' device;
    without it the calibration is the rig's. A plugin whose `forward` has no such argument cannot be given one.

    It may take another one by keyword, `stretch: Tensor | None = None`, (N, 2, X): for each row and column of the grid,
    at their centres, the place where it is taken from, along x and y of `torch.nn.functional.grid_sample` (rows as y,
    without `align_corners`), before anything on the grid is computed. A perception stage learns from grids that are
    stretched so, together with their truth.

    A plugin that gives a `grid` has a class method `grid_spec(config, rig) -> GridSpec`, without allocating: it can be
    learned by segmentation. One that gives `depth_logits` has `depth_edges`, a tensor (bins + 1,) of the borders of its
    depth bins, metres along the optical axis.
    """

    Config: ClassVar[type[PluginConfig]]

    def __init__(self, config: Any, rig: Rig) -> None: ...

    @classmethod
    def output_spec(cls, config: Any, rig: Rig) -> TokenSpec:
        """The token grid for this config and rig, without allocating. Raises ValueError if they do not fit."""
        ...

    def forward(self, images: Tensor) -> SpatialOutput:
        """Images (N, C, 3, H, W), float, ImageNet-normalised."""
        ...


State = Any
"""A plain tree (dict, tuple, list) of tensors, each with the batch as first axis."""


class TemporalPlugin(Protocol):
    """Memory over time (eqs. 5-7, 11-13).

    Stepping one frame at a time with the carried state equals the whole sequence at once. Where
    `starts[b, t]` is true the memory of b is cleared before frame t is read.

    A memory that looks back at a fixed number of frames has it as `context` in its config, and parameters that do not
    depend on it: `me3bev bench-latency` sets it to the context that it times.
    """

    Config: ClassVar[type[PluginConfig]]

    def __init__(self, config: Any, width: int) -> None: ...

    @classmethod
    def check(cls, config: Any, width: int) -> None:
        """Raises ValueError if the config does not fit vectors of `width` numbers."""
        ...

    def initial_state(self, batch: int) -> State:
        """The empty memory for `batch` sequences, on the module's device and in its dtype."""
        ...

    def forward(self, x: Tensor, state: State, starts: Tensor) -> tuple[Tensor, State]:
        """`x` (B, T, D), `starts` (B, T) bool -> `y` (B, T, D) and the state after the last frame."""
        ...


class FusionPlugin(Protocol):
    """One vector per modality to one vector (eq. 8). Modalities come in a fixed order: bev, vr, nav."""

    Config: ClassVar[type[PluginConfig]]

    def __init__(self, config: Any, widths: Mapping[str, int]) -> None: ...

    @classmethod
    def output_width(cls, config: Any, widths: Mapping[str, int]) -> int:
        """Width of the result, without allocating. Raises ValueError if the widths do not fit."""
        ...

    def forward(self, features: Mapping[str, Tensor]) -> Tensor:
        """Each (B, D_m) -> (B, D)."""
        ...

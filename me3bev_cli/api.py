"""All that a plugin author needs: the specs that stages exchange and one contract per stage.

A plugin is a class registered through an entry point of one of four groups:

    me3bev.spatial     images -> a small grid of tokens        (a torch.nn.Module)
    me3bev.temporal    a sequence of vectors -> the same, with memory (a torch.nn.Module)
    me3bev.fusion      one vector per modality -> one vector   (a torch.nn.Module)
    me3bev.simulator   maps, cameras and a gymnasium environment

Every plugin class has a `Config`, a pydantic model derived from `PluginConfig`; a recipe's keys beside
`name` are its fields. Sizes are agreed on by class methods, before anything is allocated.

Shape letters: B batch, T time, N frames, C cameras, H x W image, K tokens, D width, X x Y grid cells.
Frames: *world* x east, y north, z up; *ego* x forward, y left, z up, origin on the ground under the
vehicle's centre; *camera* x right, y down, z along the optical axis. Metres, seconds, radians; headings
counter-clockwise from x. This module imports pydantic only; torch and gymnasium appear in types.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, ClassVar, Literal, NamedTuple, Protocol, TypedDict

from pydantic import BaseModel, ConfigDict, Field

if TYPE_CHECKING:
    import gymnasium
    from torch import Tensor

GROUPS = {
    "spatial": "me3bev.spatial",
    "temporal": "me3bev.temporal",
    "fusion": "me3bev.fusion",
    "simulator": "me3bev.simulator",
}
"""Kind of plugin -> entry-point group."""

ROAD_WIDTH, VEHICLE_WIDTH, NAVIGATION_WIDTH = 9, 4, 5
"""Widths of R, V and N (Section 3.1)."""

LIGHT_STATES = ("none", "red", "amber", "green", "off")
"""Order of the one-hot in R[4:9]."""

CAMERA_NAMES = ("front_left", "front", "front_right", "back_left", "back", "back_right")
"""The surround rig, in the order of the image tensor's first axis."""

BEV_CLASSES = (
    "other",
    "road",
    "lane_marking",
    "crosswalk",
    "sidewalk",
    "building",
    "vehicle",
    "pedestrian",
)
"""Classes of the semantic truth, by index; `crosswalk` includes stop lines."""


class PluginConfig(BaseModel):
    """Base of every plugin's configuration: unknown keys are refused, values do not change."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class NoConfig(PluginConfig):
    """For a plugin without settings."""


Matrix = tuple[tuple[float, ...], ...]


class Camera(BaseModel):
    """One calibrated pinhole camera.

    Pixel (row v, column u) has its centre at (u + 0.5, v + 0.5). Mounted at `position` in the ego frame
    and turned by `yaw` (about z, left positive), then `pitch` (nose up positive).
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    name: str
    width: int = Field(gt=0, description="pixels")
    height: int = Field(gt=0, description="pixels")
    fx: float = Field(gt=0, description="focal length, pixels")
    fy: float = Field(gt=0, description="focal length, pixels")
    cx: float = Field(description="principal point, pixels")
    cy: float = Field(description="principal point, pixels")
    position: tuple[float, float, float] = Field(description="in the ego frame, metres")
    yaw: float = Field(description="radians, left positive")
    pitch: float = Field(default=0.0, description="radians, up positive")

    def intrinsics(self) -> Matrix:
        """K (3 x 3): camera frame -> pixels."""
        return ((self.fx, 0.0, self.cx), (0.0, self.fy, self.cy), (0.0, 0.0, 1.0))

    def camera_to_ego(self) -> Matrix:
        """The extrinsics (4 x 4): camera frame -> ego frame."""
        sy, cy = math.sin(self.yaw), math.cos(self.yaw)
        sp, cp = math.sin(self.pitch), math.cos(self.pitch)
        right = (sy, -cy, 0.0)
        down = (cy * sp, sy * sp, -cp)
        forward = (cy * cp, sy * cp, sp)
        rows = zip(right, down, forward, self.position, strict=True)
        return (*(tuple(row) for row in rows), (0.0, 0.0, 0.0, 1.0))


class Rig(BaseModel):
    """The cameras that an observation holds, in the order of the image tensor. All of one size."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    cameras: tuple[Camera, ...] = Field(min_length=1)

    @property
    def image_size(self) -> tuple[int, int]:
        """(H, W), pixels."""
        return self.cameras[0].height, self.cameras[0].width


class TokenSpec(NamedTuple):
    """What a spatial plugin gives per frame: a grid of `rows` x `columns` tokens of `width` numbers."""

    rows: int
    columns: int
    width: int

    @property
    def total(self) -> int:
        """Number of tokens, K."""
        return self.rows * self.columns


class SpatialOutput(NamedTuple):
    """What a spatial plugin returns."""

    tokens: Tensor
    """h_BEV, (N, K, D)."""
    grid: Tensor | None = None
    """The BEV feature map (N, channels, X, Y), row 0 farthest ahead, column 0 farthest left; None if there is none."""
    depth_logits: Tensor | None = None
    """(N, C, bins, h, w) before the softmax over bins; None if depth is not predicted."""


class SpatialPlugin(Protocol):
    """Images of one time step to h_BEV (eq. 4). Frames are independent: no state, no mixing over N."""

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


class ObservationConfig(BaseModel):
    """What the policy is given at each step (Section 3.1)."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    cameras: tuple[str, ...] = Field(
        default=CAMERA_NAMES, min_length=1, description="which cameras of the surround rig, in order"
    )
    height: int = Field(default=128, ge=16, le=2048, description="image height, pixels")
    width: int = Field(default=352, ge=16, le=4096, description="image width, pixels")
    navigation: Literal["distance", "offset"] = Field(
        default="distance",
        description=(
            "N(5). distance: metres to each of the next five waypoints (the baseline's). offset: the next "
            "waypoints in the ego frame: y of the 1st, x and y of the 3rd, x and y of the 5th, metres"
        ),
    )
    waypoint_spacing: float = Field(default=5.0, gt=0.2, le=50, description="metres between waypoints")


class StepRecord(TypedDict):
    """What an environment reports of each step in `info["record"]`; every metric is computed from these."""

    time: float
    """Seconds since the reset, after the step."""
    x: float
    y: float
    heading: float
    speed: float
    """m/s along the heading."""
    acceleration: float
    """m/s^2 along the heading."""
    lateral_acceleration: float
    """m/s^2, left positive."""
    yaw_rate: float
    """rad/s."""
    steering: float
    longitudinal: float
    """The action as applied, each in [-1, 1]."""
    waypoint_x: float
    waypoint_y: float
    """The next waypoint at the time of the step, world frame."""
    similarity: float
    """Cosine between heading and the direction to the next waypoint."""
    waypoint_distance: float
    """Metres to the next waypoint."""
    speed_limit: float
    """m/s."""
    traffic_speed: float
    """Mean speed of the other vehicles within 50 m, m/s; NaN when there are none."""
    route_done: float
    route_length: float
    """Metres along the route."""
    off_route: float
    """Distance from the route's centre line, metres."""
    off_road: bool
    collision: str
    """"" or what was hit in this step: vehicle, pedestrian, static."""
    at_fault: bool
    """True when the ego's front ran into the other."""
    red_light: bool
    """True in the step in which the ego crossed a stop line on red."""
    stop_sign: bool
    """True in the step in which the ego ran a stop sign."""
    reward: float


class SimulatorPlugin(Protocol):
    """A world to drive in. An instance is cheap: maps are opened when an environment is made."""

    Config: ClassVar[type[PluginConfig]]

    def __init__(self, config: Any) -> None: ...

    def maps(self) -> tuple[str, ...]:
        """Names of the maps that can be driven."""
        ...

    def densities(self) -> tuple[str, ...]:
        """Names of the traffic densities."""
        ...

    def rig(self, observation: ObservationConfig) -> Rig:
        """Calibration of the chosen cameras. Raises UserError for a camera that does not exist."""
        ...

    def make_env(
        self, observation: ObservationConfig, *, map: str, density: str, images: bool = True
    ) -> gymnasium.Env[Any, Any]:
        """A gymnasium environment.

        Observations are a dict: `images` (C, 3, H, W) uint8 (absent when `images` is false: for drivers that
        do not look), `road` (9,), `vehicle` (4,), `navigation` (5,) float32. Actions are (steering,
        longitudinal) in [-1, 1]; positive steering turns left. `info["record"]` holds a `StepRecord`.
        The unwrapped environment has `autopilot() -> action`, a rule-based driver's choice for the current
        state, `pose() -> (x, y, heading)` of the ego, and `bev_semantics() -> (200, 200) uint8`, classes as
        `BEV_CLASSES`, row 0 farthest ahead, column 0 farthest left, 0.5 m per cell.
        """
        ...

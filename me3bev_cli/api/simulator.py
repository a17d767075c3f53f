"""The contract of a simulator: what its environments give, and what it may offer beside them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, ClassVar, Literal, NamedTuple, Protocol, TypedDict

from me3bev_cli.api.base import PluginConfig
from me3bev_cli.api.camera import ObservationConfig, Rig

if TYPE_CHECKING:
    from pathlib import Path

    import gymnasium
    import numpy as np
    from numpy.typing import NDArray

ROAD_WIDTH, VEHICLE_WIDTH, NAVIGATION_WIDTH = 9, 4, 5
"""Widths of R, V and N (Section 3.1)."""

LIGHT_STATES = ("none", "red", "amber", "green", "off")
"""Order of the one-hot in R[4:9]."""

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
    background_speed: float
    """Mean speed of all other vehicles on the map, m/s; NaN when there are none."""
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
    contact: str
    """"" or where on the ego the contact is: front, side, rear."""
    red_light: bool
    """True in the step in which the ego crossed a stop line on red."""
    red_met: bool
    """True in the step in which a light ahead of the ego, at most 20 m before the stop line of its own lane, is first
    seen red; once until its line is crossed. A light that is run has been met, in that step at the latest."""
    stop_sign: bool
    """True in the step in which the ego ran a stop sign."""
    lane_departure: bool
    """True in the step in which the ego's centre left its lane for the opposite direction or for no road at all; a
    change to a lane of the same direction is none, nor is anything inside a junction."""
    reward: float


ACTOR_KINDS = ("car", "van", "truck", "motorcycle", "pedestrian")
"""What `Actors.kinds` counts through."""


class Actors(NamedTuple):
    """The A other road users at one instant, world frame."""

    boxes: NDArray[np.float64]
    """(A, 7) x, y, z of the middle of the underside, heading, length, width, height."""
    kinds: NDArray[np.int64]
    """(A,) of `ACTOR_KINDS`, by index."""
    speeds: NDArray[np.float64]
    """(A,) m/s along the heading."""


class View(NamedTuple):
    """What the cameras see from one place, and the truth of it."""

    images: Any
    """(C, 3, H, W) uint8"""
    depth: Any
    """(C, H, W) float32, metres along the optical axis, inf where nothing is."""
    classes: Any
    """(C, H, W) uint8, as `BEV_CLASSES`."""
    bev: Any
    """(200, 200) uint8, as `bev_semantics()`."""


class MapEntry(NamedTuple):
    """One map of a simulator, as `me3bev maps list` shows it."""

    name: str
    source: Literal["built-in", "imported"]
    description: str


class FactRow(NamedTuple):
    """One measured fact of a map, beside what it should be."""

    key: str
    value: float
    unit: str
    reference: float | None = None
    """None: nothing to compare with."""
    tolerance: str = ""
    """For people, as "15 %" or "1 or 15 %"."""
    within: bool | None = None


class MapLibrary(Protocol):
    """What a simulator with maps of its own may offer beside `SimulatorPlugin`: `me3bev maps` works with it."""

    def map_entries(self) -> tuple[MapEntry, ...]:
        """Every map that can be driven, the built-in ones first. Opens none of them."""
        ...

    def import_map(self, source: Path, name: str | None, replace: bool) -> MapEntry:
        """Check a map file, and keep it under a name (None: the file's). Raises UserError for what cannot be used."""
        ...

    def remove_map(self, name: str) -> None:
        """Forget an imported map. Raises UserError for a built-in or unknown one."""
        ...

    def map_digest(self, name: str) -> str | None:
        """Letters that are others when an imported map is; None for a built-in one, which the code decides."""
        ...

    def map_facts(self, name: str) -> tuple[FactRow, ...]:
        """What is measured on a map. Raises UserError for an unknown one."""
        ...

    def map_plan(self, name: str, seed: int) -> Any:
        """A plan for people with one route drawn by the seed, (H, W, 3) uint8. Raises UserError for an unknown map."""
        ...


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

    def weathers(self) -> tuple[str, ...]:
        """Names of the kinds of weather and light, the default one first."""
        ...

    def rig(self, observation: ObservationConfig) -> Rig:
        """Calibration of the chosen cameras. Raises UserError for a camera that does not exist."""
        ...

    def make_env(
        self,
        observation: ObservationConfig,
        *,
        map: str,
        density: str,
        weather: Sequence[str] | None = None,
        images: bool = True,
    ) -> gymnasium.Env[Any, Any]:
        """A gymnasium environment. Each episode draws one of `weather` by its seed; None is the default weather.

        A seed has the same route and traffic in any weather. An unknown map, density or weather raises UserError.
        Observations are a dict: `images` (C, 3, H, W) uint8 (absent when `images` is false: for drivers that
        do not look), `road` (9,), `vehicle` (4,), `navigation` (5,) float32. Actions are (steering,
        longitudinal) in [-1, 1]; positive steering turns left. `info["record"]` holds a `StepRecord`,
        `info["weather"]` the episode's weather.
        The unwrapped environment has `autopilot() -> action`, a rule-based driver's choice for the current
        state, `pose() -> (x, y, heading)` of the ego, and `bev_semantics() -> (200, 200) uint8`, classes as
        `BEV_CLASSES`, row 0 farthest ahead, column 0 farthest left, 0.5 m per cell,
        `camera_truth() -> (depth (C, H, W) float32, classes (C, H, W) uint8)`, of every pixel the metres along the
        optical axis, inf where nothing is, and the class as `BEV_CLASSES`, and
        `plan_view(size) -> (size, size, 3) uint8`, the surroundings from above with the route, for people.
        It may have `actors() -> Actors`, the others now, and `route_line() -> (P, 3)`, the route's centre line,
        world frame, metres: logs keep them for viewers.
        And it may have `look_from(ahead, left, turn, scale, dress) -> View`, what would be seen from another place on
        the ground, metres from the ego and radians to its left, in a world `scale` times as large, whether or not
        observations hold images: perception learned from the ego's own lane alone knows no other town's roads. A
        `dress` from 1 to the environment's `dresses` is another look of the same streets (other sidewalks, lines,
        houses, trees), 0 their own; an environment without `dresses` is asked for its own only.
        """
        ...

"""`Town`: the joint of the simulator. Everything that drives, draws or measures works from it.

World frame: x east, y north, z up, metres; headings counter-clockwise from x, radians. Right-hand traffic.
A town is immutable once made and is shared by every environment of a process.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]

Marking = Literal["none", "solid", "broken", "yellow_solid", "yellow_broken"]
Turn = Literal["straight", "left", "right", "uturn"]
Control = Literal["signal", "stop", "yield", "none"]


@dataclass(frozen=True, eq=False)
class Lane:
    """One directed lane, from one end of a block to the other or across a junction.

    `points` (P, 3) is the centre line in driving direction, at most 1 m apart, first and last exactly at the
    lane's ends (joined lanes share them). `left` and `right` are neighbours of the same direction that may be
    changed to. A lane inside a junction (a connector) names it; other lanes have `junction` None.
    """

    id: int
    points: Floats
    width: float
    limit: float
    """Speed limit, m/s."""
    successors: tuple[int, ...] = ()
    predecessors: tuple[int, ...] = ()
    left: int | None = None
    right: int | None = None
    junction: int | None = None
    turn: Turn = "straight"
    left_marking: Marking = "none"
    right_marking: Marking = "none"
    highway: bool = False
    """True on motorways and their ramps: no pedestrians, no crossings."""

    @cached_property
    def s(self) -> Floats:
        """Arc length in the plane at each point (P,), metres."""
        steps = np.hypot(*np.diff(self.points[:, :2], axis=0).T)
        return np.concatenate([[0.0], np.cumsum(steps)])

    @cached_property
    def length(self) -> float:
        """Metres."""
        return float(self.s[-1])

    @cached_property
    def heading(self) -> Floats:
        """Direction of travel at each point (P,), radians, unwrapped along the lane."""
        tangent = np.gradient(self.points[:, :2], self.s, axis=0)
        return np.unwrap(np.arctan2(tangent[:, 1], tangent[:, 0]))


@dataclass(frozen=True, eq=False)
class Junction:
    """Where lanes meet. `control` is how right of way is settled; `minor` lanes give way (stop or yield)."""

    id: int
    connectors: tuple[int, ...]
    incoming: tuple[int, ...]
    outgoing: tuple[int, ...]
    control: Control
    arms: int
    minor: frozenset[int] = frozenset()
    """Incoming lanes that face a stop or yield sign; empty for signals and for all-equal junctions."""
    centre: tuple[float, float] = (0.0, 0.0)


@dataclass(frozen=True, eq=False)
class Signal:
    """A traffic light: one head, the incoming lanes it governs, and its phase group within the junction.

    Groups of one junction are green in turn. The stop line is at the end of each governed lane.
    """

    id: int
    junction: int
    lanes: tuple[int, ...]
    group: int
    position: tuple[float, float, float]
    """Of the head, in the world."""
    heading: float
    """Direction in which traffic that obeys it drives."""


@dataclass(frozen=True, eq=False)
class Sign:
    """A stop or yield sign at the end of a lane."""

    kind: Literal["stop", "yield"]
    lane: int
    position: tuple[float, float, float]
    heading: float
    """Direction in which traffic that obeys it drives."""


@dataclass(frozen=True, eq=False)
class Crosswalk:
    """A marked crossing: corners (4, 2) in order; pedestrians walk from the middle of edge 0-1 to that of edge 2-3.

    `lanes` are the lanes it crosses, with the arc length at which each meets it.
    """

    corners: Floats
    lanes: tuple[tuple[int, float], ...]
    junction: int | None


@dataclass(frozen=True, eq=False)
class Sidewalk:
    """A walkable strip: centre line (P, 2) and width, metres. `paved` is false for a rural roadside."""

    points: Floats
    width: float
    paved: bool = True


@dataclass(frozen=True, eq=False)
class Building:
    """A box on the ground: centre, size along its own axes, heading, height, colour (r, g, b) and a style number."""

    centre: tuple[float, float]
    size: tuple[float, float]
    heading: float
    height: float
    colour: tuple[int, int, int]
    style: int = 0


@dataclass(frozen=True, eq=False)
class Prop:
    """A thing beside the road: a tree or a pole."""

    kind: Literal["tree", "pole"]
    position: tuple[float, float]
    height: float
    radius: float


@dataclass(frozen=True, eq=False)
class LaneArrays:
    """All lanes packed for compiled code. Points of lane i are `xyz[start[i]:start[i + 1]]`."""

    start: Ints
    """(L + 1,)"""
    xyz: Floats
    """(P, 3)"""
    s: Floats
    """(P,) arc length within the lane."""
    heading: Floats
    """(P,)"""
    length: Floats
    """(L,)"""
    width: Floats
    limit: Floats
    left: Ints
    """(L,) neighbour or -1."""
    right: Ints
    junction: Ints
    """(L,) junction or -1."""
    successor_start: Ints
    """(L + 1,) into `successor`."""
    successor: Ints


@dataclass(frozen=True, eq=False)
class Town:
    """A drivable town. Ids of lanes, junctions and signals equal their position in the tuples."""

    name: str
    lanes: tuple[Lane, ...]
    junctions: tuple[Junction, ...]
    signals: tuple[Signal, ...] = ()
    signs: tuple[Sign, ...] = ()
    crosswalks: tuple[Crosswalk, ...] = ()
    sidewalks: tuple[Sidewalk, ...] = ()
    buildings: tuple[Building, ...] = ()
    props: tuple[Prop, ...] = ()
    description: str = ""
    surfaces: tuple[Floats, ...] = field(default=())
    """Polygons (P, 2) of asphalt beyond the lanes themselves: junction floors, gutters, shoulders."""

    @cached_property
    def bounds(self) -> tuple[float, float, float, float]:
        """(x low, y low, x high, y high) of the lane centres, metres."""
        xy = self.arrays.xyz[:, :2]
        low, high = xy.min(0), xy.max(0)
        return float(low[0]), float(low[1]), float(high[0]), float(high[1])

    @cached_property
    def arrays(self) -> LaneArrays:
        """The lanes as flat arrays."""
        count = len(self.lanes)
        sizes = [len(lane.points) for lane in self.lanes]
        links = [len(lane.successors) for lane in self.lanes]

        def index(values: list[int | None]) -> Ints:
            return np.array([-1 if v is None else v for v in values], np.int32)

        return LaneArrays(
            start=np.concatenate([[0], np.cumsum(sizes)]).astype(np.int32),
            xyz=np.ascontiguousarray(np.concatenate([lane.points for lane in self.lanes]), np.float64),
            s=np.concatenate([lane.s for lane in self.lanes]),
            heading=np.concatenate([lane.heading for lane in self.lanes]),
            length=np.array([lane.length for lane in self.lanes]),
            width=np.array([lane.width for lane in self.lanes], np.float64),
            limit=np.array([lane.limit for lane in self.lanes], np.float64),
            left=index([lane.left for lane in self.lanes]),
            right=index([lane.right for lane in self.lanes]),
            junction=index([lane.junction for lane in self.lanes]),
            successor_start=np.concatenate([[0], np.cumsum(links)]).astype(np.int32)
            if count
            else np.zeros(1, np.int32),
            successor=np.array([n for lane in self.lanes for n in lane.successors], np.int32),
        )

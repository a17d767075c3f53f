"""What a layout is made of: streets with a cross-section, and the nodes where they meet.

Right-hand traffic. "Forward" lanes drive along a street's path, "backward" lanes against it. Units: metres, km/h.
"""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal

from me3bev_plugins.simulator.highway.towns.geometry import Path, Point, crossing

Control = Literal["signal", "stop", "yield", "none"]
LaneKind = Literal["driving", "bidirectional", "median", "shoulder", "sidewalk"]


@dataclass(frozen=True)
class LaneSpec:
    """One strip of a cross-section: OpenDRIVE lane id, kind, width, and its centre's offset left of the path."""

    id: int
    kind: LaneKind
    width: float
    offset: float


@dataclass(frozen=True)
class Section:
    """A cross-section, the same all along a street. With `backward` 0 the lanes are centred on the path."""

    forward: int = 1
    backward: int = 1
    width: float = 3.5
    turn_lane: float = 0.0
    """Width of a two-way turn lane in the middle."""
    median: float = 0.0
    """Width of a raised strip in the middle."""
    shoulder: float = 0.0
    sidewalk: float = 2.0
    """Width of the sidewalk on either side (on the right of a one-way road), 0 for none."""

    @property
    def middle(self) -> float:
        """OpenDRIVE's lane offset: where the lanes' origin lies left of the path."""
        if not self.backward:
            return self.forward * self.width / 2
        return -self.turn_lane / 2

    @cached_property
    def lanes(self) -> tuple[LaneSpec, ...]:
        """All strips, those right of the origin (negative ids) from the middle outwards, then those left of it."""
        return (*self._side(-1), *self._side(1))

    def _side(self, sign: int) -> list[LaneSpec]:
        strips: list[tuple[LaneKind, float]] = []
        if self.median:
            strips.append(("median", self.median / 2))
        if self.turn_lane and sign > 0:
            strips.append(("bidirectional", self.turn_lane))
        strips += [("driving", self.width)] * (self.forward if sign < 0 else self.backward)
        strips += [("shoulder", self.shoulder)] if self.shoulder else []
        # A one-way road has its sidewalk on the right: the left is the inside of a loop or another carriageway.
        if self.sidewalk and (sign < 0 or self.backward):
            strips.append(("sidewalk", self.sidewalk))
        out, edge = [], 0.0
        for number, (kind, width) in enumerate(strips, 1):
            out.append(LaneSpec(sign * number, kind, width, self.middle + sign * (edge + width / 2)))
            edge += width
        return out

    def driving(self, forward: bool) -> list[LaneSpec]:
        """The driving lanes of one direction, leftmost (in that direction) first."""
        return [lane for lane in self.lanes if lane.kind == "driving" and (lane.id < 0) == forward]

    def edge(self, sign: int, *kinds: LaneKind) -> float:
        """Offset left of the path of the outer edge of the given kinds of strip on one side (+1 left, -1 right)."""
        edges = [
            lane.offset + sign * lane.width / 2 for lane in self.lanes if lane.id * sign > 0 and lane.kind in kinds
        ]
        return max(edges, key=abs, default=self.middle)

    def asphalt(self, sign: int) -> float:
        """Offset left of the path of the edge of the asphalt on one side."""
        return self.edge(sign, "median", "bidirectional", "driving", "shoulder")


@dataclass(frozen=True)
class Street:
    """A street from end to end. It is cut into roads at the nodes it passes and where its limit changes."""

    name: str
    path: Path
    section: Section = field(default_factory=Section)
    limit: float = 30.0
    zones: tuple[tuple[Point, float], ...] = ()
    """(point, limit): from the point of the street nearest to this one on, the limit is this."""
    climbs: tuple[tuple[Point, float], ...] = ()
    """(point, height): heights the street has at points along it; level before the first and after the last."""
    kind: Literal["town", "rural", "motorway"] = "town"

    @cached_property
    def limits(self) -> list[tuple[float, float]]:
        """(station, limit) in order of station."""
        return sorted((self.path.nearest(point), limit) for point, limit in self.zones)

    def limit_at(self, s: float) -> float:
        """The limit at a station, km/h."""
        s = s % self.path.length if self.path.closed else s
        passed = [limit for station, limit in self.limits if station <= s + 1e-6]
        if passed:
            return passed[-1]
        return self.limits[-1][1] if self.path.closed and self.limits else self.limit

    @cached_property
    def heights(self) -> list[tuple[float, float]]:
        """(station, height) in order of station, carried once round a closed street."""
        knots = sorted((self.path.nearest(point), z) for point, z in self.climbs)
        if self.path.closed and knots:
            run = self.path.length
            knots = [(knots[-1][0] - run, knots[-1][1]), *knots, (knots[0][0] + run, knots[0][1])]
        return knots

    def height(self, s: float) -> tuple[float, float]:
        """Height and slope (metres per metre along the path) at a station: level at knots, smooth between."""
        knots = self.heights
        s = s % self.path.length if self.path.closed else s
        i = bisect_right([k[0] for k in knots], s)
        if not knots or i in (0, len(knots)):
            return (knots[min(i, len(knots) - 1)][1] if knots else 0.0), 0.0
        (s0, z0), (s1, z1) = knots[i - 1], knots[i]
        t, run = (s - s0) / (s1 - s0), s1 - s0
        return z0 + (z1 - z0) * t * t * (3 - 2 * t), (z1 - z0) * 6 * t * (1 - t) / run


@dataclass(frozen=True)
class Node:
    """A junction: where streets meet, and who gives way.

    `at` is its point, or about its point if `cross` names two streets whose paths cross there.
    """

    name: str
    at: Point
    control: Control = "none"
    cross: tuple[str, str] | None = None
    minor: tuple[str, ...] = ()
    """Streets that face the stop or yield sign; by default those that end here."""
    streets: tuple[str, ...] = ()
    """Streets that meet here; by default all that pass within `reach`."""
    reach: float = 1.5
    radius: float = 6.0
    """Smallest radius of the lanes through it."""
    trims: tuple[tuple[str, float], ...] = ()
    """(street, distance): at least so far from the node its roads stop."""
    crosswalks: bool = False
    links: tuple[tuple[str, int, str, int], ...] = ()
    """(street, lane, street, lane): lanes joined instead of by the rule, numbered from the left of each arm."""
    ring: bool = False
    """A leg of a roundabout."""
    banned: tuple[tuple[str, Literal["left", "right"]], ...] = ()
    """(street, turn) that traffic entering from a street may not take."""

    def crossed(self, street: Street) -> bool:
        """Whether pedestrians may cross the arms of a street here: all, or the legs of a roundabout."""
        return self.crosswalks and (street.section.backward > 0 or not self.ring)


@dataclass(frozen=True)
class Layout:
    """A whole town."""

    name: str
    description: str
    streets: tuple[Street, ...]
    nodes: tuple[Node, ...]

    def street(self, name: str) -> Street:
        """The street of that name."""
        return next(street for street in self.streets if street.name == name)

    def point(self, node: Node) -> Point:
        """Where a node is."""
        if node.cross is None:
            return node.at
        one, other = (self.street(name).path for name in node.cross)
        return crossing(one, other, node.at)

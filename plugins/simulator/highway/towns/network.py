"""A layout worked out: streets cut into roads, junctions with their connectors, lights, signs and crossings."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from itertools import pairwise

from me3bev_plugins.simulator.highway.towns.arms import SHORTEST_ROAD, Arm
from me3bev_plugins.simulator.highway.towns.connect import connect
from me3bev_plugins.simulator.highway.towns.geometry import Path, beside, wrap
from me3bev_plugins.simulator.highway.towns.junctions import Link, curve, join
from me3bev_plugins.simulator.highway.towns.streets import LaneSpec, Layout, Node, Street

JUNCTION_IDS = 1000
"""Junctions are numbered from here, roads from 1."""


@dataclass
class Road:
    """A stretch of street between two junctions or changes of limit. Links name a kind of thing and its id."""

    id: int
    street: Street
    low: float
    high: float
    limit: float
    before: tuple[str, int] = ("", 0)
    after: tuple[str, int] = ("", 0)
    signed: tuple[bool, bool] = (False, False)
    """Whether a speed sign stands at the start for forward, and at the end for backward traffic."""


@dataclass
class Connector:
    """A way through a junction: one driving lane centred on its path, or a strip of sidewalk round a corner."""

    id: int
    path: Path
    width: float
    limit: float
    heights: tuple[float, float, float, float]
    """Height and slope at the start and at the end."""
    sidewalk: bool
    source: tuple[int, int, str] = (0, 0, "")
    """Road, lane id and the end of the road that the lane comes from."""
    target: tuple[int, int, str] = (0, 0, "")
    kind: str = "town"


@dataclass
class Crossroads:
    """A junction: its arms with the road of each, its connectors, and the phase groups of its lights."""

    id: int
    node: Node
    arms: list[Arm]
    roads: list[int]
    connectors: list[Connector] = field(default_factory=list)
    groups: list[int] = field(default_factory=list)
    """Phase group of each arm."""

    def yielding(self, index: int) -> bool:
        """Whether traffic of an arm faces the junction's stop or yield sign."""
        street = self.arms[index].street
        if self.node.minor:
            return street.name in self.node.minor
        return sum(arm.street is street for arm in self.arms) == 1


@dataclass
class Network:
    """All of a town, ready to be written."""

    layout: Layout
    roads: list[Road]
    junctions: list[Crossroads]


def build(layout: Layout) -> Network:
    """Cut the streets of a layout at its nodes and join them again through junctions."""
    joined = [join(layout, node) for node in layout.nodes]
    roads = [road for street in layout.streets for road in _roads(street, joined)]
    for number, road in enumerate(roads, 1):
        road.id = number
    _chain(roads)
    junctions, next_id = [], len(roads) + 1
    for index, (node, (arms, links)) in enumerate(zip(layout.nodes, joined, strict=True)):
        ends = [_road_at(roads, arm, JUNCTION_IDS + index) for arm in arms]
        junction = Crossroads(JUNCTION_IDS + index, node, arms, [road.id for road in ends], groups=_groups(arms))
        ways = [_way(arms, ends, link) for link in links] + _corners(arms)
        for number, way in enumerate(ways, next_id):
            way.id = number
        junction.connectors, next_id = ways, next_id + len(ways)
        junctions.append(junction)
    _put_up_signs(roads, junctions)
    for road in roads:
        if not road.before[0] or not road.after[0]:
            raise ValueError(
                f"street {road.street.name}: the road from {road.low:.0f} to {road.high:.0f} m ends nowhere"
            )
    return Network(layout, roads, junctions)


def _roads(street: Street, joined: list[tuple[list[Arm], list[Link]]]) -> list[Road]:
    """The stretches of one street between the mouths of its junctions, cut where the limit changes."""
    arms = [arm for arms, _ in joined for arm in arms if arm.street is street]
    starts = sorted((arm for arm in arms if arm.away > 0), key=lambda arm: arm.station)
    ends = sorted((arm for arm in arms if arm.away < 0), key=lambda arm: arm.station)
    run, closed = street.path.length, street.path.closed
    if not starts or len(starts) != len(ends):
        raise ValueError(f"street {street.name} must begin and end at nodes: {len(starts)} starts, {len(ends)} ends")
    if closed:
        ends = [*ends[1:], ends[0]]
    roads = []
    for start, end in zip(starts, ends, strict=True):
        low, high = start.mouth, end.mouth + (run if closed and end.station <= start.station else 0.0)
        if high - low < SHORTEST_ROAD:
            raise ValueError(
                f"street {street.name}: only {high - low:.1f} m left of the road at {street.path.pose(low)}"
            )
        turns = (0, 1) if closed else (0,)
        # A motorway keeps one limit from junction to junction.
        inside = (
            []
            if street.kind == "motorway"
            else [s + turn * run for s, _ in street.limits for turn in turns if low + 5 < s + turn * run < high - 5]
        )
        cuts = [low, *sorted(inside), high]
        roads += [Road(0, street, a, b, street.limit_at((a + b) / 2)) for a, b in pairwise(cuts)]
    return roads


def _chain(roads: list[Road]) -> None:
    """Link roads that follow each other where only the limit changes."""
    for one, two in pairwise(roads):
        if one.street is two.street and abs(one.high - two.low) < 1e-9:
            one.after, two.before = ("road", two.id), ("road", one.id)


def _put_up_signs(roads: list[Road], junctions: list[Crossroads]) -> None:
    """A speed sign wherever some of the traffic that enters a road comes from a road with another limit."""
    limit = {road.id: road.limit for road in roads}
    sources: dict[tuple[int, str], set[float]] = {}
    for junction in junctions:
        for way in junction.connectors:
            if not way.sidewalk:
                sources.setdefault((way.target[0], way.target[2]), set()).add(limit[way.source[0]])
    for road in roads:
        ends = []
        for end, (kind, number) in (("start", road.before), ("end", road.after)):
            upstream = {limit[number]} if kind == "road" else sources.get((road.id, end), set())
            ends.append(any(other != road.limit for other in upstream))
        road.signed = ends[0], ends[1] and road.street.section.backward > 0


def _road_at(roads: list[Road], arm: Arm, junction: int) -> Road:
    """The road whose end is the arm's mouth, now linked to the junction."""
    run = arm.street.path.length
    for road in roads:
        end = road.low if arm.away > 0 else road.high
        gap = (end - arm.mouth) % run if arm.street.path.closed else end - arm.mouth
        if road.street is arm.street and min(abs(gap), abs(gap - run)) < 1e-6:
            if arm.away > 0:
                road.before = ("junction", junction)
            else:
                road.after = ("junction", junction)
            return road
    raise ValueError(f"street {arm.street.name}: no road ends at {arm.mouth:.1f} m")


def _contact(arm: Arm) -> str:
    return "start" if arm.away > 0 else "end"


def _way(arms: list[Arm], roads: list[Road], link: Link) -> Connector:
    source, target = arms[link.source], arms[link.target]
    start, end = source.entering()[link.lane], target.leaving()[link.onto]
    path = curve(arms, link)
    if path is None:
        raise ValueError(f"no way from {source.street.name} to {target.street.name}")
    kinds = {source.street.kind, target.street.kind}
    return Connector(
        0,
        path,
        min(start.width, end.width),
        min(roads[link.source].limit, roads[link.target].limit),
        _heights(source, target),
        sidewalk=False,
        source=(roads[link.source].id, start.id, _contact(source)),
        target=(roads[link.target].id, end.id, _contact(target)),
        kind=kinds.pop() if len(kinds) == 1 else "town",
    )


def _heights(source: Arm, target: Arm) -> tuple[float, float, float, float]:
    """Height and slope where traffic leaves one arm and where it enters the other, along its way."""
    z0, slope0 = source.street.height(source.mouth)
    z1, slope1 = target.street.height(target.mouth)
    return z0, -source.away * slope0, z1, target.away * slope1


def _corners(arms: list[Arm]) -> list[Connector]:
    """Sidewalks round the corners between neighbouring arms that both have one."""
    out = []
    for i, arm in enumerate(arms):
        other = arms[(i + 1) % len(arms)]
        # Facing outwards, the corner is on the left of one arm and on the right of the next.
        one, two = _sidewalk(arm, arm.away), _sidewalk(other, -other.away)
        if one is None or two is None or other is arm:
            continue
        x, y, h = beside(arm.pose, one.offset)
        start = (x, y, wrap(h if arm.away < 0 else h + math.pi))
        x, y, h = beside(other.pose, two.offset)
        end = (x, y, wrap(h if other.away > 0 else h + math.pi))
        path = connect(start, end)
        if path is not None and path.length < 1.6 * math.dist(start[:2], end[:2]) + 1:
            out.append(Connector(0, path, min(one.width, two.width), 0.0, _heights(arm, other), sidewalk=True))
    return out


def _sidewalk(arm: Arm, sign: int) -> LaneSpec | None:
    strips = arm.street.section.lanes
    return next((lane for lane in strips if lane.kind == "sidewalk" and lane.id * sign > 0), None)


def _groups(arms: list[Arm]) -> list[int]:
    """Phase group of each arm: arms that face each other are green together."""
    groups: list[float] = []
    out = []
    for arm in arms:
        axis = arm.outward
        same = [i for i, g in enumerate(groups) if abs(math.sin(axis - g)) < math.sin(math.radians(35))]
        if not same:
            groups.append(axis)
        out.append(same[0] if same else len(groups) - 1)
    return out

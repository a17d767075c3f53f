"""The arms of a junction: where each street's road stops short of the node, and its lanes in and out."""

from __future__ import annotations

import math
from dataclasses import dataclass

from me3bev_plugins.simulator.highway.towns.geometry import Point, Pose, beside, wrap
from me3bev_plugins.simulator.highway.towns.streets import LaneSpec, Layout, Node, Street

CROSSWALK = (0.9, 3.9)
"""A crosswalk lies between these distances past the end of the road, metres."""
ROOM_FOR_CROSSWALK = 4.5
SHORTEST_ROAD = 4.0
STUB = 12.0
"""Metres; a street may run on past its last node by less than this."""


@dataclass
class Arm:
    """One street on one side of a node. `away` is +1 where the street's path leads away from the node, else -1."""

    street: Street
    station: float
    away: int
    trim: float

    @property
    def mouth(self) -> float:
        """Station at which the road stops."""
        return self.station + self.away * self.trim

    @property
    def pose(self) -> Pose:
        """Of the road's end on the street's path, along the path."""
        return self.street.path.pose(self.mouth)

    @property
    def root(self) -> float:
        """Direction into the arm at the node itself, before any bend."""
        return float(wrap(self.street.path.pose(self.station)[2] + (0.0 if self.away > 0 else math.pi)))

    @property
    def outward(self) -> float:
        """Direction from the node into the arm."""
        return float(wrap(self.pose[2] + (0.0 if self.away > 0 else math.pi)))

    def entering(self) -> list[LaneSpec]:
        """Driving lanes towards the node, leftmost first."""
        return list(self.street.section.driving(self.away < 0))

    def leaving(self) -> list[LaneSpec]:
        """Driving lanes away from the node, leftmost first."""
        return list(self.street.section.driving(self.away > 0))

    def entry(self, lane: LaneSpec) -> Pose:
        """End of an entering lane, heading into the junction."""
        x, y, h = beside(self.pose, lane.offset)
        return x, y, wrap(h if self.away < 0 else h + math.pi)

    def exit(self, lane: LaneSpec) -> Pose:
        """Start of a leaving lane, heading out of the junction."""
        x, y, h = beside(self.pose, lane.offset)
        return x, y, wrap(h if self.away > 0 else h + math.pi)

    def at_node(self, lane: LaneSpec) -> Pose:
        """Where a lane, drawn on past the mouth along the street, passes the node; along the path."""
        return beside(self.street.path.pose(self.station), lane.offset)


def arms_at(layout: Layout, node: Node) -> list[Arm]:
    """The arms of a node, counter-clockwise, trimmed no further than the node demands."""
    point, arms = layout.point(node), []
    for street in layout.streets:
        if node.streets and street.name not in node.streets:
            continue
        path = street.path
        floor = dict(node.trims).get(street.name, 2.0)
        for station in path.near(point, node.reach):
            for away in (1, -1):
                ahead = math.inf if path.closed else (path.length - station if away > 0 else station)
                if ahead > STUB:
                    arms.append(Arm(street, station, away, floor))
    missing = {*node.streets, *(node.cross or ())} - {arm.street.name for arm in arms}
    if missing or not arms:
        raise ValueError(f"node {node.name}: no street {sorted(missing) or 'at all'} within {node.reach} m of {point}")
    return sorted(arms, key=lambda arm: direction(arm, point))


def direction(arm: Arm, point: Point) -> float:
    """Where an arm lies as seen from the node, radians, for going round the arms counter-clockwise."""
    x, y, _ = beside((*arm.pose[:2], arm.outward), 0.0, 8.0)
    return math.atan2(y - point[1], x - point[0])


def clear_of_each_other(arms: list[Arm]) -> None:
    """Trim each arm until the corners of its mouth lie off the asphalt of the arms that cross it."""
    for arm in arms:
        while any(_covers(other, corner) for other in arms if _crosses(arm, other) for corner in _corners(arm)):
            arm.trim += 0.5
            if arm.trim > 80:
                raise ValueError(f"street {arm.street.name} never comes clear of the others at {arm.pose[:2]}")


def part(arms: list[Arm]) -> None:
    """Trim arms that leave side by side, such as a ramp and its motorway, to where their asphalt has parted."""
    for arm in arms:
        for other in arms:
            narrower = arm.street.section.forward < other.street.section.forward
            if narrower and arm.street is not other.street and math.cos(arm.root - other.root) > 0.8:
                floor, arm.trim = arm.trim, 0.0
                while (reach := _along(arm, other)) is not None:
                    arm.trim += 0.5
                    other.trim = max(other.trim, reach + 0.5)
                    if arm.trim > 150:
                        raise ValueError(f"streets {arm.street.name} and {other.street.name} never part")
                arm.trim = max(arm.trim, floor)


def _along(arm: Arm, other: Arm) -> float | None:
    """How far out on another arm this one's mouth lies, if that is on or near the other's asphalt."""
    section = other.street.section
    for corner in _corners(arm):
        station, left = other.street.path.beside(corner, other.station + other.away * arm.trim)
        if section.asphalt(-1) - 0.3 < left < section.asphalt(1) + 0.3:
            return (station - other.station) * other.away
    return None


def _crosses(arm: Arm, other: Arm) -> bool:
    return other is not arm and abs(math.sin(arm.root - other.root)) > 0.4


def _corners(arm: Arm) -> list[Point]:
    section = arm.street.section
    return [beside(arm.pose, section.asphalt(sign))[:2] for sign in (1, -1)]


def _covers(arm: Arm, point: Point) -> bool:
    """Whether a point lies on the asphalt of an arm, drawn on straight from the node."""
    x, y, h = arm.street.path.pose(arm.station)
    dx, dy = point[0] - x, point[1] - y
    ahead, left = dx * math.cos(h) + dy * math.sin(h), dy * math.cos(h) - dx * math.sin(h)
    section = arm.street.section
    margin = 0.7
    return bool(ahead * arm.away > -margin and section.asphalt(-1) - margin < left < section.asphalt(1) + margin)

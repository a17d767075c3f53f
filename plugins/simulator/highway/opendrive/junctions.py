"""Junctions of the network: connectors, arms, centres and roundabouts."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from me3bev_plugins.simulator.highway.opendrive.lanes import Network
from me3bev_plugins.simulator.highway.town import Control, Floats

SAME_ARM = np.radians(35.0)
"""Road ends that point away from a junction within this angle are one arm if they lie side by side."""
BESIDE = 25.0
"""Metres across between two carriageways of one arm."""
STAGGER = 40.0
"""Metres along between two carriageways of one arm."""
RING = 300.0
"""Metres; a longer way round is no roundabout."""

TANGENT = np.cos(np.radians(25.0))


@dataclass(frozen=True)
class Arm:
    """One street of a junction: its lanes that lead in and those that lead out."""

    incoming: tuple[int, ...]
    outgoing: tuple[int, ...]


@dataclass(eq=False)
class Crossing:
    """A junction in the making; lanes are positions in the network."""

    name: str
    connectors: tuple[int, ...]
    incoming: tuple[int, ...]
    outgoing: tuple[int, ...]
    arms: tuple[Arm, ...]
    centre: tuple[float, float]
    control: Control = "none"
    minor: frozenset[int] = frozenset()
    governed: set[int] = field(default_factory=set)
    """Incoming lanes that obey a traffic light."""


def find_crossings(network: Network) -> list[Crossing]:
    """Every junction that still has connectors, in the order of its first one."""
    members: dict[str, list[int]] = {}
    for index, lane in enumerate(network.lanes):
        if lane.junction is not None:
            members.setdefault(lane.junction, []).append(index)
    return [_crossing(network, name, connectors) for name, connectors in members.items()]


def _crossing(network: Network, name: str, connectors: list[int]) -> Crossing:
    lanes = network.lanes
    inside = set(connectors)
    incoming = sorted({n for c in connectors for n in lanes[c].predecessors} - inside)
    outgoing = sorted({n for c in connectors for n in lanes[c].successors} - inside)
    ends = np.array([p for c in connectors for p in (lanes[c].points[0, :2], lanes[c].points[-1, :2])])
    centre = (ends.min(0) + ends.max(0)) / 2
    return Crossing(
        name=name,
        connectors=tuple(connectors),
        incoming=tuple(incoming),
        outgoing=tuple(outgoing),
        arms=_arms(network, incoming, outgoing),
        centre=(float(centre[0]), float(centre[1])),
    )


def _arms(network: Network, incoming: list[int], outgoing: list[int]) -> tuple[Arm, ...]:
    """Roads that meet here, with the two carriageways of a divided road taken together."""
    roads: dict[tuple[str, bool], list[tuple[int, bool]]] = {}
    for lanes, inward in ((incoming, True), (outgoing, False)):
        for lane in lanes:
            road, _, number = network.lanes[lane].keys[-1 if inward else 0]
            roads.setdefault((road, (number < 0) == inward), []).append((lane, inward))
    groups = [[end] for end in roads.values()]
    merged = True
    while merged:
        merged = False
        for first in range(len(groups)):
            for second in range(first + 1, len(groups)):
                if any(_beside(network, a, b) for a in groups[first] for b in groups[second]):
                    groups[first] += groups.pop(second)
                    merged = True
                    break
            if merged:
                break
    flat = [[entry for end in group for entry in end] for group in groups]
    return tuple(Arm(tuple(n for n, i in g if i), tuple(n for n, i in g if not i)) for g in flat)


def outward(network: Network, lane: int, inward: bool) -> tuple[Floats, float]:
    """(2,) the end of a lane at its junction, and the direction away from the junction there."""
    draft = network.lanes[lane]
    if inward:
        return draft.points[-1, :2], draft.headings[1] + np.pi
    return draft.points[0, :2], draft.headings[0]


def _beside(network: Network, first: list[tuple[int, bool]], second: list[tuple[int, bool]]) -> bool:
    for a in first:
        p, heading = outward(network, *a)
        for b in second:
            q, other = outward(network, *b)
            along = (q - p) @ (np.cos(heading), np.sin(heading))
            across = (q - p) @ (-np.sin(heading), np.cos(heading))
            if abs(angle_between(heading, other)) < SAME_ARM and abs(across) < BESIDE and abs(along) < STAGGER:
                return True
    return False


def angle_between(first: float, second: float) -> float:
    """Signed turn from one direction to the other, in (-pi, pi]."""
    return float((second - first + np.pi) % (2 * np.pi) - np.pi)


def roundabout_lanes(network: Network) -> set[int]:
    """Lanes that run round in a circle to the left: always bearing left brings one back, never far from a middle."""
    lanes = network.lanes
    turns = [sum(_steps(lane.points)) for lane in lanes]
    ring: set[int] = set()
    for start in range(len(lanes)):
        if start in ring:
            continue
        path = [start]
        travelled = lanes[start].length
        while travelled < RING:
            ahead = lanes[path[-1]].successors
            following = max(ahead, key=lambda n: turns[n]) if ahead else start
            if following == start:
                break
            if following in path:
                travelled = RING
                break
            path.append(following)
            travelled += lanes[following].length
        if travelled < RING and start in lanes[path[-1]].successors and _is_circle([lanes[n].points for n in path]):
            ring.update(path)
    return ring


def _steps(points: Floats) -> Floats:
    steps = np.diff(points[:, :2], axis=0)
    return np.diff(np.unwrap(np.arctan2(steps[:, 1], steps[:, 0])))


def _is_circle(parts: list[Floats]) -> bool:
    """Whether travel is along the tangent all the way, as it is not round a block of houses."""
    points = np.concatenate(parts)[:, :2]
    middle = (points.min(0) + points.max(0)) / 2
    for part in parts:
        radial = (part[:-1, :2] + part[1:, :2]) / 2 - middle
        step = np.diff(part[:, :2], axis=0)
        along = radial[:, 0] * step[:, 1] - radial[:, 1] * step[:, 0]
        if np.any(along < TANGENT * np.hypot(*radial.T) * np.hypot(*step.T)):
            return False
    return len(parts) >= 4

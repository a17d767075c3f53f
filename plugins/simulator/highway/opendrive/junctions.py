"""Junctions of the network: connectors, arms and centres."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from me3bev_plugins.simulator.highway.opendrive.lanes import Network
from me3bev_plugins.simulator.highway.town import Control

SAME_ARM = np.radians(40.0)
"""Lane ends that point away from a junction within this angle are one arm if they lie side by side."""
BESIDE = 30.0
"""Metres between the ends of one arm, across it."""


@dataclass(eq=False)
class Crossing:
    """A junction in the making; lanes are positions in the network."""

    name: str
    connectors: tuple[int, ...]
    incoming: tuple[int, ...]
    outgoing: tuple[int, ...]
    arms: list[list[int]]
    """Incoming and outgoing lanes of each arm."""
    centre: tuple[float, float]
    control: Control = "none"
    minor: frozenset[int] = frozenset()


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
    ends = np.array([lanes[n].points[-1, :2] for n in incoming] + [lanes[n].points[0, :2] for n in outgoing])
    centre = (ends.min(0) + ends.max(0)) / 2
    away = np.array([lanes[n].headings[1] + np.pi for n in incoming] + [lanes[n].headings[0] for n in outgoing])
    return Crossing(
        name=name,
        connectors=tuple(connectors),
        incoming=tuple(incoming),
        outgoing=tuple(outgoing),
        arms=_arms(incoming + outgoing, ends, away),
        centre=(float(centre[0]), float(centre[1])),
    )


def _arms(lanes: list[int], ends: np.ndarray, away: np.ndarray) -> list[list[int]]:
    """Lane ends grouped into arms: alike in direction and side by side."""
    groups: list[list[int]] = []
    for index in range(len(lanes)):
        for group in groups:
            first = group[0]
            turn = abs((away[index] - away[first] + np.pi) % (2 * np.pi) - np.pi)
            gap = ends[index] - ends[first]
            ahead = np.array([np.cos(away[first]), np.sin(away[first])])
            along, across = abs(gap @ ahead), abs(gap[0] * ahead[1] - gap[1] * ahead[0])
            if turn < SAME_ARM and across < BESIDE and along < BESIDE:
                group.append(index)
                break
        else:
            groups.append([index])
    return [[lanes[i] for i in group] for group in groups]


def opposite_groups(headings: list[float]) -> list[int]:
    """Phase of each approach: approaches along one axis, in either direction, are green together."""
    axes: list[float] = []
    phases = []
    for heading in headings:
        for phase, axis in enumerate(axes):
            if abs((heading - axis + np.pi / 2) % np.pi - np.pi / 2) < np.radians(35.0):
                phases.append(phase)
                break
        else:
            axes.append(heading)
            phases.append(len(axes) - 1)
    return phases

"""Lanes side by side: the carriageways of a town, whether or not one may change between their lanes."""

from __future__ import annotations

from collections import defaultdict

import numpy as np

from me3bev_plugins.simulator.highway.town import Floats, Ints, Lane, Town

ASIDE = 0.6
"""Metres by which two lanes may lie nearer or farther than touching and still be neighbours."""
AHEAD = 0.6
"""Metres by which the ends of two neighbours may be out of line."""


class Carriageways:
    """Groups of lanes side by side in one direction, outside junctions.

    Attributes:
        lanes: the lanes of each group, leftmost first.
        of: (L,) group of each lane, -1 inside junctions.
    """

    def __init__(self, town: Town) -> None:
        self.town = town
        roads = [lane for lane in town.lanes if lane.junction is None]
        right = _right_neighbours(roads)
        taken = set(right.values())
        self.lanes: list[list[int]] = []
        self.of: Ints = np.full(len(town.lanes), -1, np.int32)
        for lane in roads:
            if lane.id not in taken:
                group = [lane.id]
                while group[-1] in right:
                    group.append(right[group[-1]])
                self.of[group] = len(self.lanes)
                self.lanes.append(group)

    def length(self, group: int) -> float:
        """Mean over the group's lanes, metres."""
        return float(np.mean([self.town.lanes[n].length for n in self.lanes[group]]))

    def ahead(self, through: set[int]) -> dict[int, set[int]]:
        """Groups that each group leads to directly, or across the junctions in `through`."""
        found: dict[int, set[int]] = defaultdict(set)
        for group, lanes in enumerate(self.lanes):
            for n in lanes:
                for m in self.town.lanes[n].successors:
                    junction = self.town.lanes[m].junction
                    if junction is None:
                        found[group].add(int(self.of[m]))
                    elif junction in through:
                        found[group] |= {int(self.of[k]) for k in self.town.lanes[m].successors} - {-1}
        return found


def _right_neighbours(roads: list[Lane]) -> dict[int, int]:
    """The lane that touches each lane on its right from beginning to end, where there is one."""
    starts, ends = (np.array([lane.points[i, :2] for lane in roads]) for i in (0, -1))
    widths = np.array([lane.width for lane in roads])
    found = {}
    for lane in roads:
        if lane.right is not None:
            found[lane.id] = lane.right
            continue
        apart = (lane.width + widths) / 2
        beside = _beside(lane.points[0, :2], lane.heading[0], starts, apart) & _beside(
            lane.points[-1, :2], lane.heading[-1], ends, apart
        )
        for index in np.flatnonzero(beside):
            if roads[index].left is None:
                found[lane.id] = roads[index].id
    return found


def _beside(at: Floats, heading: float, others: Floats, apart: Floats) -> np.ndarray:
    """Which of the points lie `apart` metres to the right of a pose."""
    dx, dy = (others - at).T
    ahead = dx * np.cos(heading) + dy * np.sin(heading)
    right = dx * np.sin(heading) - dy * np.cos(heading)
    return (np.abs(ahead) < AHEAD) & (np.abs(right - apart) < ASIDE)

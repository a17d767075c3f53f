"""Lane departures: onto the opposite direction, off the road, and nothing else."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from simulator.env.conftest import line

from me3bev_plugins.simulator.highway.infractions import RoadEdge
from me3bev_plugins.simulator.highway.lane_grid import LaneGrid
from me3bev_plugins.simulator.highway.lane_keeping import LaneKeeping
from me3bev_plugins.simulator.highway.scene import Ego
from me3bev_plugins.simulator.highway.town import Lane, Town

WEST = math.pi


@pytest.fixture(scope="module")
def road(town: Town) -> Town:
    """The tiny town, with a lane to the west beside lane 2."""
    return replace(town, lanes=(*town.lanes, Lane(7, line((580, 3.5, 0), (80, 3.5, 0)), 3.5, 20.0)))


def departures(town: Town, poses: Sequence[tuple[float, float, float]]) -> list[bool]:
    """Whether the ego departed at each pose (x, y, heading); it starts in its lane."""
    keeping, grid, edge = LaneKeeping(town), LaneGrid(town), RoadEdge(town)
    keeping.reset()
    found = []
    for x, y, heading in poses:
        off = edge.off_road(grid.locate(x, y, 0.0, heading), x, y)
        found.append(keeping.update(Ego(x, y, 0.0, heading, 8.0), off))
    return found


def across(ys: Sequence[float], heading: float = 0.0) -> list[tuple[float, float, float]]:
    return [(120.0 + 2.0 * k, y, heading) for k, y in enumerate(ys)]


def test_it_is_one_event_to_cross_into_the_opposite_lane(road: Town) -> None:
    # Lane 2 ends at y = 1.75, where the opposite one begins.
    assert departures(road, across([0.0, 1.7, 1.8, 3.5, 3.5])) == [False, False, True, False, False]


def test_it_is_one_event_to_leave_the_road(road: Town) -> None:
    # The verge of half a metre is neither lane nor off the road.
    assert departures(road, across([0.0, -1.9, -2.2, -2.3, -4.0])) == [False, False, False, True, False]


def test_after_coming_back_it_counts_again(road: Town) -> None:
    assert departures(road, across([1.8, 1.9, 1.7, 1.8, 3.5, 6.0, 0.0, -2.3])) == [
        True, False, False, True, False, False, False, True
    ]  # fmt: skip


def test_turning_round_in_the_lane_is_a_departure_and_the_other_lane_is_then_the_right_one(road: Town) -> None:
    assert departures(road, [(120.0, 0.0, 0.0), (120.0, 0.0, 1.5), (120.0, 0.0, 1.7)]) == [False, False, True]
    assert departures(road, across([3.5, 3.5], WEST)) == [False, False]


def test_changing_to_a_neighbour_of_the_same_direction_is_none(road: Town) -> None:
    assert not any(departures(road, [(20.0 + y, y, 0.0) for y in np.linspace(0.0, 3.5, 20)]))


def test_inside_a_junction_there_is_none(road: Town) -> None:
    # Across the junction's floor from lane to lane, and turned against its connectors.
    assert not any(departures(road, [(60.0, 0.0, 0.0), (62.0, 8.0, 1.0), (66.0, 10.0, 2.0), (70.0, 0.0, WEST)]))


def test_levels_are_apart(road: Town) -> None:
    # Lane 6 leads north over lane 2: on the ground at its side there is no lane to be kept to.
    keeping = LaneKeeping(road)
    assert keeping.update(Ego(150.0, 3.5, 0.0, 0.0, 8.0), False)
    keeping.reset()
    assert not keeping.update(Ego(150.0, 3.5, 10.0, math.pi / 2, 8.0), False)

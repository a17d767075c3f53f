"""Lights and stop signs run, and leaving the road."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from me3bev_plugins.simulator.highway.infractions import Infractions, RoadEdge, StopLines, inside_polygon
from me3bev_plugins.simulator.highway.lane_grid import LaneGrid
from me3bev_plugins.simulator.highway.scene import Ego, Light
from me3bev_plugins.simulator.highway.town import Town

NONE = Infractions(False, False)
FRONT = 4.7 / 2


def drive(town: Town, poses: Sequence[tuple[float, float, float, float]], light: Light) -> list[Infractions]:
    """What is broken at each pose (x and y of the front, heading, speed) after the first."""
    lines = StopLines(town)
    lights = np.array([light], np.int32)
    egos = [
        Ego(x - FRONT * math.cos(heading), y - FRONT * math.sin(heading), 0.0, heading, speed)
        for x, y, heading, speed in poses
    ]
    lines.reset(egos[0])
    return [lines.update(ego, lights)._replace(red_met=False) for ego in egos[1:]]


@pytest.mark.parametrize(
    ("light", "run"), [(Light.RED, True), (Light.AMBER, False), (Light.GREEN, False), (Light.OFF, False)]
)
def test_only_red_is_run(town: Town, light: Light, run: bool) -> None:
    broken = drive(town, [(58.0, 0, 0, 9), (59.0, 0, 0, 9), (60.2, 0, 0, 9), (61.0, 0, 0, 9)], light)
    assert broken == [NONE, Infractions(run, False), NONE]


def test_the_line_counts_on_its_own_lane_and_in_its_direction_only(town: Town) -> None:
    beside = drive(town, [(59.0, 3.5, 0, 9), (60.5, 3.5, 0, 9)], Light.RED)
    against = drive(town, [(60.5, 0, math.pi, 9), (59.5, 0, math.pi, 9)], Light.RED)
    before = drive(town, [(57.0, 0, 0, 9), (59.9, 0, 0, 9)], Light.RED)
    assert beside == against == before == [NONE]


@pytest.mark.parametrize(("speed", "y", "run"), [(0.4, 103.0, False), (0.6, 103.0, True), (0.4, 101.0, True)])
def test_a_stop_sign_wants_a_stop_shortly_before(town: Town, speed: float, y: float, run: bool) -> None:
    north = math.pi / 2
    poses = [(70, 100.0, north, 5), (70, y, north, speed), (70, 109.5, north, 5), (70, 110.5, north, 5)]
    assert drive(town, poses, Light.GREEN)[-1] == Infractions(False, run)


def test_off_road_is_beyond_lane_and_asphalt(town: Town) -> None:
    grid, edge = LaneGrid(town), RoadEdge(town)

    def off(x: float, y: float) -> bool:
        return edge.off_road(grid.locate(x, y, 0.0, 0.0), x, y)

    # Lane 2 is 3.5 m wide, and half a metre of verge is allowed.
    assert [off(120.0, y) for y in (0.0, 2.2, 2.3, -2.2, -2.3)] == [False, False, True, False, True]
    assert not off(62.0, 10.0)  # the junction's floor, on no lane
    assert off(62.0, 13.0)
    assert off(-300.0, 0.0)


def test_inside_polygon_by_angles() -> None:
    rng = np.random.default_rng(2)
    polygon = np.array([[0, 0], [4, 0], [4, 3], [2, 1], [0, 3]], float)
    for x, y in rng.uniform(-1, 5, (200, 2)):
        rays = polygon - (x, y)
        turn = np.angle(np.exp(1j * np.diff(np.arctan2(*np.r_[rays, rays[:1]].T[::-1])))).sum()
        assert inside_polygon(polygon, x, y) == (abs(turn) > math.pi)


def test_who_begins_beyond_the_line_or_waits_on_it_runs_nothing(town: Town) -> None:
    assert drive(town, [(60.1, 0, 0, 3), (61.0, 0, 0, 3)], Light.RED) == [NONE]
    assert drive(town, [(59.8, 0, 0, 0), (59.8, 0, 0, 0), (59.99, 0, 0, 0.1)], Light.RED) == [NONE, NONE]


def test_creeping_over_the_line_on_red_counts_once(town: Town) -> None:
    poses = [(59.9 + 0.05 * k, 0, 0, 0.5) for k in range(8)]
    broken = drive(town, poses, Light.RED)
    assert sum(b.red_light for b in broken) == 1


def test_a_turn_across_the_end_of_another_lane_is_not_its_line(town: Town) -> None:
    # Round to the north over the end of lane 0, at a right angle to it, and out of the junction again.
    north = math.pi / 2
    assert drive(town, [(60.5, -3.0, north, 5), (60.5, 0.0, north, 5), (60.5, 3.0, north, 5)], Light.RED) == [NONE] * 2
    # Coming from the side into the lane beyond its line.
    assert drive(town, [(62.0, -3.0, 1.0, 5), (63.0, -1.0, 0.7, 5), (64.5, 0.0, 0.2, 5)], Light.RED) == [NONE] * 2


def test_a_stop_counts_for_one_passage_and_a_yield_sign_asks_for_none(town: Town) -> None:
    north = math.pi / 2
    stopped = [(70, 104.0, north, 5), (70, 107.0, north, 0.2), (70, 110.5, north, 5)]
    again = [(70, 109.0, north, 5), (70, 110.5, north, 5)]
    assert [b.stop_sign for b in drive(town, stopped + again, Light.GREEN)] == [False, False, False, True]
    yields = replace(town, signs=(replace(town.signs[0], kind="yield"),))
    assert drive(yields, [(70, 109.0, north, 9), (70, 110.5, north, 9)], Light.GREEN) == [NONE]


def met(town: Town, poses: Sequence[tuple[float, float, float, float]], lights: Sequence[Light]) -> list[bool]:
    """Whether a red light is met at each pose after the first, with the light then."""
    lines = StopLines(town)
    egos = [Ego(x - FRONT * math.cos(h), y - FRONT * math.sin(h), 0.0, h, speed) for x, y, h, speed in poses]
    lines.reset(egos[0])
    colours = [np.array([light], np.int32) for light in lights]
    return [lines.update(ego, colour).red_met for ego, colour in zip(egos[1:], colours, strict=True)]


def test_a_red_light_is_met_once_within_twenty_metres_of_its_line(town: Town) -> None:
    # The line is at x = 60.
    poses = [(x, 0, 0, 9) for x in (38.0, 39.0, 41.0, 50.0, 59.0, 61.0, 62.0)]
    assert met(town, poses, [Light.RED] * 6) == [False, True, False, False, False, False]
    assert met(town, poses, [Light.GREEN] * 3 + [Light.RED, Light.GREEN, Light.RED]) == [False] * 3 + [
        True,
        False,
        False,
    ]
    assert not any(met(town, poses, [Light.GREEN, Light.AMBER, Light.OFF, Light.AMBER, Light.GREEN, Light.GREEN]))


def test_a_red_light_is_met_by_who_heads_for_it_on_its_lane(town: Town) -> None:
    for pose in ((50.0, 3.5, 0.0, 9), (50.0, 0.0, math.pi, 9), (50.0, 0.0, math.pi / 2, 9)):
        assert met(town, [(50.0, 0.0, math.pi, 0), pose], [Light.RED]) == [False]


def test_a_light_that_is_run_was_met(town: Town) -> None:
    # From the lane beside it, straight over the line.
    assert met(town, [(59.0, 2.0, 0, 9), (60.5, 1.0, 0, 9)], [Light.RED]) == [True]


def test_a_light_can_be_met_again_once_it_is_passed(town: Town) -> None:
    poses = [(x, 0, 0, 9) for x in (50.0, 51.0, 59.0, 61.0, 50.0, 51.0)]
    assert met(town, poses, [Light.RED] * 5) == [True, False, False, True, False]

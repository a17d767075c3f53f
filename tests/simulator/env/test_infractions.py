"""Lights and stop signs run, and leaving the road."""

from __future__ import annotations

import math
from collections.abc import Sequence

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
    return [lines.update(ego, lights) for ego in egos[1:]]


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

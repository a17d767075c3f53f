"""The shipped towns as the reader sees them: joined without gap or kink, drivable for ever."""

from __future__ import annotations

import numpy as np
import pytest

from me3bev_cli.errors import MapError
from me3bev_plugins.simulator.highway.maps import MAPS, load_town
from me3bev_plugins.simulator.highway.town import Town

TIGHTEST = 5.5


@pytest.fixture(params=MAPS)
def town(request: pytest.FixtureRequest) -> Town:
    return load_town(request.param)


def test_joined_lanes_meet_without_gap_or_kink(town: Town) -> None:
    for lane in town.lanes:
        for successor in lane.successors:
            following = town.lanes[successor]
            assert np.linalg.norm(lane.points[-1] - following.points[0]) < 0.01
            last = lane.points[-1, :2] - lane.points[-2, :2]
            first = following.points[1, :2] - following.points[0, :2]
            turn = np.angle(complex(*first) / complex(*last))
            assert abs(np.degrees(turn)) < 1.0, (lane.id, successor)


def test_no_lane_bends_tighter_than_a_car_can_steer(town: Town) -> None:
    for lane in town.lanes:
        steps = np.diff(lane.points[:, :2], axis=0)
        size = np.hypot(*steps.T)
        turn = np.abs(np.angle(np.exp(1j * np.diff(np.arctan2(steps[:, 1], steps[:, 0])))))
        rate = turn / ((size[:-1] + size[1:]) / 2)
        assert rate.max(initial=0.0) < 1.02 / TIGHTEST, lane.id
        assert np.degrees(rate.max(initial=0.0)) < 15.0


def test_every_lane_goes_on_and_is_reached(town: Town) -> None:
    assert all(lane.successors and lane.predecessors for lane in town.lanes)


def test_every_lane_leads_to_every_other(town: Town) -> None:
    beside = [[n for n in (lane.left, lane.right) if n is not None] for lane in town.lanes]
    ahead = [[*lane.successors, *beside[lane.id]] for lane in town.lanes]
    behind = [[*lane.predecessors, *beside[lane.id]] for lane in town.lanes]
    for edges in (ahead, behind):
        assert len(_reached(edges)) == len(town.lanes)


def _reached(edges: list[list[int]]) -> set[int]:
    found, frontier = {0}, [0]
    while frontier:
        new = set(edges[frontier.pop()]) - found
        found |= new
        frontier += new
    return found


def test_the_same_town_is_shared() -> None:
    assert load_town("T2") is load_town("T2")


def test_an_unknown_map_is_a_map_error_that_lists_the_maps() -> None:
    with pytest.raises(MapError, match=r"unknown map 'T33'; did you mean 'T3'\? Allowed: T1, T2, T3, T4, T5, T6, T7"):
        load_town("T33")


@pytest.mark.parametrize(("name", "height", "sites"), [("T4", 11.0, 1), ("T5", 10.0, 3)])
def test_roads_cross_on_two_levels(name: str, height: float, sites: int) -> None:
    crossings = _level_crossings(load_town(name))
    assert crossings
    assert all(abs(rise - height) < 0.7 for _, _, rise in crossings)
    assert len(_clusters([(x, y) for x, y, _ in crossings], 45.0)) == sites


def _level_crossings(town: Town) -> list[tuple[float, float, float]]:
    """(x, y, difference of height) wherever a lane lies more than 3 m over another."""
    arrays = town.arrays
    cells: dict[tuple[int, int], list[np.ndarray]] = {}
    for point in arrays.xyz:
        cells.setdefault((round(point[0]), round(point[1])), []).append(point)
    found = []
    for (x, y), points in cells.items():
        z = [p[2] for p in points]
        if max(z) - min(z) > 3.0:
            found.append((float(x), float(y), float(max(z) - min(z))))
    return found


def _clusters(points: list[tuple[float, float]], reach: float) -> list[tuple[float, float]]:
    seeds: list[tuple[float, float]] = []
    for point in points:
        if all(np.hypot(point[0] - x, point[1] - y) > reach for x, y in seeds):
            seeds.append(point)
    return seeds


@pytest.mark.parametrize(("name", "blocks"), [("T1", 7), ("T2", 5)])
def test_one_can_walk_round_every_block_without_crossing_a_street(name: str, blocks: int) -> None:
    walks = load_town(name).sidewalks
    # One ring in each block, and one round the town; so they go on round corners and past side streets.
    assert len(walks) == blocks + 1
    assert all(np.hypot(*(walk.points[0] - walk.points[-1])) < 1.0 for walk in walks)


def test_the_country_has_roadsides_to_walk_on() -> None:
    walks = load_town("T7").sidewalks
    metres = {
        paved: sum(np.hypot(*np.diff(walk.points, axis=0).T).sum() for walk in walks if walk.paved == paved)
        for paved in (True, False)
    }
    assert metres[False] > 2 * metres[True] > 0

"""Sidewalks and scenery: nothing stands where anything drives or walks, and the same name grows the same town."""

from __future__ import annotations

import numpy as np
import pytest
from simulator.opendrive_text import WIDTH, stadium, tee

from me3bev_plugins.simulator.highway.opendrive import read_town
from me3bev_plugins.simulator.highway.town import Building, Floats, Town


@pytest.fixture(scope="module")
def town() -> Town:
    return read_town(tee(sides="sidewalk"), "tee")


def corners(building: Building) -> Floats:
    cos, sin = np.cos(building.heading), np.sin(building.heading)
    half = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * np.array(building.size) / 2
    return building.centre + half @ np.array([[cos, sin], [-sin, cos]])


def outside(building: Building, points: Floats) -> Floats:
    """Metres of each point from a building; 0 inside."""
    cos, sin = np.cos(building.heading), np.sin(building.heading)
    local = (points - building.centre) @ np.array([[cos, -sin], [sin, cos]])
    return np.hypot(*np.maximum(np.abs(local) - np.array(building.size) / 2, 0).T)


def test_sidewalks_run_along_the_streets_and_round_the_corners(town: Town) -> None:
    # Three pieces: the straight side of the T, and one round each corner.
    paved = [walk for walk in town.sidewalks if walk.paved]
    lengths = sorted(np.hypot(*np.diff(walk.points, axis=0).T).sum() for walk in paved)
    assert len(lengths) == 3
    assert lengths[2] == pytest.approx(184, abs=1)
    assert all(150 < length < 184 for length in lengths[:2])
    assert {walk.width for walk in paved} == {2.0}
    straight = max(paved, key=lambda walk: walk.points[:, 1].mean())
    np.testing.assert_allclose(straight.points[:, 1], WIDTH + 1, atol=1e-6)


def test_country_roads_get_a_path_on_their_right() -> None:
    rural = read_town(tee(), "tee")
    assert rural.sidewalks
    assert all(not walk.paved and walk.width == 1.5 for walk in rural.sidewalks)


def test_nobody_walks_along_a_motorway() -> None:
    fast = '<type s="0" type="motorway"><speed max="120" unit="km/h"/></type>'
    town = read_town(stadium(speed=fast), "ring")
    assert town.sidewalks == ()
    assert town.buildings == ()


def test_towns_grow_houses_trees_and_poles(town: Town) -> None:
    assert len(town.buildings) >= 12
    assert {prop.kind for prop in town.props} == {"tree", "pole"}
    for building in town.buildings:
        assert 6 <= building.height <= 25
    assert len({building.colour for building in town.buildings}) > 3


def test_nothing_stands_where_anything_drives_or_walks(town: Town) -> None:
    for building in town.buildings:
        for lane in town.lanes:
            assert outside(building, lane.points[:, :2]).min() > lane.width / 2
        for walk in town.sidewalks:
            assert outside(building, walk.points).min() > walk.width / 2
        for surface in town.surfaces:
            assert outside(building, surface).min() > 0
    for prop in town.props:
        for lane in town.lanes:
            assert np.hypot(*(lane.points[:, :2] - prop.position).T).min() > lane.width / 2 + prop.radius
        for building in town.buildings:
            assert outside(building, np.array([prop.position]))[0] > prop.radius


def test_houses_do_not_overlap(town: Town) -> None:
    for index, first in enumerate(town.buildings):
        edge = corners(first)
        outline = np.concatenate([np.linspace(edge[i], edge[(i + 1) % 4], 30) for i in range(4)])
        for second in town.buildings[index + 1 :]:
            assert outside(second, outline).min() > 0.5


def test_houses_stand_behind_the_sidewalk(town: Town) -> None:
    walks = np.concatenate([walk.points for walk in town.sidewalks])
    gaps = [outside(building, walks).min() for building in town.buildings]
    assert np.median(gaps) < 7.5


def test_scenery_comes_from_the_name_alone(town: Town) -> None:
    again, other = (read_town(tee(sides="sidewalk"), name) for name in ("tee", "tea"))
    assert [b.centre for b in again.buildings] == [b.centre for b in town.buildings]
    assert [p.position for p in again.props] == [p.position for p in town.props]
    assert [b.centre for b in other.buildings] != [b.centre for b in town.buildings]


def test_surfaces_are_convex(town: Town) -> None:
    for polygon in town.surfaces:
        step = np.roll(polygon, -1, axis=0) - polygon
        following = np.roll(step, -1, axis=0)
        turn = step[:, 0] * following[:, 1] - step[:, 1] * following[:, 0]
        assert turn.min() > -1e-6 or turn.max() < 1e-6


def test_the_junction_has_a_floor(town: Town) -> None:
    middle = np.array(town.junctions[0].centre)
    floor = [polygon for polygon in town.surfaces if np.hypot(*(polygon - middle).T).min() < 1e-9]
    assert len(floor) > 8

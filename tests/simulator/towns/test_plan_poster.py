"""The plan for people: its size, where things lie on it, and what it says."""

from __future__ import annotations

import numpy as np
import pytest
from simulator.traffic.stage import straight_town

from me3bev_plugins.simulator.highway.maps import load_town
from me3bev_plugins.simulator.highway.plan_poster import HEAD, LONGEST, MARGIN, frame_of, poster
from me3bev_plugins.simulator.highway.plan_poster_ground import limit_colour, split_levels
from me3bev_plugins.simulator.highway.plan_poster_legend import nice_length, summary
from me3bev_plugins.simulator.highway.plan_poster_signs import bridges, convex_hull, hilltops, outline


def rgb(colour: str) -> np.ndarray:
    return np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)])


def test_the_plan_shows_the_whole_town_to_scale() -> None:
    town = load_town("T2")
    picture, frame = poster(town, 3), frame_of(town)
    assert picture.dtype == np.uint8
    assert picture.shape == (frame.height + HEAD + 2 * MARGIN, picture.shape[1], 3)
    assert 1500 < picture.shape[1] < 1700
    assert max(frame.width, frame.height) == LONGEST
    # Along the middle of a lane its limit's colour prevails: arrows, marks and the route cover little.
    for lane in town.lanes:
        if lane.junction is None and lane.length > 20:
            column = MARGIN + (lane.points[:, 0] - frame.low[0]) * frame.scale
            row = MARGIN + HEAD + (frame.high[1] - lane.points[:, 1]) * frame.scale
            seen = picture[row.astype(int), column.astype(int)].astype(int)
            right = np.abs(seen - rgb(limit_colour(lane.limit))).max(axis=1) < 12
            assert right.mean() > 0.5 or lane.id in route_lanes(town, 3), lane.id


def route_lanes(town, seed: int) -> set[int]:
    from me3bev_plugins.simulator.highway.route_sampling import random_route

    return set(random_route(town, np.random.default_rng(seed)).lanes.tolist())


def test_the_seed_chooses_the_route_and_nothing_else() -> None:
    town = load_town("T1")
    one, same, other = poster(town, 1), poster(town, 1), poster(town, 2)
    assert np.array_equal(one, same)
    assert one.shape == other.shape
    changed = (one != other).any(axis=2).mean()
    assert 0.0 < changed < 0.03


@pytest.mark.parametrize("name", ["T3", "T4", "T5", "T6", "T7"])
def test_every_built_in_town_has_a_plan(name: str) -> None:
    picture = poster(load_town(name), 0)
    assert 700 < picture.shape[0] < 1500
    assert 1300 < picture.shape[1] < 1700
    assert picture.std() > 20


def test_a_town_without_anything_beside_its_lanes_has_a_plan() -> None:
    assert poster(straight_town(), 0).shape[2] == 3


def test_the_upper_road_is_drawn_over_the_lower_one() -> None:
    town = load_town("T4")
    below, above = split_levels(town)
    assert {round(float(points[:, 2].max())) for _, points in above} == {11}
    assert sum(len(points) - 1 for _, points in (*below, *above)) == sum(len(lane.points) - 1 for lane in town.lanes)
    assert split_levels(load_town("T6"))[1] == []
    picture, frame = poster(town, 0), frame_of(town)
    # The lower road drives north (90 km/h), the upper one west (60 km/h): where they cross, the upper one is seen.
    column = int(MARGIN + (11.0 - frame.low[0]) * frame.scale)
    row = int(MARGIN + HEAD + (frame.high[1] + 11.0) * frame.scale)
    patch = picture[row - 4 : row + 5, column - 6 : column + 7].reshape(-1, 3).astype(int)
    upper, lower = ((np.abs(patch - rgb(limit_colour(kmh / 3.6))).max(axis=1) < 12).mean() for kmh in (60, 90))
    assert upper > 0.3
    assert lower == 0.0


def test_bridges_and_hilltops_are_told_apart() -> None:
    assert [round(rise) for *_, rise in bridges(load_town("T4"))] == [11]
    assert [round(rise) for *_, rise in bridges(load_town("T5"))] == [10, 10, 10]
    assert [round(z) for *_, z in hilltops(load_town("T3"))] == [7, 2]
    assert sorted(round(z) for *_, z in hilltops(load_town("T7"))) == [6, 9]
    assert bridges(load_town("T3")) == []


def test_outlines_hold_the_lanes_of_their_junction() -> None:
    town = load_town("T3")
    junction = max(town.junctions, key=lambda junction: junction.arms)
    corners = outline(town, junction)
    edges = np.roll(corners, -1, axis=0) - corners
    for number in junction.connectors:
        apart = town.lanes[number].points[:, None, :2] - corners[None]
        assert (edges[:, 0] * apart[..., 1] - edges[:, 1] * apart[..., 0] > 0).all()


def test_a_hull_drops_what_lies_inside() -> None:
    points = np.array([[0, 0], [2, 0], [2, 2], [0, 2], [1, 1], [1, 0], [0, 0]], float)
    assert convex_hull(points).tolist() == [[0, 0], [2, 0], [2, 2], [0, 2]]


def test_words_and_numbers_beside_the_map() -> None:
    assert [nice_length(most) for most in (4.9, 5.0, 99.0, 230.0)] == [2.0, 5.0, 50.0, 200.0]
    assert summary(load_town("T2")).startswith("2.9 km of lanes  ·  8 junctions  ·  8 with lights")
    assert len({limit_colour(kmh / 3.6) for kmh in (30, 40, 50, 60, 80, 90)}) == 6

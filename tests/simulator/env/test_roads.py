"""Lanes and networks in highway-env's terms, and the look-up of lanes, against slow and independent answers."""

from __future__ import annotations

import math

import numpy as np
import pytest
from highway_env.road.lane import AbstractLane
from highway_env.road.road import RoadNetwork

from me3bev_plugins.simulator.highway.lane_grid import LaneGrid
from me3bev_plugins.simulator.highway.roads import TownLane, road_network
from me3bev_plugins.simulator.highway.town import Town


def test_projection_on_an_arc_is_radius_and_angle(town: Town) -> None:
    lane = TownLane(town.lanes[3])
    assert isinstance(lane, AbstractLane)
    for angle, radius in ((0.3, 10.0), (0.8, 8.5), (1.2, 11.0)):
        # The centre of the turn is at (60, 10); the lane runs counter-clockwise from below it.
        point = (60 + radius * math.sin(angle), 10 - radius * math.cos(angle))
        s, lateral = lane.local_coordinates(point)
        assert s == pytest.approx(10 * angle, abs=0.05)
        assert lateral == pytest.approx(10 - radius, abs=0.02)


def test_position_and_local_coordinates_are_inverse(town: Town) -> None:
    for index in (0, 3, 4):
        lane = TownLane(town.lanes[index])
        for s in np.linspace(-3.0, lane.length + 3.0, 13):
            # On the inner side of a bend's corner several arc lengths share a point; the middle of a segment is safe.
            i = int(np.clip(np.searchsorted(lane.lane.s, s) - 1, 0, len(lane.lane.s) - 2))
            inside = 0 <= s <= lane.length
            s = float(lane.lane.s[i : i + 2].mean()) if inside else float(s)
            again = lane.local_coordinates(lane.position(s, 0.3))
            assert again == pytest.approx((s, 0.3), abs=1e-6)


def test_lane_survives_its_config(town: Town) -> None:
    lane = TownLane(town.lanes[3])
    again = TownLane.from_config(lane.to_config())
    assert again.length == lane.length
    assert again.local_coordinates((67.0, 3.0)) == lane.local_coordinates((67.0, 3.0))


def test_network_joins_lanes_at_nodes_and_keeps_neighbours_on_one_road(town: Town) -> None:
    network = road_network(town)
    assert isinstance(network, RoadNetwork)
    assert network is road_network(town)
    index = network.index_of
    for lane in town.lanes:
        assert network.get_lane(index[lane.id]).lane is lane
        for follower in lane.successors:
            assert index[lane.id][1] == index[follower][0]
    assert index[0][:2] == index[5][:2]
    assert (index[5][2], index[0][2]) == (0, 1)
    assert len(network.lanes_list()) == len(town.lanes)


def test_closest_lane_agrees_with_highway_env(town: Town) -> None:
    network = road_network(town)
    rng = np.random.default_rng(3)
    for _ in range(40):
        lane = network.get_lane(network.index_of[int(rng.integers(len(town.lanes)))])
        s = rng.uniform(2.0, lane.length - 2.0)
        position, heading = lane.position(s, rng.uniform(-1.0, 1.0)), lane.heading_at(s)
        slow = RoadNetwork.get_closest_lane_index(network, position, heading)
        fast = network.get_closest_lane_index(position, heading)
        # Inside the junction two lanes may fit equally well.
        near = [network.get_lane(i).distance_with_heading(position, heading) for i in (slow, fast)]
        assert near[1] == pytest.approx(near[0], abs=0.6)


def _slow(town: Town, x: float, y: float, z: float) -> tuple[float, float]:
    """(outside, junction distance) by dense sampling of every lane."""
    outside = junction = math.inf
    for lane in town.lanes:
        s = np.linspace(0, lane.length, int(lane.length * 200) + 2)
        points = np.stack([np.interp(s, lane.s, lane.points[:, k]) for k in range(3)], 1)
        level = np.abs(points[:, 2] - z) <= 2.5
        if not level.any():
            continue
        nearest = float(np.hypot(points[level, 0] - x, points[level, 1] - y).min())
        outside = min(outside, nearest - lane.width / 2)
        if lane.junction is not None:
            junction = min(junction, nearest)
    return outside, junction


def test_locate_agrees_with_dense_sampling(town: Town) -> None:
    grid = LaneGrid(town)
    rng = np.random.default_rng(4)
    for _ in range(60):
        x, y = rng.uniform(-5, 165), rng.uniform(-8, 30)
        z = float(rng.choice([0.0, 10.0]))
        place = grid.locate(x, y, z, rng.uniform(-3, 3))
        outside, junction = _slow(town, x, y, z)
        if outside < 5:
            assert place.outside == pytest.approx(outside, abs=0.01)
        if junction < 9:
            assert place.junction_distance == pytest.approx(junction, abs=0.01)


def test_locate_tells_levels_and_directions_apart(town: Town) -> None:
    grid = LaneGrid(town)
    assert grid.locate(150.0, 0.0, 0.0, 0.0).lane == 2
    assert grid.locate(150.0, 0.0, 10.0, 0.0).lane == 6
    assert grid.locate(66.0, 0.2, 0.0, 0.0).lane == 1
    assert grid.locate(69.0, 5.0, 0.0, 1.3).lane == 3
    assert grid.locate(30.0, 1.0, 0.0, 0.0)[:3] == pytest.approx((0, 30.0, 1.0))


def test_locate_far_from_any_lane(town: Town) -> None:
    place = LaneGrid(town).locate(-400.0, 900.0, 0.0, 0.0)
    assert place.lane == -1
    assert math.isinf(place.outside)
    assert math.isinf(place.junction_distance)

"""Vehicles drive as highway-env's own."""

from __future__ import annotations

import numpy as np
import pytest
from highway_env.road.lane import StraightLane
from highway_env.road.road import Road, RoadNetwork
from highway_env.vehicle.behavior import IDMVehicle
from simulator.traffic.stage import FAR_AWAY, ego_on, staged, straight_town

from me3bev_plugins.simulator.highway.traffic_parameters import idm_parameters

LIMIT = 30.0


def reference(
    starts: list[tuple[float, float]], targets: list[float], leader: dict[int, float], steps: int
) -> np.ndarray:
    """Positions (steps, N) of real IDM vehicles on a real highway-env road; `leader` gives it new target speeds."""
    network = RoadNetwork()
    network.add_lane("a", "b", StraightLane([0, 0], [2000, 0], speed_limit=LIMIT))
    road = Road(network=network, np_random=np.random.RandomState(0))
    for (x, speed), target in zip(starts, targets, strict=True):
        vehicle = IDMVehicle(road, [x, 0.0], 0.0, speed, ("a", "b", 0), target, enable_lane_change=False)
        road.vehicles.append(vehicle)
    found = []
    for step in range(steps):
        road.vehicles[-1].target_speed = leader.get(step, road.vehicles[-1].target_speed)
        road.act()
        road.step(0.1)
        found.append([vehicle.position[0] for vehicle in road.vehicles])
    return np.array(found)


def test_platoon_follows_highway_env_within_a_decimetre_for_30_s() -> None:
    starts = [(50.0 + 32.0 * i, 18.0 - 0.4 * i) for i in range(8)]
    targets = [28.0, 24.0, 29.0, 22.0, 30.0, 26.0, 25.0, 20.0]
    leader = {100: 6.0, 200: 22.0}
    expected = reference(starts, targets, leader, 300)
    town = straight_town(limit=LIMIT)
    traffic = staged(town, [(0, x, speed) for x, speed in starts])
    traffic._fleet.cars["eager"][:-1] = np.array(targets) / LIMIT
    path = ego_on(town, [0], 5.0)[1]
    for step in range(300):
        if step in leader:
            traffic._fleet.cars[len(starts) - 1]["eager"] = leader[step] / LIMIT
        traffic.step(0.1, FAR_AWAY, path)
        assert traffic.actors.x == pytest.approx(expected[step], abs=0.1), step
    assert expected[-1, -1] - expected[-1, 0] < 8 * 32.0  # They closed up behind the one that braked.


def test_parameters_are_read_from_highway_env() -> None:
    accel, brake, time, gap, exponent, most = idm_parameters()
    assert accel == IDMVehicle.COMFORT_ACC_MAX
    assert brake == -IDMVehicle.COMFORT_ACC_MIN
    assert time == IDMVehicle.TIME_WANTED
    assert gap + IDMVehicle.LENGTH == IDMVehicle.DISTANCE_WANTED
    assert (exponent, most) == (IDMVehicle.DELTA, IDMVehicle.ACC_MAX)


def test_standing_queue_leaves_the_jam_gap() -> None:
    town = straight_town(300.0)
    traffic = staged(town, [(0, 100.0 + 20.0 * i, 8.0) for i in range(4)])
    path = ego_on(town, [0], 5.0)[1]
    for _ in range(600):
        traffic.step(0.1, FAR_AWAY, path)
    gaps = np.diff(traffic.actors.x) - 5.0
    assert traffic.actors.speed.max() < 0.05
    assert traffic.actors.x[-1] + 2.5 < 300.0
    assert ((gaps > 4.0) & (gaps < 6.0)).all(), gaps

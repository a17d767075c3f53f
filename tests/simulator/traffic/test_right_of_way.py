"""Who goes first: lights, signs, ranks, room."""

from __future__ import annotations

import numpy as np
from simulator.tiny_town import build_tiny_town
from simulator.traffic.stage import FAR_AWAY, bind, box, ego_on, overlap, set_lights, staged
from simulator.traffic.test_conflicts import connector

from me3bev_plugins.simulator.highway.scene import Light
from me3bev_plugins.simulator.highway.traffic import Traffic
from me3bev_plugins.simulator.highway.traffic_tables import tables

TOWN = build_tiny_town()


def run(traffic: Traffic, seconds: float) -> np.ndarray:
    """Speeds (T, N)."""
    path = ego_on(TOWN, [0], 5.0)[1]
    speeds = []
    for _ in range(round(seconds * 10)):
        traffic.step(0.1, FAR_AWAY, path)
        speeds.append(traffic.actors.speed.copy())
    return np.array(speeds)


def lane_of(traffic: Traffic, vehicle: int) -> int:
    return int(traffic._fleet.path[vehicle, 0])


def test_red_stops_and_green_goes() -> None:
    traffic = staged(TOWN, [(8, 10.0, 9.0)])
    set_lights(traffic, Light.RED)
    run(traffic, 20.0)
    stop = float(tables(TOWN).roads.lanes["stop"][8])
    assert lane_of(traffic, 0) == 8
    assert traffic.actors.speed[0] < 0.05
    assert stop - 3.0 < traffic._fleet.cars[0]["s"] + 2.5 <= stop
    set_lights(traffic, Light.GREEN)
    run(traffic, 12.0)
    assert lane_of(traffic, 0) != 8


def test_nobody_drives_through_red_at_any_speed() -> None:
    for speed in (3.0, 6.0, 9.0, 11.0):
        traffic = staged(TOWN, [(19, 2.6, speed)])
        set_lights(traffic, Light.RED)
        run(traffic, 10.0)
        assert lane_of(traffic, 0) == 19, speed


def test_a_stop_sign_is_stopped_at_and_then_left() -> None:
    traffic = staged(TOWN, [(10, 10.0, 8.0)])  # Towards the ring in the west.
    speeds = run(traffic, 20.0)[:, 0]
    assert speeds.min() < 0.3
    assert lane_of(traffic, 0) != 10


def test_a_yield_sign_needs_no_stop_on_an_empty_road() -> None:
    traffic = staged(TOWN, [(12, 10.0, 8.0)])  # Towards the ring in the east.
    speeds = run(traffic, 10.0)[:, 0]
    assert speeds.min() > 1.0


def test_the_minor_road_waits_for_the_main_road() -> None:
    turn, main = connector(TOWN, 12, "left"), connector(TOWN, 3, "straight")
    ring = float(TOWN.lanes[3].length)
    traffic = staged(TOWN, [(12, 28.0, 8.0), (3, ring - 20.0, 10.0)])
    bind(traffic, 0, [12, turn])
    bind(traffic, 1, [3, main])
    path = ego_on(TOWN, [0], 5.0)[1]
    passed = {}
    for k in range(150):
        traffic.step(0.1, FAR_AWAY, path)
        for i, gate in enumerate((turn, main)):
            if lane_of(traffic, i) == gate:
                passed.setdefault(i, k)
        assert not overlap(box(traffic.actors, 0), box(traffic.actors, 1))
        if lane_of(traffic, 1) == main:
            assert traffic.actors.speed[1] > 7.0  # It was not made to brake.
    assert passed[1] < passed[0]


def test_turning_left_waits_for_those_who_come_straight_on() -> None:
    left, straight = connector(TOWN, 8, "left"), connector(TOWN, 14, "straight")
    traffic = staged(TOWN, [(8, 30.0, 6.0), (14, 15.0, 10.0)])
    bind(traffic, 0, [8, left])
    bind(traffic, 1, [14, straight])
    set_lights(traffic, Light.GREEN)
    entered = {}
    path = ego_on(TOWN, [0], 5.0)[1]
    for k in range(150):
        traffic.step(0.1, FAR_AWAY, path)
        for i, gate in enumerate((left, straight)):
            if lane_of(traffic, i) == gate:
                entered.setdefault(i, k)
        assert not overlap(box(traffic.actors, 0), box(traffic.actors, 1))
    assert entered[1] < entered[0]


def test_nobody_enters_a_junction_without_room_beyond() -> None:
    straight = connector(TOWN, 16, "straight")
    # Two vehicles are made to stand at the start of the road beyond.
    queue = [(18, 3.0 + 10.0 * k, 0.0) for k in range(2)]
    traffic = staged(TOWN, [(16, 8.0, 6.0), *queue])
    bind(traffic, 0, [16, straight, 18])
    set_lights(traffic, Light.GREEN)
    path = ego_on(TOWN, [0], 5.0)[1]
    for _ in range(75):  # Later it would look for another way.
        traffic._fleet.cars["speed"][1:3] = 0.0
        traffic._fleet.cars["s"][1:3] = [3.0, 13.0]
        traffic.step(0.1, FAR_AWAY, path)
    assert lane_of(traffic, 0) == 16
    assert traffic.actors.speed[0] < 0.1


def test_equal_arms_take_turns_without_touching() -> None:
    south = [i for i in range(20) if TOWN.lanes[i].successors and TOWN.lanes[TOWN.lanes[i].successors[0]].junction == 2]
    assert len(south) == 3
    traffic = staged(TOWN, [(lane, float(TOWN.lanes[lane].length) - 15.0, 6.0) for lane in south])
    path = ego_on(TOWN, [0], 5.0)[1]
    for _ in range(250):
        traffic.step(0.1, FAR_AWAY, path)
        for i, j in ((0, 1), (0, 2), (1, 2)):
            assert not overlap(box(traffic.actors, i), box(traffic.actors, j))
    assert all(lane_of(traffic, i) not in south for i in range(3))

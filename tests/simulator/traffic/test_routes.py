"""Vehicles have destinations, know the shortest way there, and are in its lane in time."""

from __future__ import annotations

import heapq

import numpy as np
import pytest
from highway_env.vehicle.behavior import IDMVehicle
from simulator.tiny_town import build_tiny_town
from simulator.traffic.stage import FAR_AWAY, ego_on, staged

from me3bev_plugins.simulator.highway.ego_path import EgoPath
from me3bev_plugins.simulator.highway.maps import load_town
from me3bev_plugins.simulator.highway.town import Junction, Lane, Town
from me3bev_plugins.simulator.highway.traffic import Traffic
from me3bev_plugins.simulator.highway.traffic_parameters import mobil_parameters
from me3bev_plugins.simulator.highway.traffic_routes import CHANGE, _edges, _spread, plan_routes
from me3bev_plugins.simulator.highway.traffic_tables import tables

TOWN = build_tiny_town()


def test_times_are_dijkstras() -> None:
    lanes = tables(TOWN).roads.lanes
    begin, end, base = _edges(TOWN, lanes)
    order = np.argsort(end, kind="stable")
    start = np.searchsorted(end[order], np.arange(len(lanes) + 1)).astype(np.int32)
    times = np.full(len(lanes), np.inf)
    times[7] = 0.0
    _spread(start, begin[order], base[order], times)
    expected, queue = {}, [(0.0, 7)]
    while queue:
        seconds, lane = heapq.heappop(queue)
        if lane in expected:
            continue
        expected[lane] = seconds
        for a, b, weight in zip(begin, end, base, strict=True):
            if b == lane:
                heapq.heappush(queue, (seconds + weight, int(a)))
    assert times == pytest.approx([expected.get(i, np.inf) for i in range(len(lanes))])


def test_large_vehicles_are_sent_over_lanes_that_admit_them_only() -> None:
    lanes = tables(load_town("T3")).roads.lanes
    times = plan_routes(load_town("T3"), lanes)
    for n, bit in enumerate((1, 2, 4, 8)):
        refused = (lanes["admits"] & bit) == 0
        assert not np.isfinite(times[n][:, refused]).any()
        assert np.isfinite(times[n][:, ~refused]).all() or refused.all() or bit > 1


def test_destinations_are_reached_one_after_another() -> None:
    town = load_town("T3")
    traffic = Traffic(town)
    traffic.reset(np.random.default_rng(5), 40, 0, FAR_AWAY, EgoPath(np.zeros(1, np.int32), 0, 1.0, 0.0))
    cars = traffic._fleet.cars[:-1]
    assert (cars["goal"] >= 0).all()
    first = cars["goal"].copy()
    renewed = np.zeros(40, np.bool_)
    for _ in range(1800):
        traffic.step(0.1, FAR_AWAY, EgoPath(np.zeros(1, np.int32), 0, 1.0, 0.0))
        renewed |= cars["goal"] != first
    assert renewed.mean() > 0.8


def forked() -> Town:
    """Two lanes of 400 m to the east; the left one leads on, the right one leads off to the south."""

    def line(x0: float, y0: float, x1: float, y1: float) -> np.ndarray:
        steps = int(np.hypot(x1 - x0, y1 - y0)) + 1
        return np.column_stack([np.linspace(x0, x1, steps), np.linspace(y0, y1, steps), np.zeros(steps)])

    lanes = (
        Lane(0, line(0, 0, 400, 0), 3.5, 15.0, (2,), right=1),
        Lane(1, line(0, -3.5, 400, -3.5), 3.5, 15.0, (3,), left=0),
        Lane(2, line(400, 0, 420, 0), 3.5, 15.0, (4,), (0,), junction=0),
        Lane(3, line(400, -3.5, 420, -7.5), 3.5, 15.0, (5,), (1,), junction=0),
        Lane(4, line(420, 0, 900, 0), 3.5, 15.0, (), (2,)),
        Lane(5, line(420, -7.5, 900, -60), 3.5, 15.0, (), (3,)),
    )
    return Town("forked", lanes, (Junction(0, (2, 3), (0, 1), (4, 5), "none", 3),))


@pytest.mark.parametrize(("wanted", "exit"), [(4, 2), (5, 3)])
def test_the_lane_that_leads_there_is_taken_in_time(wanted: int, exit: int) -> None:
    town = forked()
    times = tables(town).roads.times[0]
    goal = next(n for n in range(len(times)) if times[n, wanted] == 0.0)
    traffic = staged(town, [(0, 30.0, 12.0), (1, 60.0, 12.0), (0, 90.0, 12.0), (1, 120.0, 12.0)])
    cars = traffic._fleet.cars
    cars["goal"][:4], cars["timer"][:4] = goal, 0.0
    path = ego_on(town, [0], 5.0)[1]
    used = set()
    for _ in range(500):
        cars["goal"][:4] = goal
        traffic.step(0.1, FAR_AWAY, path)
        used |= {int(lane) for lane in traffic._fleet.path[:4, 0]}
    assert exit in used
    assert not used & ({2, 3} - {exit})


def test_lanes_abreast_differ_by_a_change_of_lanes_at_most() -> None:
    town = load_town("T5")
    roads = tables(town).roads
    pairs = [(n.id, n.left) for n in town.lanes if n.left is not None and n.length > 200.0 and n.junction is None]
    a, b = np.array(pairs).T
    assert len(pairs) > 5
    assert np.abs(roads.times[0][:, a] - roads.times[0][:, b]).max() <= CHANGE + 1e-3


def test_who_comes_to_a_queue_takes_the_lane_without_one() -> None:
    town = forked()
    rows = [(0, 392.0 - 9.0 * k, 0.0) for k in range(6)] + [(0, 215.0, 12.0)]
    for wanted, taken in ((4, 1), (-1, 1)):
        traffic = staged(town, rows)
        cars = traffic._fleet.cars
        times = tables(town).roads.times[0]
        cars["timer"][6] = 0.0
        path = ego_on(town, [0], 5.0)[1]
        for _ in range(40):
            cars["goal"] = -1 if wanted < 0 else next(n for n in range(len(times)) if times[n, wanted] == 0.0)
            cars["speed"][:6] = 0.0
            traffic.step(0.1, FAR_AWAY, path)
        # The lane beside leads elsewhere only: who wants to go on waits, the others do not.
        assert int(traffic._fleet.path[6, 0]) == (0 if wanted == 4 else taken)


def test_nobody_changes_lanes_where_a_queue_would_stop_it_across_both() -> None:
    town = forked()
    for gap, changes in ((20.0, False), (60.0, True)):
        rows = [(0, 200.0 + gap, 0.0), (0, 200.0, 5.0), (1, 320.0, 0.0)]
        traffic = staged(town, rows)
        cars = traffic._fleet.cars
        cars["timer"][1], cars["goal"] = 0.0, -1
        traffic.step(0.1, FAR_AWAY, ego_on(town, [0], 5.0)[1])
        assert (cars["change"][1] > 0.0) == changes


def test_parameters_of_changes_are_highway_envs() -> None:
    politeness, gain, braking, delay = mobil_parameters()
    assert politeness == IDMVehicle.POLITENESS
    assert gain == IDMVehicle.LANE_CHANGE_MIN_ACC_GAIN
    assert braking == IDMVehicle.LANE_CHANGE_MAX_BRAKING_IMPOSED
    assert delay == IDMVehicle.LANE_CHANGE_DELAY

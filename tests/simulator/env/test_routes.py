"""Routes: their make, projection, waypoints and lights, by hand and against independent sums."""

from __future__ import annotations

import math

import numpy as np
import pytest

from me3bev_plugins.simulator.highway.route_sampling import nominal_length, random_route
from me3bev_plugins.simulator.highway.routes import Route, RouteTracker, make_route
from me3bev_plugins.simulator.highway.town import Town


@pytest.fixture
def route(town: Town) -> Route:
    """East along lane 0 from x = 10, then left and north."""
    return make_route(town, [0, 3, 4], 10.0, 90.0)


def test_route_joins_lanes(route: Route) -> None:
    arc = 5 * math.pi
    assert route.begins == pytest.approx([-10, 50, 50 + arc], abs=0.02)
    assert route.s[-1] == pytest.approx(150 + arc, abs=0.02)
    assert (np.diff(route.s) > 0).all()
    assert route.points[0] == pytest.approx([10, 0, 0])
    assert route.heading_at(20.0) == pytest.approx(0.0)
    assert route.heading_at(140.0) == pytest.approx(math.pi / 2)
    assert route.lane_at(60.0) == pytest.approx((1, 10.0))
    assert route.positions(np.array([-2.0, 20.0]))[:, 0] == pytest.approx([8.0, 30.0])


def test_route_knows_its_lights(route: Route) -> None:
    assert route.stops == pytest.approx([50.0])
    tracker = RouteTracker(route, 5.0)
    for x, expected in ((20.0, -1), (39.0, -1), (41.0, 0), (59.0, 0), (61.0, -1)):
        tracker.update(x, 0.0)
        assert tracker.light_ahead(20.0) == expected


def test_projection_by_hand(route: Route) -> None:
    tracker = RouteTracker(route, 5.0)
    tracker.update(14.0, 1.5)
    assert (tracker.progress, tracker.lateral, tracker.off_route) == pytest.approx((4.0, 1.5, 1.5))
    tracker.update(18.0, -0.5)
    assert (tracker.progress, tracker.lateral, tracker.off_route) == pytest.approx((8.0, -0.5, 0.5))
    path = tracker.path
    assert (path.index, path.s, path.lateral) == pytest.approx((0, 18.0, -0.5))
    assert path.lanes.tolist() == [0, 3, 4]


def test_progress_never_falls_and_never_leaps(route: Route) -> None:
    tracker = RouteTracker(route, 5.0)
    tracker.update(22.0, 0.0)
    tracker.update(15.0, 0.0)
    assert tracker.progress == pytest.approx(12.0)
    assert tracker.off_route == pytest.approx(0.0, abs=1e-9)
    # Beside the far end of the route, but far from where the ego was.
    tracker.update(70.0, 60.0)
    assert tracker.progress <= 12.0 + 15.0


def test_waypoints_are_evenly_spaced_and_ahead(route: Route) -> None:
    tracker = RouteTracker(route, 5.0)
    assert tracker.waypoints()[:, 0] == pytest.approx([15, 20, 25, 30, 35])
    tracker.update(14.9, 0.0)
    assert tracker.waypoints()[0, 0] == pytest.approx(15.0)
    tracker.update(15.0, 0.0)
    assert tracker.waypoints()[0, 0] == pytest.approx(20.0)


def test_waypoints_go_straight_on_beyond_a_dead_end(route: Route) -> None:
    tracker = RouteTracker(route, 50.0)
    for y in range(0, 111, 5):
        tracker.update(70.0, float(y))
    last = tracker.waypoints()
    assert last.shape == (5, 3)
    assert last[:, 0] == pytest.approx([70.0] * 5)
    assert np.diff(last[:, 1]) == pytest.approx([50.0] * 4)


def test_done_at_the_length(town: Town) -> None:
    tracker = RouteTracker(make_route(town, [0, 1, 2], 0.0, 10.0), 5.0)
    tracker.update(9.9, 0.0)
    assert not tracker.done
    tracker.update(10.1, 0.0)
    assert tracker.done


def test_nominal_driver_on_a_straight_road(town: Town) -> None:
    # Limit 20: 2 m/s^2 for 10 s reaches 20 m/s and 100 m.
    assert nominal_length(town, make_route(town, [2], 0.0, 0.0)) == pytest.approx(100.0, abs=0.5)


def test_nominal_driver_keeps_the_limit(town: Town) -> None:
    # Lane 0 allows 10: 5 s and 25 m to reach it, then 35 m at 10 to x = 60 (8.5 s), and 15 m more on lane 1.
    assert nominal_length(town, make_route(town, [0, 1, 2], 0.0, 0.0)) == pytest.approx(75.0, abs=1.0)


def test_nominal_driver_slows_for_a_bend(town: Town) -> None:
    # Radius 10 at 2.5 m/s^2 of lateral acceleration: 5 m/s. The start is 10 m before the bend, which the driver
    # enters at 5 m/s: up to v and down to 5 over 10 m with 2 m/s^2 gives v^2 = 32.5, in 0.5 (2 v - 5) = 3.20 s.
    # The bend of 15.7 m takes 3.14 s; the remaining 3.66 s give 5 * 3.66 + 3.66^2 = 31.7 m.
    # The curvature of a sampled line rises over a metre or so, where the driver is a little faster.
    expected = 10 + 5 * math.pi + 31.7
    assert expected - 0.5 <= nominal_length(town, make_route(town, [0, 3, 4], 50.0, 0.0)) <= expected + 4.0


def test_random_routes_repeat_and_start_on_roads(town: Town) -> None:
    for seed in range(30):
        a, b = (random_route(town, np.random.default_rng(seed)) for _ in range(2))
        assert a.points.tobytes() == b.points.tobytes()
        assert a.length == b.length > 0
        first = town.lanes[int(a.lanes[0])]
        assert first.junction is None
        if first.id == 0:
            assert -a.begins[0] <= 40.0 + 1e-9
        for here, there in zip(a.lanes[:-1], a.lanes[1:], strict=True):
            assert there in town.lanes[here].successors

"""The ego's kinematics and the steering that follows from them."""

from __future__ import annotations

import math

import numpy as np
import pytest
from highway_env.vehicle.kinematics import Vehicle

from me3bev_plugins.simulator.highway.driver import pursue, steer
from me3bev_plugins.simulator.highway.ego import EgoVehicle, acceleration_of, longitudinal_of
from me3bev_plugins.simulator.highway.roads import TownRoad, road_network
from me3bev_plugins.simulator.highway.routes import RouteTracker, make_route
from me3bev_plugins.simulator.highway.town import Town


@pytest.fixture
def ego(town: Town) -> EgoVehicle:
    """Standing at x = 10 on lane 0."""
    return EgoVehicle(TownRoad(road_network(town), np.random.default_rng(0)), (10.0, 0.0, 0.0), 0.0)


def test_longitudinal_maps_both_ways() -> None:
    assert acceleration_of(1.0) == 3.5
    assert acceleration_of(-1.0) == -8.0
    assert acceleration_of(-0.25) == -2.0
    for value in (-1.0, -0.3, 0.0, 0.4, 1.0):
        assert longitudinal_of(acceleration_of(value)) == pytest.approx(value)
    assert longitudinal_of(-20.0) == -1.0


def test_braking_stops_and_holds(ego: EgoVehicle) -> None:
    assert isinstance(ego, Vehicle)
    ego.speed = 0.5
    for _ in range(5):
        ego.act({"steering": 0.3, "acceleration": -8.0})
        ego.step(0.1)
        assert ego.speed >= 0
    assert ego.speed == 0.0
    # The first step moves with the speed it began with.
    assert math.hypot(ego.x - 10, ego.y) == pytest.approx(0.05)
    assert ego.acceleration == 0.0


def test_acceleration_and_yaw_rate_are_those_of_the_step(ego: EgoVehicle) -> None:
    ego.speed = 5.0
    ego.act({"steering": 0.2, "acceleration": 2.0})
    ego.step(0.1)
    assert ego.speed == pytest.approx(5.2)
    assert ego.acceleration == pytest.approx(2.0)
    slip = math.atan(0.5 * math.tan(0.2))
    assert ego.yaw_rate == pytest.approx(5.0 * math.sin(slip) / (4.7 / 2))


def test_kinematics_are_highway_envs_to_the_last_bit(town: Town, ego: EgoVehicle) -> None:
    class Stock(Vehicle):  # type: ignore[misc]
        LENGTH = EgoVehicle.LENGTH

    rng = np.random.default_rng(1)
    other = Stock(None, [10.0, 0.0], 0.0, 0.0)
    for _ in range(400):
        steering, acceleration = rng.uniform(-0.7, 0.7), rng.uniform(-3.0, 4.0)
        for vehicle in (ego, other):
            vehicle.act({"steering": steering, "acceleration": max(acceleration, -vehicle.speed / 0.1)})
            vehicle.step(0.1)
        assert (ego.x, ego.y, ego.heading) == (*other.position, other.heading)
        # Braking to a stop may leave highway-env a rounding error on the other side of 0.
        assert ego.speed == max(0.0, other.speed)
        other.speed = ego.speed


def test_an_ego_off_every_lane_has_the_nearest_one(town: Town) -> None:
    road = TownRoad(road_network(town), np.random.default_rng(0))
    lost = EgoVehicle(road, (-300.0, 0.0, 0.0), 0.0)
    assert lost.place.lane == -1
    assert lost.lane is road.network.get_lane(road.network.index_of[0])


def test_positive_steering_turns_left(ego: EgoVehicle) -> None:
    ego.speed = 5.0
    for _ in range(5):
        ego.act({"steering": 0.3, "acceleration": 0.0})
        ego.step(0.1)
    assert ego.y > 0
    assert ego.heading > 0


def test_the_ego_follows_the_height_of_its_level(town: Town) -> None:
    road = TownRoad(road_network(town), np.random.default_rng(0))
    assert EgoVehicle(road, (150.0, 0.0, 10.0), 1.5).z == 10.0
    assert EgoVehicle(road, (150.0, 0.0, 0.0), 0.0).z == 0.0


@pytest.mark.parametrize("target", [(6.0, 0.0), (8.0, 2.0), (5.0, -3.0), (3.0, 3.0)])
def test_pursuit_leads_through_the_point(target: tuple[float, float]) -> None:
    length = 4.7
    slip = math.atan(0.5 * math.tan(pursue(*target, length)))
    x = y = heading = 0.0
    nearest, step = math.inf, 1e-3
    for _ in range(12_000):
        x += step * math.cos(heading + slip)
        y += step * math.sin(heading + slip)
        heading += step * math.sin(slip) / (length / 2)
        nearest = min(nearest, math.hypot(x - target[0], y - target[1]))
    assert nearest < 0.01


def test_pursuit_of_a_point_behind_is_full_lock() -> None:
    assert abs(pursue(-2.0, 0.5, 4.7)) >= math.pi / 4


def test_steering_holds_the_lane_round_a_bend(town: Town, ego: EgoVehicle) -> None:
    tracker = RouteTracker(make_route(town, [0, 3, 4], 10.0, 100.0), 5.0)
    worst = 0.0
    ego.speed = 5.0
    while not tracker.done:
        ego.act({"steering": math.pi / 4 * steer(ego, tracker), "acceleration": 0.0})
        ego.step(0.1)
        tracker.update(ego.x, ego.y)
        worst = max(worst, tracker.off_route)
    assert worst < 0.3

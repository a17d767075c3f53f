"""R, V and N, with numbers worked out by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest

from me3bev_plugins.simulator.highway.features import (
    navigation_features,
    navigation_space,
    road_features,
    road_space,
    vehicle_features,
    vehicle_space,
)

WAYPOINTS = np.array([[3.0, 4.0, 0.0], [6.0, 8.0, 0.0], [9.0, 12.0, 0.0], [12.0, 16.0, 0.0], [15.0, 20.0, 0.0]])


def test_road_features_on_an_open_road() -> None:
    found = road_features(on_connector=False, junction_distance=30.0, light=0, limit=13.9)
    np.testing.assert_array_equal(found, np.array([0, 0, 0, 13.9, 1, 0, 0, 0, 0], np.float32))


def test_road_features_before_a_red_light() -> None:
    found = road_features(on_connector=False, junction_distance=10.0, light=1, limit=8.0)
    np.testing.assert_array_equal(found, np.array([0, 1, 1, 8, 0, 1, 0, 0, 0], np.float32))


def test_road_features_inside_an_intersection() -> None:
    found = road_features(on_connector=True, junction_distance=0.0, light=0, limit=8.0)
    np.testing.assert_array_equal(found[:3], [1, 1, 0])


def test_vehicle_features_split_the_longitudinal_action() -> None:
    gas = vehicle_features(similarity=0.5, speed=7.0, longitudinal=0.25)
    brake = vehicle_features(similarity=-1.0, speed=0.0, longitudinal=-0.75)
    np.testing.assert_array_equal(gas, np.array([0.5, 7, 0.25, 0], np.float32))
    np.testing.assert_array_equal(brake, np.array([-1, 0, 0, 0.75], np.float32))


def test_navigation_by_distance() -> None:
    found = navigation_features("distance", WAYPOINTS, 0.0, 0.0, 1.0)
    np.testing.assert_allclose(found, [5, 10, 15, 20, 25], rtol=1e-6)


def test_navigation_by_offset_is_in_the_ego_frame() -> None:
    # Facing north, a point at (x, y) lies y ahead and x to the right.
    found = navigation_features("offset", WAYPOINTS, 0.0, 0.0, math.pi / 2)
    np.testing.assert_allclose(found, [-3, 12, -9, 20, -15], rtol=1e-6)


@pytest.mark.parametrize("mode", ["distance", "offset"])
def test_extreme_values_stay_inside_the_spaces(mode: str) -> None:
    far = navigation_features(mode, WAYPOINTS + 1e6, 0.0, 0.0, 3.0)  # type: ignore[arg-type]
    assert navigation_space(mode).contains(far)  # type: ignore[arg-type]
    assert road_space().contains(road_features(on_connector=True, junction_distance=math.inf, light=4, limit=900.0))
    assert vehicle_space().contains(vehicle_features(similarity=1.0, speed=900.0, longitudinal=-1.0))

"""The paper's reward, with numbers worked out by hand."""

from __future__ import annotations

import math

import pytest

from me3bev_plugins.simulator.highway.reward import reward, similarity


def of(**changes: float) -> float:
    values = {"speed": 8.0, "limit": 10.0, "similarity": 0.5, "distance": 4.0, "collision_penalty": 1000.0}
    return reward(collision=bool(changes.pop("collision", False)), **{**values, **changes})


def test_following_earns_speed_times_similarity_over_squared_half_distance() -> None:
    # 4 * 8 * 0.5 / 4^2 = 1
    assert of() == 1.0


@pytest.mark.parametrize("distance", [0.0, 0.5, 2.0])
def test_the_divisor_is_clamped_within_two_metres(distance: float) -> None:
    assert of(distance=distance) == 8.0 * 0.5


def test_speeding_costs_the_excess() -> None:
    assert of(speed=12.5) == -2.5


def test_a_collision_costs_the_penalty_even_when_speeding() -> None:
    assert of(collision=True, speed=12.5) == -1000.0


def test_driving_away_from_the_waypoint_costs() -> None:
    assert of(similarity=-1.0, distance=8.0) == pytest.approx(-0.5)


def test_exactly_at_the_limit_is_not_speeding() -> None:
    assert of(speed=10.0) == pytest.approx(4 * 10 * 0.5 / 16)


def test_similarity_is_a_cosine() -> None:
    assert similarity(0.0, 3.0, 0.0) == pytest.approx(1.0)
    assert similarity(math.pi / 2, 3.0, 0.0) == pytest.approx(0.0, abs=1e-12)
    assert similarity(math.pi, 3.0, 3.0) == pytest.approx(-math.sqrt(0.5))
    assert similarity(1.0, 0.0, 0.0) == 1.0

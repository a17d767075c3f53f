"""What does not get on must not pay: spinning, standing and driving against the traffic earn less than the route."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from me3bev_plugins.simulator.highway.driver import pursue
from me3bev_plugins.simulator.highway.ego import STEERING
from me3bev_plugins.simulator.highway.env import TownEnv

SEEDS = range(6)


def follow(env: TownEnv) -> np.ndarray:
    return env.autopilot()


def stand(env: TownEnv) -> np.ndarray:
    return np.array([0.0, -1.0])


def spin(env: TownEnv) -> np.ndarray:
    return np.array([1.0, 0.6 if env.vehicle.speed < 3.0 else 0.0])


def cruise(env: TownEnv) -> float:
    """Up to 8 m/s."""
    return 0.6 if env.vehicle.speed < 8.0 else 0.0


def oncoming(env: TownEnv) -> np.ndarray:
    """Along the route, a lane's width to its left."""
    ego, tracker = env.vehicle, env._tracker
    s = tracker.progress + 6.0
    x, y = tracker.route.positions(np.array([s]))[0][:2]
    heading = float(np.interp(s, tracker.route.s, tracker.route.heading))
    dx, dy = x - 3.5 * math.sin(heading) - ego.x, y + 3.5 * math.cos(heading) - ego.y
    c, n = math.cos(ego.heading), math.sin(ego.heading)
    wheel = pursue(dx * c + dy * n, dy * c - dx * n, ego.LENGTH)
    return np.array([np.clip(wheel / STEERING, -1.0, 1.0), cruise(env)])


def reverse(env: TownEnv) -> np.ndarray:
    """Back along the lane that the route begins on."""
    return np.array([0.0, cruise(env)])


def total(env: TownEnv, seed: int, driver: Callable[[TownEnv], np.ndarray]) -> float:
    """The return of an episode."""
    env.reset(seed=seed)
    if driver is reverse:
        env.vehicle.heading += math.pi
    earned, over = 0.0, False
    while not over:
        _, reward, terminated, truncated, _ = env.step(driver(env).astype(np.float32))
        earned, over = earned + reward, terminated or truncated
    return earned


@pytest.mark.parametrize("name", ["T1", "T3", "T4", "T7"])
def test_only_following_the_route_pays(name: str) -> None:
    env = TownEnv(map=name, density="low", images=False)
    returns = {
        driver: [total(env, seed, driver) for seed in SEEDS] for driver in (follow, stand, spin, oncoming, reverse)
    }
    best = returns.pop(follow)
    assert min(best) > 0.0
    for driver, earned in returns.items():
        assert np.mean(earned) < 0.5 * np.mean(best), driver.__name__
        if driver is not oncoming:  # Who waits at a light for the whole episode earns little, too.
            assert all(e < b for e, b in zip(earned, best, strict=True)), driver.__name__


def test_without_anybody_to_hit_the_wrong_lane_does_not_pay_either() -> None:
    env = TownEnv(map="T3", images=False, vehicles=0, pedestrians=0, collision_penalty=0.0)
    assert sum(total(env, seed, oncoming) for seed in SEEDS) < sum(total(env, seed, follow) for seed in SEEDS)

"""The rule-based driver shows that every map can be driven."""

from __future__ import annotations

import numpy as np
import pytest

from me3bev_plugins.simulator.highway.driver import wait_at_red
from me3bev_plugins.simulator.highway.env import TownEnv
from me3bev_plugins.simulator.highway.maps import MAPS
from me3bev_plugins.simulator.highway.scene import Light

EPISODES = 6


@pytest.mark.parametrize("name", MAPS)
def test_the_autopilot_keeps_its_lane_and_the_rules(name: str) -> None:
    env = TownEnv(map=name, density="low", images=False)
    shares = []
    for seed in range(EPISODES):
        env.reset(seed=seed)
        terminated = truncated = False
        while not (terminated or truncated):
            _, _, terminated, truncated, info = env.step(env.autopilot())
            record = info["record"]
            assert record["collision"] == ""
            assert not record["red_light"]
            assert not record["stop_sign"]
            assert not record["off_road"]
            assert record["off_route"] < 0.4
            assert record["speed"] <= record["speed_limit"] + 0.5
        shares.append(record["route_done"] / record["route_length"])
    assert np.mean(shares) > 0.6


def stop_at_red(seed: int) -> TownEnv | None:
    """T3 with an ego that braked as hard as it can when it first saw a red light; None: it met none."""
    env = TownEnv(map="T3", density="low", images=False)
    env.reset(seed=seed)
    over = False
    while not over:
        red = env.situation.light == Light.RED
        if red and env.vehicle.speed == 0.0:
            return env
        _, _, terminated, truncated, _ = env.step(np.array([0.0, -1.0], np.float32) if red else env.autopilot())
        over = terminated or truncated
    return None


def test_who_has_stopped_early_before_a_red_light_waits_there_until_it_is_green() -> None:
    stopped = [env for env in map(stop_at_red, range(12)) if env is not None]
    assert len(stopped) >= 3
    gone = 0
    for env in stopped:
        over = False
        while not over and env.situation.light == Light.RED:
            assert env.autopilot()[1] < 0.0
            _, _, terminated, truncated, _ = env.step(env.autopilot())
            assert env.vehicle.speed == 0.0
            over = terminated or truncated
        for _ in range(0 if over else 20):
            _, _, terminated, truncated, _ = env.step(env.autopilot())
            if terminated or truncated:
                break
        gone += env.vehicle.speed > 2.0
    assert gone >= 2, "nobody went on"


@pytest.mark.parametrize(
    ("advice", "speed", "red", "waits"),
    [
        (3.0, 2.9, True, -2.5),
        (3.0, 3.0, True, 3.0),  # fast enough: it slows down as it would
        (3.0, 2.9, False, 3.0),
        (-8.0, 0.0, True, -8.0),  # there may be better reasons to brake
        (0.0, 0.0, True, -2.5),
    ],
)
def test_waiting_at_red(advice: float, speed: float, red: bool, waits: float) -> None:
    assert wait_at_red(advice, speed, red) == waits

"""The rule-based driver shows that every map can be driven."""

from __future__ import annotations

import numpy as np
import pytest

from me3bev_plugins.simulator.highway.env import TownEnv
from me3bev_plugins.simulator.highway.maps import MAPS

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

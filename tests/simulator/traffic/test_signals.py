"""Traffic lights take turns."""

from __future__ import annotations

import numpy as np
import pytest
from simulator.tiny_town import build_tiny_town

from me3bev_plugins.simulator.highway.scene import Light
from me3bev_plugins.simulator.highway.signals import AMBER, CLEARANCE, LONG, SHORT, SignalPlan, draw_plan, write_lights


def watch(plan: SignalPlan, seconds: float) -> np.ndarray:
    """States (T, S) every tenth of a second."""
    states = np.zeros((round(seconds * 10), len(plan.begin)), np.int32)
    for k in range(len(states)):
        write_lights(plan, k / 10, states[k])
    return states


def test_groups_are_green_in_turn_and_alike_within() -> None:
    town = build_tiny_town()
    states = watch(draw_plan(town, np.random.default_rng(3)), 120.0)
    group = np.array([signal.group for signal in town.signals])
    for g in (0, 1):
        assert (states[:, group == g] == states[:, group == g][:, :1]).all()
    first, second = states[:, group == 0][:, 0], states[:, group == 1][:, 0]
    assert ((first == Light.RED) | (second == Light.RED)).all()  # Never both green or amber.
    assert ((first == Light.RED) & (second == Light.RED)).any()


def test_green_then_amber_then_red_for_the_stated_times() -> None:
    town = build_tiny_town()
    plan = draw_plan(town, np.random.default_rng(3))
    green, cycle = float(plan.green[0]), float(plan.cycle[0])
    assert SHORT <= green <= LONG
    assert cycle == pytest.approx(2 * (green + AMBER + CLEARANCE))
    states = watch(plan, 10 * cycle)[:, 0]
    for light, seconds in ((Light.GREEN, green), (Light.AMBER, AMBER), (Light.RED, cycle - green - AMBER)):
        assert (states == light).mean() == pytest.approx(seconds / cycle, abs=0.01)
    after = states[1:][states[:-1] != states[1:]]
    before = states[:-1][states[:-1] != states[1:]]
    assert {(int(a), int(b)) for a, b in zip(before, after, strict=True)} == {
        (Light.GREEN, Light.AMBER),
        (Light.AMBER, Light.RED),
        (Light.RED, Light.GREEN),
    }


def test_the_generator_draws_the_plan() -> None:
    town = build_tiny_town()
    first, same, other = (draw_plan(town, np.random.default_rng(seed)) for seed in (1, 1, 2))
    assert first.begin.tobytes() == same.begin.tobytes()
    assert first.begin.tobytes() != other.begin.tobytes()

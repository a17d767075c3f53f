"""Reward terms: worked by hand, checked against the recipe's schema, and apart from what the log calls the reward."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from line_runs import line_trainer

from me3bev_cli.api import StepRecord
from me3bev_cli.comfort_bounds import ACCELERATION, LATERAL, LONGITUDINAL_JERK
from me3bev_cli.errors import RecipeError
from me3bev_cli.evaluation.comfort import BOUNDS
from me3bev_cli.recipe_loading import resolve_recipe
from me3bev_cli.recipe_training import RewardWeights, StageRewardWeights
from me3bev_cli.reward_terms import TERMS, bonus, formula
from me3bev_cli.training.curve import read_metrics
from me3bev_cli.training.environments import make_environments


def record(**changes: Any) -> StepRecord:
    quiet: StepRecord = {
        "time": 1.0, "x": 0.0, "y": 0.0, "heading": 0.0, "speed": 8.0, "acceleration": 0.0,
        "lateral_acceleration": 0.0, "yaw_rate": 0.0, "steering": 0.0, "longitudinal": 0.0, "waypoint_x": 2.0,
        "waypoint_y": 0.0, "similarity": 1.0, "waypoint_distance": 2.0, "speed_limit": 10.0,
        "traffic_speed": float("nan"), "background_speed": float("nan"), "route_done": 5.0, "route_length": 50.0,
        "off_route": 0.0, "off_road": False,
        "collision": "", "at_fault": False, "contact": "", "red_light": False, "red_met": False, "stop_sign": False,
        "lane_departure": False, "reward": 8.0,
    }  # fmt: skip
    return {**quiet, **changes}  # type: ignore[typeddict-item]


BEFORE = record(time=0.9, route_done=4.2, acceleration=1.0)


@pytest.mark.parametrize(
    ("term", "now", "value"),
    [
        ("progress", {}, 5.0 - 4.2),
        ("progress", {"route_done": 4.0}, -0.2),
        ("lane_keeping", {}, 0.0),
        ("lane_keeping", {"off_route": 0.7}, -0.7 / 3.5),
        ("lane_keeping", {"off_route": -0.7}, -0.2),
        ("lane_keeping", {"off_route": 9.0}, -1.0),
        ("lane_keeping", {"off_road": True}, -1.0),
        # Jerk 10 x (acceleration - 1): its bound is 4.13, and twice the bound is the most that counts.
        ("comfort", {"acceleration": 1.4}, 0.0),
        ("comfort", {"acceleration": 1.5}, -(5.0 / 4.13 - 1)),
        ("comfort", {"acceleration": 3.0}, -(3.0 / 2.4 - 1) - 1),
        ("comfort", {"acceleration": -4.86}, -(4.86 / 4.05 - 1) - 1),
        ("comfort", {"acceleration": 1.0, "lateral_acceleration": -5.868}, -0.2),
        ("comfort", {"acceleration": -20.0, "lateral_acceleration": 20.0}, -3.0),
        ("speeding", {}, 0.0),
        ("speeding", {"speed": 12.5}, -2.5),
        ("red_light", {"red_light": True}, -1.0),
        ("stop_sign", {"stop_sign": True}, -1.0),
        ("lane_departure", {"lane_departure": True}, -1.0),
        ("collision", {"collision": "static"}, -1.0),
    ],
)
def test_worked_by_hand(term: str, now: dict[str, Any], value: float) -> None:
    assert TERMS[term].function(BEFORE, record(**now)) == pytest.approx(value)


def test_the_first_step_has_no_step_before() -> None:
    first = record(acceleration=2.0)
    assert all(term.function(None, first) == 0.0 for term in TERMS.values())


def test_a_quiet_step_costs_nothing() -> None:
    values = {name: term.function(record(time=0.9, route_done=4.2), record()) for name, term in TERMS.items()}
    assert values.pop("progress") == pytest.approx(0.8)
    assert not any(values.values())


def test_the_sum_of_weight_times_term() -> None:
    now = record(speed=12.0, red_light=True)
    assert bonus({"progress": 0.5, "speeding": 2.0, "red_light": 30.0}, BEFORE, now) == pytest.approx(0.4 - 4 - 30)
    assert bonus({}, BEFORE, now) == 0.0


def test_the_bounds_are_those_of_the_metric() -> None:
    assert BOUNDS["longitudinal acceleration"] == ACCELERATION
    assert BOUNDS["lateral acceleration"] == (-LATERAL, LATERAL)
    assert BOUNDS["longitudinal jerk"] == (-LONGITUDINAL_JERK, LONGITUDINAL_JERK)


def test_the_schema_offers_every_term_and_describes_it() -> None:
    for model in (RewardWeights, StageRewardWeights):
        assert list(model.model_fields) == list(TERMS)
        for name, term in TERMS.items():
            assert model.model_fields[name].description == f"{term.summary}; reward per {term.unit}"


def test_a_stage_may_weigh_otherwise(line_recipe: Path) -> None:
    recipe = resolve_recipe(
        line_recipe, ["reward={progress: 0.5, red_light: 20}", "stages.0.reward={red_light: 0, comfort: 1}"]
    )
    assert recipe.reward_in(recipe.stages[0]) == {"progress": 0.5, "comfort": 1.0}
    assert formula({"progress": 0.5, "comfort": 1.0}) == (
        "the paper's + 0.5 x progress (m) + 1 x comfort (share of the bound)"
    )
    plain = resolve_recipe(line_recipe)
    assert plain.reward_in(plain.stages[0]) == {}
    assert formula({}) == "the paper's"


@pytest.mark.parametrize("override", ["reward={progres: 1}", "stages.0.reward={progress: -1}"])
def test_mistakes_are_named(line_recipe: Path, override: str) -> None:
    with pytest.raises(RecipeError, match=r"progres"):
        resolve_recipe(line_recipe, [override])


def test_environments_give_both_rewards(line_recipe: Path) -> None:
    recipe = resolve_recipe(line_recipe, ["reward.progress=10"])
    env = make_environments(recipe, recipe.stages[0])
    env.reset()
    action = np.array([[0.0, 1.0]] * 2, np.float32)
    env.step(action)
    _, rewards, _, infos = env.step(action)
    # The second step: speed 0.6 m/s, 0.06 m gained.
    assert [info["plain_reward"] for info in infos] == pytest.approx([0.6, 0.6])
    assert rewards == pytest.approx([1.2, 1.2])
    # After the horizon of 12 steps the next episode's first step gains nothing.
    for _ in range(10):
        _, _, dones, _ = env.step(action)
    assert dones.all()
    _, rewards, _, _ = env.step(action)
    assert rewards == pytest.approx([0.3, 0.3])


def test_the_log_keeps_them_apart(line_recipe: Path, tmp_path: Path) -> None:
    run = tmp_path / "run"
    line_trainer(line_recipe, run, "reward.progress=10", "stages.0.steps=64").train()
    rows = read_metrics(run)
    # Whoever moves at all gains on top: ten times the metres of each step but an episode's first.
    assert all(row["shaped_reward_per_step"] > row["reward_per_step"] for row in rows)
    plain = tmp_path / "plain"
    line_trainer(line_recipe, plain, "stages.0.steps=64").train()
    assert "shaped_reward_per_step" not in read_metrics(plain)[0]
    # The same first rollout: what is shown does not depend on what is added.
    assert read_metrics(plain)[0]["reward_per_step"] == pytest.approx(rows[0]["reward_per_step"])

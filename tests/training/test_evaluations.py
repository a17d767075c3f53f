"""Evaluation during training: same seeds each time, the best is kept, and training goes on as if nothing had been."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from line_runs import line_trainer
from typer.testing import CliRunner

from me3bev_cli.errors import CheckpointError, RecipeError
from me3bev_cli.evaluation.course import Course, Visit
from me3bev_cli.evaluation.drivers import Policy
from me3bev_cli.evaluation.runner import drive as one_by_one
from me3bev_cli.evaluation.side_by_side import drive, split
from me3bev_cli.pipeline.control import Controller
from me3bev_cli.recipe_loading import resolve_recipe
from me3bev_cli.training.best import read_best
from me3bev_cli.training.checkpoint import WEIGHTS, find_checkpoint
from me3bev_cli.training.curve import read_metrics
from me3bev_cli.training.evaluations import SCORE, Plan

EVERY_64 = ["evaluation={every: 64, episodes: 3, maps: [F1, F2], envs: 4}"]


def evaluated(run: Path) -> list[dict[str, Any]]:
    return [row for row in read_metrics(run) if SCORE in row]


def weights(run: Path) -> dict[str, torch.Tensor]:
    return Controller.load(run).network.state_dict()


def test_training_does_not_notice(line_recipe: Path, tmp_path: Path) -> None:
    line_trainer(line_recipe, tmp_path / "with", *EVERY_64).train()
    line_trainer(line_recipe, tmp_path / "without").train()
    one, other = weights(tmp_path / "with"), weights(tmp_path / "without")
    assert all(torch.equal(one[key], other[key]) for key in other)
    shown = [[row["reward_per_step"] for row in read_metrics(tmp_path / name) if SCORE not in row] for name in
             ("with", "without")]  # fmt: skip
    assert shown[0] == shown[1]


def test_rows_come_when_they_are_due(line_recipe: Path, tmp_path: Path) -> None:
    run = tmp_path / "run"
    line_trainer(line_recipe, run, *EVERY_64).train()
    rows = evaluated(run)
    assert [row["steps"] for row in rows] == [64, 128, 192]
    assert all(row["eval_episodes"] == 6 for row in rows)
    assert all(0 <= row[SCORE] <= 100 and 0 <= row["eval_completion"] <= 1 for row in rows)
    # Going on with a finished run adds none.
    again = line_trainer(line_recipe, run)
    again.resume()
    again.train()
    assert len(evaluated(run)) == 3


def test_off_by_default(line_recipe: Path, tmp_path: Path) -> None:
    run = tmp_path / "run"
    line_trainer(line_recipe, run).train()
    assert evaluated(run) == []
    with pytest.raises(CheckpointError, match=r"no checkpoint 'best'.*evaluation\.every"):
        find_checkpoint(run, "best")


def test_the_best_is_kept(line_recipe: Path, tmp_path: Path) -> None:
    run = tmp_path / "run"
    line_trainer(line_recipe, run, *EVERY_64, "stages.0.checkpoint_every=1", "stages.0.steps=320").train()
    rows = evaluated(run)
    best = read_best(run)
    assert best is not None
    top = max(row[SCORE] for row in rows)
    # The first of those that are equal.
    assert (best["steps"], best[SCORE]) == next((row["steps"], row[SCORE]) for row in rows if row[SCORE] == top)
    assert json.loads((run / "summary.json").read_text())["best_evaluation"] == best
    folder = find_checkpoint(run, "best")
    assert folder.name == f"best_{best['steps']:09d}"
    assert [path.name for path in folder.parent.glob("*best*")] == [folder.name]
    # It drives as it was judged.
    plan = Plan.of(resolve_recipe(run / "recipe.yaml"))
    network = Controller.load(run, "best").network
    episodes = drive(network, plan.makers, 1, "best", lambda: False)
    assert episodes is not None
    assert np.mean([e["reward"].mean() for e in episodes]) == pytest.approx(best["eval_reward_per_step"], rel=1e-5)


def test_eval_finds_the_best(line_recipe: Path, tmp_path: Path) -> None:
    from me3bev_cli.main import app

    run = tmp_path / "run"
    line_trainer(line_recipe, run, *EVERY_64).train()
    arguments = ["eval", "--run", str(run), "--checkpoint", "best", "--episodes", "1", "--workers", "0"]
    result = CliRunner().invoke(app, arguments, catch_exceptions=False)
    assert result.exit_code == 0
    assert (run / "eval" / "best").is_dir()


def test_a_replaced_best_that_was_not_removed_yet_is_no_trouble(line_recipe: Path, tmp_path: Path) -> None:
    run = tmp_path / "run"
    line_trainer(line_recipe, run, *EVERY_64).train()
    kept = find_checkpoint(run, "best")
    older = kept.with_name("best_000000001")
    older.mkdir()
    (older / "evaluation.json").write_text(json.dumps({"steps": 1, SCORE: -1.0}))
    (kept.with_name("best_000000002")).mkdir()
    assert find_checkpoint(run, "best") == kept
    assert (kept / WEIGHTS).exists()


@pytest.mark.parametrize("workers", [1, 2])
def test_the_same_episodes_for_any_number_of_workers(line_recipe: Path, workers: int) -> None:
    recipe = resolve_recipe(line_recipe, ["evaluation={episodes: 3, densities: [low, high], envs: 4}"])
    network = Controller.untrained(recipe).network
    episodes = drive(network, Plan.of(recipe).makers, workers, "me", lambda: False)
    assert episodes is not None
    assert [(e.map, e.density, e.index) for e in episodes] == [
        ("F1", density, index) for density in ("low", "high") for index in range(3)
    ]
    assert len({e.seed for e in episodes}) == 6
    # One environment at a time gives the same drive.
    maker = Plan.of(recipe).makers[0]
    env = maker.simulator.make_env(recipe.observation, map="F1", density="low")
    alone = one_by_one(env, Policy(Controller(network, recipe)), episodes[0].seed)
    assert [record["x"] for record in alone.records] == pytest.approx(episodes[0]["x"].tolist(), rel=1e-4)


def test_a_stop_ends_it(line_recipe: Path) -> None:
    recipe = resolve_recipe(line_recipe, ["evaluation.envs=2"])
    network = Controller.untrained(recipe).network.train()
    assert drive(network, Plan.of(recipe).makers, 1, "me", lambda: True) is None
    assert network.training


def test_visits_are_split_into_runs() -> None:
    visits = [Visit("F1", "low", i, i) for i in range(5)]
    assert [len(part) for part in split(visits, 3)] == [1, 2, 2]
    assert sum(split(visits, 8), ()) == tuple(visits)


def test_a_course_stands_still_after_its_last_visit(line_recipe: Path) -> None:
    recipe = resolve_recipe(line_recipe)
    maker = Plan.of(recipe).makers[0]
    course = Course(maker.simulator, maker.observation, None, True, maker.visits[:1])
    course.reset()
    for _ in range(12):
        _, _, terminated, truncated, info = course.step(np.zeros(2))
    assert (terminated, truncated, info["weather"]) == (False, True, "sun")
    assert course.reset()[1] == {"idle": True}
    assert course.step(np.zeros(2))[1:] == (0.0, False, False, {"idle": True})


def test_unknown_maps_are_named(line_recipe: Path) -> None:
    with pytest.raises(RecipeError, match=r"evaluation\.maps\.1: unknown map 'F3'"):
        resolve_recipe(line_recipe, ["evaluation.maps=[F1, F3]"])


def test_checkpoints_out_of_every_so_many_steps_stay(line_recipe: Path, tmp_path: Path) -> None:
    run = tmp_path / "run"
    overrides = ["stages.0.checkpoint_every=1", "stages.0.steps=384", "keep_every=96"]
    line_trainer(line_recipe, run, *overrides).train()
    kept = sorted(int(path.name[5:]) for path in (run / "checkpoints").glob("step_*"))
    assert kept == [96, 192, 256, 288, 320, 352, 384]

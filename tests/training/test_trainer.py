"""Training runs end to end on a small fake world: it learns, stops, goes on and refuses what is damaged."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from typer.testing import CliRunner

from me3bev_cli.errors import CheckpointError, RunError
from me3bev_cli.pipeline.control import Controller
from me3bev_cli.recipe_loading import dump, resolve_recipe
from me3bev_cli.stopping import Stop
from me3bev_cli.training.checkpoint import WEIGHTS, checkpoints, find_checkpoint, load_progress
from me3bev_cli.training.curve import read_metrics
from me3bev_cli.training.display import Display
from me3bev_cli.training.environments import first_episode_of, make_environments
from me3bev_cli.training.run import choose_run, make_run, newest_run, open_run
from me3bev_cli.training.trainer import InterruptedTrainingError, Trainer


def trainer(path: Path, run: Path, *overrides: str) -> Trainer:
    recipe = resolve_recipe(path, overrides)
    if not run.exists():
        make_run(run, dump(recipe))
    return Trainer(recipe, run, Display(sum(s.steps for s in recipe.stages), len(recipe.stages)), Stop())


def weights(run: Path) -> dict[str, torch.Tensor]:
    return Controller.load(run).network.state_dict()


@pytest.mark.parametrize("overrides", [[], ["context={kind: stream}"], ["temporal=null", "policy.distribution=beta"]])
def test_a_run_leaves_everything_behind(line_recipe: Path, tmp_path: Path, overrides: list[str]) -> None:
    run = tmp_path / "run"
    last = trainer(line_recipe, run, *overrides).train()
    assert {p.name for p in run.iterdir()} >= {
        "recipe.yaml", "versions.json", "metrics.jsonl", "tensorboard", "checkpoints", "reward.png", "summary.json",
    }  # fmt: skip
    rows = read_metrics(run)
    assert [row["steps"] for row in rows] == [32 * k for k in range(1, 7)]
    assert all(row["reward_per_step"] is not None for row in rows)
    assert "kl" in rows[-1]
    assert load_progress(last).done
    assert json.loads((run / "summary.json").read_text())["steps"] == 192


def test_it_learns_to_move(line_recipe: Path, tmp_path: Path) -> None:
    run = tmp_path / "run"
    trainer(
        line_recipe,
        run,
        "stages.0.steps=4096",
        "stages.0.learning_rate=0.003",
        "stages.0.rollout=64",
        "stages.0.gamma=0.9",
    ).train()
    rows = [row["reward_per_step"] for row in read_metrics(run)]
    assert np.mean(rows[-5:]) > np.mean(rows[:3]) + 0.3


def test_same_seed_same_weights(line_recipe: Path, tmp_path: Path) -> None:
    for name in ("a", "b"):
        trainer(line_recipe, tmp_path / name).train()
    one, other = weights(tmp_path / "a"), weights(tmp_path / "b")
    assert all(torch.equal(one[key], other[key]) for key in one)


def test_a_stop_saves_and_the_run_goes_on(line_recipe: Path, tmp_path: Path) -> None:
    run = tmp_path / "run"
    first = trainer(line_recipe, run)
    step = first.display.step

    def ask_at_100(line: Callable[[], dict[str, Any]]) -> None:
        step(line)
        first.stop.asked = line()["steps"] >= 100

    first.display.step = ask_at_100  # type: ignore[method-assign]
    with pytest.raises(InterruptedTrainingError):
        first.train()
    # The rollout from step 96 was not finished: it is collected again.
    assert load_progress(find_checkpoint(run)).total_steps == first.progress.total_steps == 96
    second = trainer(line_recipe, run)
    second.resume()
    assert second.progress.total_steps == 96
    second.train()
    assert load_progress(find_checkpoint(run)).total_steps == 192


def test_updates_after_the_checkpoint_are_made_again(line_recipe: Path, tmp_path: Path) -> None:
    """As after kill -9: the log is ahead of the newest checkpoint, its last line cut short."""
    run = tmp_path / "run"
    trainer(line_recipe, run, "stages.0.checkpoint_every=64").train()
    for folder in checkpoints(run)[1:]:
        shutil.rmtree(folder)
    with open(run / "metrics.jsonl", "a") as file:
        file.write('{"stage": 0, "ste')
    again = trainer(line_recipe, run)
    again.resume()
    kept = [row["steps"] for row in read_metrics(run)]
    assert kept == [step for step in range(32, 193, 32) if step <= again.progress.total_steps]
    again.train()
    assert [row["steps"] for row in read_metrics(run)] == list(range(32, 193, 32))


def test_a_finished_run_has_nothing_left_to_do(line_recipe: Path, tmp_path: Path) -> None:
    run = tmp_path / "run"
    trainer(line_recipe, run).train()
    before = weights(run)
    again = trainer(line_recipe, run)
    again.resume()
    again.train()
    assert all(torch.equal(before[key], value) for key, value in weights(run).items())


def test_two_stages_run_in_order_and_frozen_parts_stay(line_recipe: Path, tmp_path: Path) -> None:
    stage = "{kind: ppo, steps: 64, envs: 2, rollout: 16, segment: 8, minibatch: 16"
    run = tmp_path / "run"
    frozen = trainer(line_recipe, run, f"stages=[{stage}, map: F2, freeze: [spatial]}}, {stage}, freeze: [temporal]}}]")
    before = {key: value.clone() for key, value in frozen.network.state_dict().items()}
    spatial_after_first: dict[str, torch.Tensor] = {}
    save = frozen.save

    def watched(state: dict[str, Any]) -> Path:
        if not spatial_after_first:
            spatial_after_first.update({k: v.clone() for k, v in frozen.network.spatial.state_dict().items()})  # type: ignore[union-attr]
        return save(state)

    frozen.save = watched  # type: ignore[method-assign]
    frozen.train()
    assert all(torch.equal(value, before[f"spatial.{key}"]) for key, value in spatial_after_first.items())
    after = frozen.network.state_dict()
    assert any(not torch.equal(after[key], before[key]) for key in after if key.startswith("spatial."))
    assert [row["stage"] for row in read_metrics(run)] == [0, 0, 1, 1]


def test_the_learning_rate_steps_down_in_absolute_steps(line_recipe: Path, tmp_path: Path) -> None:
    run = tmp_path / "run"
    trainer(line_recipe, run, "stages.0.learning_rate={initial: 0.01, drop: 0.5, every: 64}").train()
    # An update counts the steps of the rollout that it learns from: after 32 the full rate, after 64 and 96 half of it.
    assert [row["learning_rate"] for row in read_metrics(run)] == [0.01, 0.005, 0.005, 0.0025, 0.0025, 0.00125]


def test_every_episode_has_a_seed_of_its_own(line_recipe: Path) -> None:
    recipe = resolve_recipe(line_recipe)
    env = make_environments(recipe, recipe.stages[0])
    seeds = []
    for _ in range(2):
        env.reset()
        seeds += env.get_attr("seed_used")
    assert len(set(seeds)) == 4
    later = make_environments(recipe, recipe.stages[0], first_episode_of(1))
    later.reset()
    assert not set(seeds) & set(later.get_attr("seed_used"))


def test_a_stage_trains_in_its_own_weather(line_recipe: Path) -> None:
    recipe = resolve_recipe(line_recipe, ["weather.training=[moon, mist]"])
    assert make_environments(recipe, recipe.stages[0]).get_attr("weathers") == [("moon", "mist")] * 2
    recipe = resolve_recipe(line_recipe, ["weather.training=[moon, mist]", "stages.0.weather=[sun]"])
    assert make_environments(recipe, recipe.stages[0]).get_attr("weathers") == [("sun",)] * 2


def test_damaged_checkpoints_are_named(line_recipe: Path, tmp_path: Path) -> None:
    run = tmp_path / "run"
    with pytest.raises(RunError, match="there is no run at"):
        find_checkpoint(run)
    trainer(line_recipe, run).train()
    folder = find_checkpoint(run)
    path = folder / WEIGHTS
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(CheckpointError, match=r"policy.safetensors is damaged or truncated"):
        Controller.load(run)
    path.unlink()
    with pytest.raises(CheckpointError, match=r"has no policy.safetensors"):
        Controller.load(run)
    path.write_bytes(whole)
    text = (folder / "recipe.yaml").read_text()
    (folder / "recipe.yaml").write_text(text.replace("name: gru", "name: lstm"))
    with pytest.raises(CheckpointError, match="another architecture"):
        Controller.load(run)
    with pytest.raises(CheckpointError, match="no checkpoint 'step_1'"):
        find_checkpoint(run, "step_1")


def test_only_the_newest_checkpoints_are_kept(line_recipe: Path, tmp_path: Path) -> None:
    run = tmp_path / "run"
    trainer(line_recipe, run, "stages.0.checkpoint_every=1", "stages.0.steps=320").train()
    assert len(checkpoints(run)) == 5


def test_runs_are_found(line_recipe: Path, tmp_path: Path) -> None:
    recipe = resolve_recipe(line_recipe)
    assert newest_run(tmp_path / "none") is None
    run = choose_run(recipe, tmp_path / "runs" / "a")
    make_run(run, dump(recipe))
    assert newest_run(tmp_path / "runs") == run
    with pytest.raises(RunError, match="exists and is not empty"):
        choose_run(recipe, run)
    with pytest.raises(RunError, match="is not a run folder"):
        open_run(tmp_path)


def test_what_cannot_be_built_leaves_nothing_behind(line_recipe: Path, tmp_path: Path) -> None:
    from me3bev_cli.main import app

    if torch.cuda.is_available():
        pytest.skip("asks for a CUDA that is there")
    arguments = ["train", str(line_recipe), "--out", str(tmp_path / "run"), "--set", "device=cuda"]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 2
    assert "device 'cuda' is not available here. Allowed: auto, cpu" in result.stderr
    assert not (tmp_path / "run").exists()


def test_train_by_command_line(line_recipe: Path, tmp_path: Path) -> None:
    from me3bev_cli.main import app

    out = tmp_path / "run"
    result = CliRunner().invoke(
        app, ["train", str(line_recipe), "--out", str(out), "--json", "-"], catch_exceptions=False
    )
    assert result.exit_code == 0
    assert json.loads(result.stdout)["steps"] == 192
    assert "reward/step" in result.stderr
    assert "left" in result.stderr

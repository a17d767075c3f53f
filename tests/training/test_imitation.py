"""Imitation on the fake world: it learns what the autopilot does, in the policy's own states, and survives stops."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from me3bev_cli.errors import RecipeError
from me3bev_cli.pipeline.control import Controller
from me3bev_cli.recipe_loading import dump, resolve_recipe
from me3bev_cli.recipe_stages import LearningRate
from me3bev_cli.stopping import Stop
from me3bev_cli.training.checkpoint import checkpoints, find_checkpoint, load_progress
from me3bev_cli.training.curve import read_metrics
from me3bev_cli.training.demonstrations import Pool, Round, drifting_noise
from me3bev_cli.training.display import Display
from me3bev_cli.training.imitation_stage import ImitationRunner
from me3bev_cli.training.run import make_run
from me3bev_cli.training.trainer import InterruptedTrainingError, Trainer

STAGE = (
    "kind: imitation, steps: 192, envs: 2, workers: 1, rollout: 32, segment: 8, minibatch: 16, epochs: 2, pool: 128, "
    "learning_rate: 0.01, checkpoint_every: 64"
)


def trainer(path: Path, run: Path, *overrides: str, stage: str = STAGE) -> Trainer:
    recipe = resolve_recipe(path, [f"stages=[{{{stage}}}]", *overrides])
    if not run.exists():
        make_run(run, dump(recipe))
    return Trainer(recipe, run, Display(sum(s.steps for s in recipe.stages), len(recipe.stages)), Stop())


def weights(run: Path) -> dict[str, torch.Tensor]:
    return Controller.load(run).network.state_dict()


@pytest.mark.parametrize("overrides", [[], ["context={kind: stream}"], ["temporal=null", "policy.distribution=beta"]])
def test_cloning_reaches_what_the_autopilot_does(line_recipe: Path, tmp_path: Path, overrides: list[str]) -> None:
    """It always drives straight on with full throttle."""
    made = trainer(line_recipe, tmp_path / "run", *overrides, "stages.0.epochs=12", "stages.0.learning_rate=0.02")
    made.train()
    rows = read_metrics(tmp_path / "run")
    assert [row["steps"] for row in rows] == [64, 128, 192]
    assert [row["round"] for row in rows] == [0, 1, 2]
    assert rows[0]["autopilot_share"] == 1.0
    assert rows[0]["longitudinal_error"] is None
    assert rows[-1]["autopilot_share"] == 0.0
    assert rows[-1]["longitudinal_error"] < 0.25
    assert rows[-1]["steering_error"] < 0.1
    assert rows[-1]["collision_rate"] == 0.0


def test_later_rounds_are_the_policys_own_and_the_autopilot_says_what_to_do(line_recipe: Path, tmp_path: Path) -> None:
    """An untrained policy stands still; the autopilot would not."""
    runner = ImitationRunner(made := trainer(line_recipe, tmp_path / "run", "stages.0.pool=192"), made.recipe.stages[0])
    runner.stage = made.recipe.stages[0].model_copy(update={"epochs": 1, "learning_rate": LearningRate(initial=1e-9)})
    runner.learner.stage = runner.stage
    runner.run()
    first, *_, last = runner.pool.rounds
    assert first.guided.all()
    assert first.actions[..., 1].mean() > 0.5
    assert not last.guided.any()
    assert np.abs(last.actions).max() < 0.2
    assert (last.labels == np.array([0.0, 1.0], np.float32)).all()
    # Frames, labels and starts of one moment stand in one row: an episode lasts 12 steps.
    assert last.starts[last.prefix :, 0].nonzero()[0].tolist() == [0, 12, 24]
    speeds = last.frames["vehicle"][last.prefix :, 0, 1]
    assert speeds[12] == speeds[24] == 0.0
    assert np.allclose(speeds[1:12], np.maximum(0, 0.3 * last.actions[:11, 0, 1].cumsum()), atol=0.05)


def test_the_autopilot_may_drive_a_share_of_every_round(line_recipe: Path, tmp_path: Path) -> None:
    trainer(line_recipe, tmp_path / "run", "stages.0.beta=0.6", "stages.0.steps=256").train()
    shares = [row["autopilot_share"] for row in read_metrics(tmp_path / "run")]
    assert shares[0] == 1.0
    assert any(0 < share < 1 for share in shares[1:])


def test_what_the_deviation_was_it_stays(line_recipe: Path, tmp_path: Path) -> None:
    made = trainer(line_recipe, tmp_path / "run")
    before = made.network.actor.log_std.detach().clone()
    made.train()
    assert torch.equal(made.network.actor.log_std, before)


def test_what_the_critic_errs_by_changes_nothing_of_what_the_policy_learns(line_recipe: Path, tmp_path: Path) -> None:
    """Nor by how much: clipped together, a large error of the one would take the other's gradient away."""
    for name, value in (("small", "1e-6"), ("large", "1e6")):
        trainer(line_recipe, tmp_path / name, f"stages.0.value={value}").train()
    small, large = weights(tmp_path / "small"), weights(tmp_path / "large")
    assert all(torch.equal(small[key], large[key]) for key in small if not key.startswith("critic."))
    assert any(not torch.equal(small[key], large[key]) for key in small if key.startswith("critic."))


@pytest.mark.parametrize("part", ["spatial", "encoders"])
def test_frozen_parts_stay_and_their_embeddings_are_stored(line_recipe: Path, tmp_path: Path, part: str) -> None:
    made = trainer(line_recipe, tmp_path / "run", f"stages.0.freeze=[{part}]")
    before = {key: value.clone() for key, value in made.network.state_dict().items()}
    runner = ImitationRunner(made, made.recipe.stages[0])
    runner.run()
    after = made.network.state_dict()
    assert all(torch.equal(after[key], value) for key, value in before.items() if key.startswith(f"{part}."))
    assert any(not torch.equal(after[key], value) for key, value in before.items())
    keys = runner.pool.rounds[0].frames.keys()
    assert ("images" in keys) == (part != "spatial")
    assert ("embedding.bev" in keys) == (part == "spatial")


def stopped(path: Path, run: Path, at: int, *overrides: str) -> Trainer:
    """Trained until something was shown `at` times, then stopped."""
    made = trainer(path, run, *overrides)
    made.resume()
    step, shown = made.display.step, 0

    def count(line: Callable[[], dict[str, Any]]) -> None:
        nonlocal shown
        shown += 1
        made.stop.asked = shown >= at
        step(line)

    made.display.step = count  # type: ignore[method-assign]
    with pytest.raises(InterruptedTrainingError):
        made.train()
    return made


@pytest.mark.parametrize(
    "overrides", [[], ["context={kind: stream}", "stages.0.freeze=[spatial]", "stages.0.beta=0.5"]]
)
def test_stopped_anywhere_it_ends_with_the_same_weights(
    line_recipe: Path, tmp_path: Path, overrides: list[str]
) -> None:
    """Each round shows 32 steps and 8 minibatches. The pool holds two rounds of three."""
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    trainer(line_recipe, whole, *overrides).train()
    for at in (7, 36, 1, 40, 33):
        stopped(line_recipe, parts, at, *overrides)
    last = trainer(line_recipe, parts, *overrides)
    last.resume()
    last.train()
    one, other = weights(whole), weights(parts)
    assert all(torch.equal(one[key], other[key]) for key in one)
    timing = ("steps_per_second",)
    rows = [[{k: v for k, v in row.items() if k not in timing} for row in read_metrics(run)] for run in (whole, parts)]
    assert rows[0] == rows[1]
    assert load_progress(find_checkpoint(parts)).episodes == load_progress(find_checkpoint(whole)).episodes


def test_killed_it_ends_with_the_same_weights(line_recipe: Path, tmp_path: Path) -> None:
    """As after kill -9: the log is ahead of the newest checkpoint."""
    whole, run = tmp_path / "whole", tmp_path / "run"
    for path in (whole, run):
        trainer(line_recipe, path).train()
    for folder in checkpoints(run)[1:]:
        shutil.rmtree(folder)
    again = trainer(line_recipe, run)
    again.resume()
    assert again.progress.total_steps == 64
    again.train()
    one, other = weights(whole), weights(run)
    assert all(torch.equal(one[key], other[key]) for key in one)
    assert [row["steps"] for row in read_metrics(run)] == [64, 128, 192]


def test_ppo_follows_from_its_weights(line_recipe: Path, tmp_path: Path) -> None:
    ppo = "{kind: ppo, steps: 64, envs: 2, workers: 1, rollout: 16, segment: 8, minibatch: 16, freeze: [spatial]}"
    run = tmp_path / "run"
    recipe = resolve_recipe(line_recipe, [f"stages=[{{{STAGE}}}, {ppo}]"])
    make_run(run, dump(recipe))
    Trainer(recipe, run, Display(256, 2), Stop()).train()
    assert [row["kind"] for row in read_metrics(run)] == ["imitation"] * 3 + ["ppo"] * 2


def test_returns_by_hand() -> None:
    """Three steps; environment 0 ends for good after the second, 1 is cut off by time there, 2 goes on."""
    one = Round(index=0, first=0, length=3, envs=3, prefix=0)
    one.rewards[:] = [[1, 1, 1], [2, 2, 2], [3, 3, 3]]
    one.ended[1, 0] = one.cut[1, 1] = True
    one.finish(gamma=0.5, scale=10.0)
    beyond = 20.0 / (1 - 0.5)
    end = 30 + 0.5 * beyond
    assert one.returns.T.tolist() == [
        [10 + 0.5 * 20, 20, end],
        [10 + 0.5 * (20 + 0.5 * beyond), 20 + 0.5 * beyond, end],
        [10 + 0.5 * (20 + 0.5 * end), 20 + 0.5 * end, end],
    ]


def test_the_pool_hands_out_whole_segments_of_the_newest_rounds() -> None:
    pool = Pool(capacity=16, segment=2, prefix=1)
    for index in range(3):
        one = Round(index=index, first=0, length=4, envs=2, prefix=1)
        for row in range(4):
            number = 100 * index + 10 * row + np.arange(2.0)
            one.observe(row, {"x": number}, np.full(2, row == 0))
            one.labels[row] = number[:, None]
        pool.add(one)
    assert [one.index for one in pool.rounds] == [1, 2]
    order = pool.order(np.random.default_rng(0), batches=4, per_batch=2)
    assert sorted(map(tuple, order.reshape(-1, 3).tolist())) == sorted(map(tuple, pool.segments().tolist()))
    lesson = pool.lesson(np.array([[0, 0, 1], [1, 2, 0]]))
    assert lesson.observations["x"].tolist() == [0, 101, 111, 210, 220, 230]
    assert lesson.starts.tolist() == [[True, True, False], [False, False, False]]
    assert lesson.labels[:, 0].tolist() == [101, 111, 220, 230]


def test_noise_lasts_and_has_its_deviation() -> None:
    noise = drifting_noise(np.random.default_rng(0), 5000, 2, (0.1, 0.3))
    assert np.allclose(noise.std((0, 1)), (0.1, 0.3), rtol=0.15)
    lagged = np.corrcoef(noise[:-1, 0, 0], noise[1:, 0, 0])[0, 1]
    assert 0.85 < lagged < 0.95


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("stages.0.rollout=30", "rollout 30 is not a multiple of segment 8"),
        ("stages.0.minibatch=20", "minibatch 20 is not a multiple of segment 8"),
        ("stages.0.minibatch=128", "minibatch 128 is more than envs x rollout = 64 frames"),
        ("stages.0.pool=32", "pool 32 is less than one round, envs x rollout = 64 frames"),
        ("stages.0.beta=1", "1 is out of range"),
        ("stages.0.clip=0.2", "unknown key 'clip'"),
        ("stages.0.loss=nll", "'nll' is not among the choices"),
        ("stages.0.kind=imitate", "did you mean 'imitation'"),
    ],
)
def test_impossible_settings_are_refused(line_recipe: Path, override: str, message: str) -> None:
    with pytest.raises(RecipeError, match=re.escape(message)):
        resolve_recipe(line_recipe, [f"stages=[{{{STAGE}}}]", override])

"""bench-train on the line world: the contestants learn the same from the same samples, and memory is counted."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import torch
from typer.testing import CliRunner

from me3bev_cli.bench import train
from me3bev_cli.bench.train import OURS, OURS_FROZEN, PLAIN, PLAIN_FROZEN, rollout_bytes
from me3bev_cli.bench.train_contestants import Contest
from me3bev_cli.bench.train_stacked import StackedFrames
from me3bev_cli.errors import MemoryShortError, UserError
from me3bev_cli.main import app
from me3bev_cli.pipeline.policy import STARTS
from me3bev_cli.recipe_loading import resolve_recipe
from me3bev_cli.training.environments import make_environments

T = 4
IMAGES, VECTORS = 2 * 3 * 16 * 32, 4 * (4 + 9 + 5)
SB3 = 4 * (2 + 6)
"""Bytes that SB3's buffer keeps of a step beside its observation."""


def test_figures_are_written_and_shown(line_recipe: Path, tmp_path: Path) -> None:
    path = tmp_path / "figures.json"
    result = CliRunner().invoke(
        app, ["bench-train", str(line_recipe), "--samples", "8", "--steps", "4", "--rounds", "2", "--json", str(path)]
    )
    assert result.exit_code == 0, result.output
    report = json.loads(path.read_text())
    assert {"update_speedup", "memory_ratio", "frozen_speedup", "targets", "spread", "machine", "versions"} <= set(
        report
    )
    assert report["targets"] == {"update_speedup": 3.0, "memory_ratio": 3.5, "frozen_speedup": 20.0}
    assert [row["envs"] for row in report["environments"]] == [1, 2, 4]
    for row in report["environments"]:
        whole = 1 / (1 / row["collection_steps_per_s"] + 1 / row["update_steps_per_s"])
        assert row["overall_steps_per_s"] == pytest.approx(whole)
        assert 0 < row["environment_share"] < 1
    assert report["setup"]["samples"] == 8
    for shown in ("update, ms per sample", "at least 20", "timed: SB3's train() of both", "environment steps/s"):
        assert shown in result.output


def test_memory_is_that_of_the_arrays_at_the_recipes_size(line_recipe: Path) -> None:
    held = rollout_bytes(Contest(resolve_recipe(line_recipe, []), 8))
    steps, envs = 16, 2
    own = envs * (SB3 * steps + T - 1 + steps)
    assert held[OURS] == own + envs * (T - 1 + steps) * (IMAGES + VECTORS)
    assert held[OURS_FROZEN] == own + envs * (T - 1 + steps) * (4 * 4 * 8 + VECTORS)
    assert held[PLAIN] == envs * steps * (SB3 + T * (IMAGES + VECTORS + 1))


def test_all_learn_from_the_same_samples(line_recipe: Path) -> None:
    contest = Contest(resolve_recipe(line_recipe, []), 16)
    with train._filled(contest, lambda *_: None) as models:
        seen: dict[str, list[int]] = {name: [] for name in models}
        grads = {}
        for name, model in models.items():
            network = model.policy.network
            network.spatial.register_forward_pre_hook(lambda _, given, n=name: seen[n].append(len(given[0])))
            model.train()
            grads[name] = {key: p.grad for key, p in network.named_parameters() if p.grad is not None}
    for mine, theirs in ((OURS, PLAIN), (OURS_FROZEN, PLAIN_FROZEN)):
        assert grads[mine].keys() == grads[theirs].keys()
        for key, grad in grads[mine].items():
            torch.testing.assert_close(grad, grads[theirs][key], rtol=1e-4, atol=1e-5)
    assert {name: sum(frames) for name, frames in seen.items()} == {
        OURS: 3 + 16, PLAIN: 16 * T, OURS_FROZEN: 0, PLAIN_FROZEN: 16 * T,
    }  # fmt: skip


def test_stacks_hold_the_last_frames_of_their_own_episode(line_recipe: Path) -> None:
    recipe = resolve_recipe(line_recipe, [])
    envs, single = (make_environments(recipe, recipe.stages[0]) for _ in range(2))
    stacked = StackedFrames(envs, T)
    roads, infos = [single.reset()["road"]], []
    stacks = [stacked.reset()]
    for _ in range(14):
        observation, _, _, infos_one = single.step(np.zeros((2, 2), np.float32))
        roads.append(observation["road"])
        infos.append(infos_one)
        stacks.append(stacked.step(np.zeros((2, 2), np.float32))[0])
    # Episodes last twelve steps: frame 12 begins the second.
    for t, past in ((0, 1), (2, 3), (11, 4), (12, 1), (13, 2)):
        stack = stacks[t]
        for e in range(2):
            wanted = np.stack([roads[t - k][e] for k in reversed(range(past))])
            assert np.array_equal(stack["road"][e, T - past :], wanted)
            assert not stack["road"][e, : T - past].any()
            if past < T:
                assert stack[STARTS][e].tolist()[T - past :] == [1] + [0] * (past - 1)
    assert stacked.observation_space.contains({key: value[0] for key, value in stacks[13].items()})


@pytest.mark.parametrize("overrides", [["context={kind: stream}"], ["temporal=null"], ["modalities=[vr, nav]"]])
def test_recipes_without_a_window_of_images_are_refused(line_recipe: Path, overrides: list[str]) -> None:
    with pytest.raises(UserError, match="window of images"):
        Contest(resolve_recipe(line_recipe, overrides), 8)


def test_stacks_that_cannot_fit_are_refused(line_recipe: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(train, "available_on", lambda _: 300_000)
    with pytest.raises(MemoryShortError, match="8 samples of 4 frames"):
        train.check_stacks_fit(Contest(resolve_recipe(line_recipe, []), 8))
    train.check_stacks_fit(Contest(resolve_recipe(line_recipe, ["stages.0.microbatch=4"]), 8))


def test_a_recipe_needs_a_ppo_stage(line_recipe: Path) -> None:
    recipe = resolve_recipe(line_recipe, ["stages=[{kind: imitation, steps: 64, segment: 8, minibatch: 16}]"])
    with pytest.raises(UserError, match="no ppo stage"):
        Contest(recipe, 8)

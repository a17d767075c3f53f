"""The update against plain Stable-Baselines3: its own collection, buffer, GAE and loss on stacked observations."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.buffers import DictRolloutBuffer
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import Logger

from me3bev_cli.bench.train_stacked import StackedFrames, StackedPolicy
from me3bev_cli.pipeline.assemble import build_network
from me3bev_cli.pipeline.policy import DrivingPolicy
from me3bev_cli.recipe_loading import resolve_recipe
from me3bev_cli.training.environments import make_environments
from me3bev_cli.training.rollout import SequenceRolloutBuffer
from me3bev_cli.training.sequence_ppo import SequencePPO

STEPS, ENVS, SEGMENT, T = 32, 2, 8, 4
SIZES: dict[str, Any] = {
    "n_steps": STEPS, "batch_size": STEPS * ENVS, "n_epochs": 1, "learning_rate": 0.0, "max_grad_norm": 1e9,
    "ent_coef": 0.01, "gamma": 0.9, "gae_lambda": 0.8, "seed": 5, "device": "cpu",
}  # fmt: skip


class Quiet(BaseCallback):
    """Watches nothing."""

    def _on_step(self) -> bool:
        return True


def plain(path: Path, overrides: list[str], **policy: Any) -> PPO:
    """Stable-Baselines3 as anyone would use it."""
    recipe = resolve_recipe(path, overrides)
    envs = StackedFrames(make_environments(recipe, recipe.stages[0]), T)
    network = build_network(recipe, 1)
    return PPO(StackedPolicy, envs, policy_kwargs={"network": network, **policy}, **SIZES)  # type: ignore[arg-type]


def ours(path: Path, overrides: list[str], stored: bool = True, sizes: Any = None, **policy: Any) -> SequencePPO:
    recipe = resolve_recipe(path, overrides)
    network = build_network(recipe, 1)
    return SequencePPO(
        DrivingPolicy,
        make_environments(recipe, recipe.stages[0]),
        rollout_buffer_class=SequenceRolloutBuffer,
        rollout_buffer_kwargs={"segment": SEGMENT, "prefix": network.prefix, "seed": 0},
        policy_kwargs={"network": network, **policy},
        store_embeddings=stored,
        **{**SIZES, **(sizes or {})},
    )


def collect(model: PPO, rollouts: int = 2) -> None:
    """Fill the buffer; the second rollout begins within episodes."""
    model.set_logger(Logger(None, []))
    torch.manual_seed(5)
    _, callback = model._setup_learn(10_000, Quiet())
    for _ in range(rollouts):
        model.collect_rollouts(model.env, callback, model.rollout_buffer, STEPS)  # type: ignore[arg-type]


def gradients(model: PPO) -> dict[str, torch.Tensor]:
    """Of SB3's loss on all samples at once."""
    model.train()
    network: torch.nn.Module = model.policy.network  # type: ignore[assignment]
    return {name: p.grad.clone() for name, p in network.named_parameters() if p.grad is not None}


def same(mine: dict[str, torch.Tensor], theirs: dict[str, torch.Tensor]) -> bool:
    assert mine.keys() == theirs.keys()
    return all(torch.allclose(mine[name], theirs[name], rtol=1e-5, atol=1e-5) for name in theirs)


@pytest.mark.parametrize(
    "overrides",
    [[], ["temporal={name: mamba}"], ["temporal={name: transformer}"], ["policy.distribution=beta", "fusion=concat"]],
    ids=["gru", "mamba", "transformer", "beta"],
)
def test_samples_and_gradients_are_those_of_plain_sb3(line_recipe: Path, overrides: list[str]) -> None:
    overrides = [o.replace("fusion=concat", "fusion={name: concat}") for o in overrides]
    theirs, mine = plain(line_recipe, overrides), ours(line_recipe, overrides)
    for model in (theirs, mine):
        collect(model)
    assert isinstance(theirs.rollout_buffer, DictRolloutBuffer)
    store = mine.rollout_buffer
    assert store.frames["images"].dtype == np.uint8
    assert store.frames["images"].shape == (T - 1 + STEPS, ENVS, 2, 3, 16, 32)
    assert store.episode_starts[1:].any()
    assert not store.episode_starts[0].all()
    for name in ("actions", "rewards", "values", "log_probs", "advantages", "returns"):
        np.testing.assert_allclose(
            getattr(store, name), getattr(theirs.rollout_buffer, name), rtol=1e-4, atol=1e-5, err_msg=name
        )
    wanted = gradients(theirs)
    assert max(float(g.abs().max()) for name, g in wanted.items() if name.startswith("spatial")) > 1e-3
    assert same(gradients(mine), wanted)
    right = store.starts.copy()
    store.starts[T - 1 + int(np.argmax(store.episode_starts[1:, 0])) + 1, 0] = False
    assert not same(gradients(mine), wanted), "a reset that is missing goes unnoticed"
    store.starts[:] = right
    store.starts[T - 1 + SEGMENT + 2, 1] ^= True
    assert not same(gradients(mine), wanted), "a reset that is wrong goes unnoticed"


@pytest.mark.parametrize("context", ["{kind: window, length: 4}", "{kind: stream}"])
@pytest.mark.parametrize("frozen", [("spatial",), ("encoders",), ("spatial", "encoders", "fusion")])
def test_stored_embeddings_give_the_gradients_of_stored_images(
    line_recipe: Path, context: str, frozen: tuple[str, ...]
) -> None:
    overrides = [f"context={context}"]
    images = ours(line_recipe, overrides, stored=False, frozen=frozen)
    tokens = ours(line_recipe, overrides, frozen=frozen)
    for model in (images, tokens):
        collect(model)
    held = tokens.rollout_buffer.frames.keys()
    if "spatial" in frozen:
        assert "images" not in held
        tokens.network.spatial = None  # The update does not need it.
    if "encoders" in frozen:
        assert not {"vehicle", "road", "navigation"} & held
        tokens.network.encoders.forward = None  # type: ignore[assignment]
    for name in ("actions", "values", "advantages", "returns"):
        assert np.array_equal(getattr(images.rollout_buffer, name), getattr(tokens.rollout_buffer, name))
    wanted = gradients(images)
    assert not any(name.startswith(part) for name in wanted for part in frozen)
    assert same(gradients(tokens), wanted)


def test_collection_encodes_all_environments_at_once(line_recipe: Path) -> None:
    model = ours(line_recipe, [])
    seen: list[int] = []
    model.network.spatial.register_forward_pre_hook(lambda _, given: seen.append(len(given[0])))  # type: ignore[union-attr]
    collect(model, 1)
    # Each step once, the frame after the last one, and those that a time limit cut off: both at a time.
    cut = int(model.rollout_buffer.episode_starts[1:, 0].sum())
    assert seen == [ENVS] * (STEPS + 1 + cut)


def test_what_is_frozen_is_the_same_in_collection_and_update(line_recipe: Path) -> None:
    model = ours(line_recipe, [], frozen=("spatial",))
    dropout = torch.nn.Dropout(0.5)
    model.network.spatial = torch.nn.ModuleList([model.network.spatial, dropout])  # type: ignore[list-item]
    model.policy.frozen = [model.network.spatial]
    model.policy.set_training_mode(True)
    assert not dropout.training
    assert model.network.memory.training


@pytest.mark.parametrize("size", [1, 5, 64])
def test_microbatches_give_the_gradients_of_the_whole(line_recipe: Path, size: int) -> None:
    whole, parts = ours(line_recipe, []), ours(line_recipe, [], microbatch=size)
    for model in (whole, parts):
        collect(model)
    seen: list[int] = []
    parts.network.spatial.register_forward_pre_hook(lambda _, given: seen.append(len(given[0])))  # type: ignore[union-attr]
    assert same(gradients(parts), gradients(whole))
    frames = T - 1 + STEPS
    assert max(seen) <= size
    # Once to see them, once more in the backward pass.
    assert sum(seen) <= 2 * ENVS * frames
    assert sum(seen) > ENVS * STEPS


@pytest.mark.parametrize("temporal", ["gru", "lstm", "mamba", "transformer"])
@pytest.mark.parametrize("context", ["{kind: window, length: 4}", "{kind: stream}"])
def test_autocast_is_on_in_collection_and_update(line_recipe: Path, temporal: str, context: str) -> None:
    overrides = [f"temporal={{name: {temporal}}}", f"context={context}"]
    exact, half = ours(line_recipe, overrides), ours(line_recipe, overrides, autocast="bfloat16", microbatch=16)
    types: list[torch.dtype] = []
    half.network.spatial.conv.register_forward_hook(lambda *parts: types.append(parts[2].dtype))  # type: ignore[union-attr]
    for model in (exact, half):
        collect(model, 1)
    assert set(types) == {torch.bfloat16}
    types.clear()
    mine, wanted = gradients(half), gradients(exact)
    assert set(types) == {torch.bfloat16}
    assert {g.dtype for g in mine.values()} == {torch.float32}
    norm = torch.cat([g.ravel() for g in wanted.values()]).norm()
    gap = torch.cat([(mine[name] - wanted[name]).ravel() for name in wanted]).norm()
    assert 0 < gap < 0.1 * norm


def test_a_stream_starts_its_segments_from_the_stored_state(line_recipe: Path) -> None:
    """What the update computes for a sample before the first step is what collection computed."""
    model = ours(line_recipe, ["context={kind: stream}"], sizes={"batch_size": SEGMENT})
    collect(model)
    for batch in model.rollout_buffer.get(SEGMENT):
        values, log_prob, _ = model.policy.evaluate_actions(batch.observations, batch.actions)
        torch.testing.assert_close(values, batch.old_values, rtol=1e-4, atol=1e-5)
        torch.testing.assert_close(log_prob, batch.old_log_prob, rtol=1e-4, atol=1e-5)


@pytest.mark.cuda
@pytest.mark.parametrize("frozen", [(), ("spatial",)])
def test_a_gpu_gives_the_gradients_of_the_cpu(line_recipe: Path, frozen: tuple[str, ...]) -> None:
    here = ours(line_recipe, [], frozen=frozen)
    there = ours(line_recipe, [], sizes={"device": "cuda"}, frozen=frozen, microbatch=16)
    collect(here)
    there.set_logger(Logger(None, []))
    there._setup_learn(10_000, Quiet())
    for name in ("frames", "starts", *(key for key in vars(here.rollout_buffer) if key.startswith("episode"))):
        setattr(there.rollout_buffer, name, getattr(here.rollout_buffer, name))
    for name in ("actions", "rewards", "values", "log_probs", "advantages", "returns", "full"):
        setattr(there.rollout_buffer, name, getattr(here.rollout_buffer, name))
    wanted = gradients(here)
    mine = gradients(there)
    for name, grad in wanted.items():
        torch.testing.assert_close(mine[name].cpu(), grad, rtol=1e-3, atol=1e-4)


@pytest.mark.cuda
def test_a_gpu_collects_and_learns(line_recipe: Path) -> None:
    model = ours(line_recipe, [], sizes={"device": "cuda"}, frozen=("spatial",), autocast="bfloat16")
    collect(model)
    assert all(bool(grad.isfinite().all()) for grad in gradients(model).values())

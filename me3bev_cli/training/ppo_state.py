"""The state of a `ppo` stage between two updates: with it a run goes on as if it had never stopped."""

from __future__ import annotations

import copy
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from torch import Tensor

from me3bev_cli.pipeline.tree import map_tree

if TYPE_CHECKING:
    from me3bev_cli.training.replay import ReplayedEnvs
    from me3bev_cli.training.sequence_ppo import SequencePPO


def random_state() -> dict[str, Any]:
    """torch's random states, those of CUDA too where it is in use."""
    state: dict[str, Any] = {"torch": torch.get_rng_state()}
    if torch.cuda.is_available():
        state["cuda"] = torch.cuda.get_rng_state_all()
    return state


def restore_random_state(state: dict[str, Any]) -> None:
    """Take up what `random_state` gave."""
    torch.set_rng_state(state["torch"])
    if "cuda" in state and torch.cuda.is_available():
        torch.cuda.set_rng_state_all(state["cuda"])


def copied(tree: Any) -> Any:
    """A tree whose tensors are not changed when those of the original are."""
    return copy.deepcopy(tree)


def capture(model: SequencePPO, env: ReplayedEnvs) -> dict[str, Any]:
    """What `prepare` and `take_up` need, in tensors and plain values, all copied: the weights apart.

    To be called before a rollout is collected, its buffer emptied: only the P frames before it are of interest.
    """
    buffer = model.rollout_buffer
    return {
        "optimizer": copied(model.policy.optimizer.state_dict()),
        "random": random_state(),
        "minibatches": copied(buffer.generator.bit_generator.state),
        "updates": model._n_updates,
        "memory": map_tree(lambda leaf: leaf.detach().clone(), model._state),
        "starts": torch.from_numpy(np.array(model._last_episode_starts, bool)),
        "prefix": {key: torch.from_numpy(rows.copy()) for key, rows in _prefix(model).items()},
        "environments": env.state(),
    }


def _prefix(model: SequencePPO) -> dict[str, Any]:
    """The buffer's P frames before the rollout, by key, and whether episodes begin there."""
    buffer = model.rollout_buffer
    return {key: rows[: buffer.prefix] for key, rows in (buffer.frames | {"episode starts": buffer.starts}).items()}


def prepare(model: SequencePPO, env: ReplayedEnvs, state: dict[str, Any], check: Callable[[], None]) -> None:
    """Bring the environments where they were and fill the optimiser; to be called before `learn`, as SB3 resets then
    what has no observation.

    Args:
        check: called often; may raise to give up.
    """
    model.policy.optimizer.load_state_dict(state["optimizer"])
    model.rollout_buffer.generator.bit_generator.state = state["minibatches"]
    model._n_updates = state["updates"]
    model._last_obs = env.restore(state["environments"], check)
    model._last_episode_starts = state["starts"].numpy()


def take_up(model: SequencePPO, state: dict[str, Any]) -> None:
    """Fill what `learn` empties when it begins: memory, the frames before the rollout, random states."""

    def moved(leaf: Tensor) -> Tensor:
        return leaf.to(model.device)

    model._state = map_tree(moved, state["memory"])
    for key, rows in _prefix(model).items():
        rows[...] = state["prefix"][key].numpy()
    restore_random_state(state["random"])

"""Cost of an update and of a rollout, beside plain Stable-Baselines3 PPO on stacked frames with the same network.

Timed: `train()` of both algorithms, SB3's own method: one pass over the same number of samples as one minibatch, with
loss, backward pass and optimiser step. Both start from the same weights and play the same episodes. They take turns,
round by round, so that a change of the machine's speed touches all of them. Memory is that of the rollout buffers'
arrays at the recipe's size.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.buffers import DictRolloutBuffer
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.vec_env import VecEnv

from me3bev_cli.bench.train_stacked import StackedFrames, StackedPolicy
from me3bev_cli.errors import UserError
from me3bev_cli.pipeline.assemble import build_network, pick_device
from me3bev_cli.pipeline.policy import STARTS, DrivingPolicy
from me3bev_cli.recipe import Recipe
from me3bev_cli.recipe_stages import PpoStage
from me3bev_cli.training.environments import make_environments
from me3bev_cli.training.rollout import SequenceRolloutBuffer
from me3bev_cli.training.sequence_ppo import SequencePPO

OURS, PLAIN, OURS_FROZEN, PLAIN_FROZEN = "ours", "plain_sb3", "ours_frozen", "plain_sb3_frozen"
TARGETS = {"update_speedup": 3.0, "memory_ratio": 3.5, "frozen_speedup": 20.0}
"""What is wanted: at least."""
ENVIRONMENTS = (1, 2, 4)

Progress = Callable[[str, int, int], None]


class Quiet(BaseCallback):
    """Watches nothing."""

    def _on_step(self) -> bool:
        return True


class Contest:
    """The models that are compared, made from one recipe.

    Args:
        recipe: whose first ppo stage is measured; its context is a window.
        samples: of a minibatch; rounded up to whole segments.

    Raises:
        UserError: the recipe has no such stage, no window, or no images.
    """

    def __init__(self, recipe: Recipe, samples: int) -> None:
        stage = next((stage for stage in recipe.stages if isinstance(stage, PpoStage)), None)
        if stage is None:
            raise UserError(f"recipe '{recipe.name}' has no ppo stage", hint="There is nothing to compare")
        if recipe.context.kind != "window" or recipe.temporal is None or "bev" not in recipe.modalities:
            raise UserError(
                f"recipe '{recipe.name}' does not look at a window of images: stacked frames have no counterpart in it",
                hint="Give it modalities with bev, a temporal module and `context: {kind: window, length: 4}`",
            )
        self.recipe, self.stage, self.length = recipe, stage, recipe.context.length
        self.device = pick_device(recipe.device)
        self.samples = -(-samples // stage.segment) * stage.segment

    def envs(self, count: int) -> VecEnv:
        """As the stage has them, but so many."""
        return make_environments(self.recipe, self.stage.model_copy(update={"envs": count}))

    def settings(self, steps: int, minibatch: int) -> dict[str, Any]:
        """What both algorithms are told. The weights stay as they are, whatever the optimiser does."""
        stage = self.stage
        return {
            "learning_rate": 0.0, "n_steps": steps, "batch_size": minibatch, "n_epochs": 1, "gamma": stage.gamma,
            "gae_lambda": stage.gae_lambda, "clip_range": stage.clip, "ent_coef": stage.entropy,
            "vf_coef": stage.value, "max_grad_norm": stage.max_grad_norm,
            "normalize_advantage": stage.normalise_advantage, "seed": self.recipe.seed, "device": self.device,
        }  # fmt: skip

    def network(self, frozen: bool) -> dict[str, Any]:
        """The same weights for everybody, in what both policies are told."""
        network = build_network(self.recipe, self.recipe.seed).to(self.device)
        parts = ("spatial",) if frozen else ()
        return {"network": network, "frozen": parts, "microbatch": self.stage.microbatch}

    def ours(self, envs: VecEnv, steps: int, frozen: bool = False) -> SequencePPO:
        """Single frames in segments; embeddings where the encoder is frozen."""
        told = self.network(frozen) | {"autocast": self.stage.autocast}
        sequence = {"segment": self.stage.segment, "prefix": told["network"].prefix, "seed": 0}
        model = SequencePPO(
            DrivingPolicy,
            envs,
            rollout_buffer_class=SequenceRolloutBuffer,
            rollout_buffer_kwargs=sequence,
            policy_kwargs=told,
            **self.settings(steps, min(self.samples, steps * envs.num_envs)),
        )
        model.set_logger(Logger(None, []))
        return model

    def plain(self, envs: VecEnv, steps: int, frozen: bool = False) -> PPO:
        """SB3's own PPO and buffer on stacked frames."""
        told = self.network(frozen) | {"autocast": self.stage.autocast}
        model = PPO(StackedPolicy, envs, policy_kwargs=told, **self.settings(steps, self.samples))  # type: ignore[arg-type]
        model.set_logger(Logger(None, []))
        return model

    def clock(self) -> float:
        """Seconds, when the device has done what it was given."""
        if self.device.type == "cuda":
            torch.cuda.synchronize(self.device)
        return time.perf_counter()


def measure(recipe: Recipe, *, samples: int, rounds: int, steps: int, progress: Progress) -> dict[str, Any]:
    """Measure everything; the figures as `me3bev bench-train --json` writes them.

    Args:
        samples: of a minibatch.
        rounds: turns that each takes.
        steps: of collection per environment.
    """
    contest = Contest(recipe, samples)
    memory = rollout_bytes(contest)
    collected = []
    for number, count in enumerate(ENVIRONMENTS):
        progress("collection", number, len(ENVIRONMENTS))
        collected.append(_collection(contest, count, steps))
    with _filled(contest, progress) as models:
        models[OURS].train()  # Kernels are chosen and memory is had at the first call.
        times: dict[str, list[float]] = {name: [] for name in models}
        for number in range(rounds):
            for turn, (name, model) in enumerate(models.items()):
                progress("updates", number * len(models) + turn, rounds * len(models))
                begun = contest.clock()
                model.train()
                times[name].append((contest.clock() - begun) / contest.samples)
        progress("updates", 1, 1)
    return _report(contest, times, memory, collected)


@contextmanager
def _filled(contest: Contest, progress: Progress) -> Iterator[dict[str, PPO]]:
    """The contestants, each with a rollout of the same episode."""
    fleets: list[VecEnv] = []

    def one() -> VecEnv:
        fleets.append(contest.envs(1))
        return fleets[-1]

    try:
        steps = contest.samples
        models: dict[str, PPO] = {
            OURS: contest.ours(one(), steps),
            PLAIN: contest.plain(StackedFrames(one(), contest.length), steps),
            OURS_FROZEN: contest.ours(one(), steps, frozen=True),
            PLAIN_FROZEN: contest.plain(StackedFrames(one(), contest.length), steps, frozen=True),
        }
        for number, name in enumerate((OURS, OURS_FROZEN)):
            progress("rollouts", number, 2)
            collect(models[name], steps)
        for name in (PLAIN, PLAIN_FROZEN):
            fill_stacked(models[name].rollout_buffer, models[OURS].rollout_buffer)  # type: ignore[arg-type]
        yield models
    finally:
        for fleet in fleets:
            fleet.close()


def collect(model: PPO, steps: int) -> None:
    """Fill the model's buffer, with the same chance for everybody.

    The rollout kept is the second one: the first begins with an episode, and needs no frames from before.
    """
    assert model.env is not None
    torch.manual_seed(0)
    _, callback = model._setup_learn(steps, Quiet())
    for _ in range(2):
        model.collect_rollouts(model.env, callback, model.rollout_buffer, steps)


def fill_stacked(target: DictRolloutBuffer, source: SequenceRolloutBuffer) -> None:
    """Put the samples of a rollout of single frames into SB3's buffer, each with its window."""
    length = source.prefix + 1
    for t in range(source.buffer_size):
        seen = {key: array[t : t + length].swapaxes(0, 1) for key, array in source.frames.items()}
        target.add(
            seen | {STARTS: source.starts[t : t + length].T},
            source.actions[t],
            source.rewards[t],
            source.episode_starts[t],
            torch.as_tensor(source.values[t]),
            torch.as_tensor(source.log_probs[t]),
        )
    target.advantages, target.returns = source.advantages.copy(), source.returns.copy()


def _collection(contest: Contest, count: int, steps: int) -> dict[str, float]:
    """Environment steps/s of collection, and the share of it that the environments took."""
    envs = contest.envs(count)
    try:
        model = contest.ours(envs, steps)
        assert model.env is not None
        spent = _stopwatch(model.env)
        _, callback = model._setup_learn(steps, Quiet())
        model.collect_rollouts(model.env, callback, model.rollout_buffer, 2)
        spent[0] = 0.0
        begun = contest.clock()
        model.collect_rollouts(model.env, callback, model.rollout_buffer, steps)
        seconds = contest.clock() - begun
    finally:
        envs.close()
    return {"envs": count, "steps_per_s": steps * count / seconds, "environment_share": spent[0] / seconds}


def _stopwatch(envs: VecEnv) -> list[float]:
    """Seconds spent in `envs.step` from now on."""
    spent, step = [0.0], envs.step

    def timed(actions: Any) -> Any:
        begun = time.perf_counter()
        result = step(actions)
        spent[0] += time.perf_counter() - begun
        return result

    envs.step = timed  # type: ignore[method-assign]
    return spent


def rollout_bytes(contest: Contest) -> dict[str, int]:
    """Bytes of the arrays of a rollout at the recipe's size, without touching them."""
    stage = contest.stage
    envs = contest.envs(1)
    try:
        space, actions = envs.observation_space, envs.action_space
        stacked = StackedFrames(envs, contest.length).observation_space
    finally:
        envs.close()
    network = build_network(contest.recipe, contest.recipe.seed)
    common: Any = {"n_envs": stage.envs, "device": "cpu"}
    sequence = {"segment": stage.segment, "prefix": network.prefix}
    tokens = {"bev": network.embedding_shapes["bev"]}
    return {
        OURS: _bytes(SequenceRolloutBuffer(stage.rollout, space, actions, **common, **sequence)),  # type: ignore[arg-type]
        OURS_FROZEN: _bytes(
            SequenceRolloutBuffer(stage.rollout, space, actions, **common, **sequence, embeddings=tokens)  # type: ignore[arg-type]
        ),
        PLAIN: _bytes(DictRolloutBuffer(stage.rollout, stacked, actions, **common)),  # type: ignore[arg-type]
    }


def _bytes(buffer: Any) -> int:
    arrays = [
        part for value in vars(buffer).values() for part in (value.values() if isinstance(value, dict) else [value])
    ]
    return sum(array.nbytes for array in arrays if isinstance(array, np.ndarray))


def _report(
    contest: Contest, times: dict[str, list[float]], memory: dict[str, int], collected: Sequence[dict[str, float]]
) -> dict[str, Any]:
    """Medians over the rounds; ratios are of the turns of one round."""
    rounds = {name: np.array(values) for name, values in times.items()}
    series = {
        "update_speedup": rounds[PLAIN] / rounds[OURS],
        "frozen_speedup": rounds[PLAIN_FROZEN] / rounds[OURS_FROZEN],
        "frozen_over_training_plain": rounds[PLAIN] / rounds[OURS_FROZEN],
    }
    cost = {name: float(np.median(values)) for name, values in rounds.items()}
    epochs = contest.stage.epochs
    rows = []
    for row in collected:
        both = {}
        for name, label in ((OURS, ""), (OURS_FROZEN, "frozen_")):
            update = 1 / (epochs * cost[name])
            both[f"{label}update_steps_per_s"] = update
            both[f"{label}overall_steps_per_s"] = 1 / (1 / row["steps_per_s"] + 1 / update)
        collection = {
            "collection_steps_per_s": row["steps_per_s"],
            "environment_share": row["environment_share"],
        }
        rows.append({"envs": row["envs"], **collection, **both})
    return {
        **{key: float(np.median(values)) for key, values in series.items()},
        "memory_ratio": memory[PLAIN] / memory[OURS],
        "frozen_memory_ratio": memory[PLAIN] / memory[OURS_FROZEN],
        "rollout_bytes": memory,
        "update_ms_per_sample": {name: 1e3 * seconds for name, seconds in cost.items()},
        "environments": rows,
        "stage": {
            "window": contest.length,
            "samples": contest.samples,
            **{key: getattr(contest.stage, key) for key in ("segment", "microbatch", "rollout", "envs", "epochs")},
            "device": str(contest.device),
        },
        "targets": TARGETS,
        "spread": {key: [float(q) for q in np.percentile(values, [25, 75])] for key, values in series.items()},
    }

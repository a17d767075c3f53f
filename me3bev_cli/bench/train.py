"""Cost of an update and of a rollout, beside plain Stable-Baselines3 PPO on stacked frames with the same network.

Timed: `train()` of both algorithms, SB3's own method: one pass over the same number of samples as one minibatch, with
loss, backward pass and optimiser step. Both have the same weights and learn from the same samples, from the middle of
episodes. They take turns, round by round, so that a change of the machine's speed touches all of them. Memory is
that of the rollout buffers' arrays at the recipe's size.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
from stable_baselines3 import PPO
from stable_baselines3.common.buffers import DictRolloutBuffer
from stable_baselines3.common.vec_env import VecEnv

from me3bev_cli.bench.train_contestants import Contest, Quiet, collect, fill_stacked
from me3bev_cli.bench.train_stacked import StackedFrames
from me3bev_cli.errors import MemoryShortError
from me3bev_cli.pipeline.assemble import build_network
from me3bev_cli.recipe import Recipe
from me3bev_cli.training.memory_limits import available_on
from me3bev_cli.training.memory_need import GRADIENTS, measure_kept
from me3bev_cli.training.rollout import SequenceRolloutBuffer

OURS, PLAIN, OURS_FROZEN, PLAIN_FROZEN = "ours", "plain_sb3", "ours_frozen", "plain_sb3_frozen"
TARGETS = {"update_speedup": 3.0, "memory_ratio": 3.5, "frozen_speedup": 20.0}
"""What is wanted: at least."""
ENVIRONMENTS = (1, 2, 4)
SHORTEST = 0.5
"""Seconds of a turn."""

Progress = Callable[[str, int, int], None]


def measure(recipe: Recipe, *, samples: int, rounds: int, steps: int, progress: Progress) -> dict[str, Any]:
    """Measure everything; the figures as `me3bev bench-train --json` writes them.

    Args:
        samples: of a minibatch.
        rounds: turns that each takes.
        steps: of collection per environment.

    Raises:
        MemoryShortError: plain SB3 could not learn from so many samples at once here.
    """
    contest = Contest(recipe, samples)
    check_stacks_fit(contest)
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
                times[name].append(_turn(contest, model))
        progress("updates", 1, 1)
    return _report(contest, times, memory, collected)


def check_stacks_fit(contest: Contest) -> None:
    """Refuse what would be killed: plain SB3 encodes every frame of every sample at once.

    Raises:
        MemoryShortError: with the numbers.
    """
    network = build_network(contest.recipe, contest.recipe.seed).to(contest.device)
    frames = contest.samples * contest.length
    at_once = min(frames, contest.stage.microbatch or frames)
    need = GRADIENTS * at_once * measure_kept(network, contest.recipe, contest.stage).image
    free = available_on(contest.device)
    if free is not None and need > free:
        raise MemoryShortError(
            f"plain SB3 would need {need / 1e9:.1f} GB for {contest.samples} samples of {contest.length} frames and "
            f"{free / 1e9:.1f} GB are free",
            hint="Give the stage a `microbatch`, which both use, or fewer --samples",
        )


def _turn(contest: Contest, model: PPO) -> float:
    """Seconds per sample of a pass; short ones are repeated."""
    begun, passes, spent = contest.clock(), 0, 0.0
    while spent < SHORTEST:
        model.train()
        passes, spent = passes + 1, contest.clock() - begun
    return spent / passes / contest.samples


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

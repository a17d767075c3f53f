"""Drives a network through courses, deciding for all of them at once."""

from __future__ import annotations

import itertools
import random
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
import torch
from stable_baselines3.common.vec_env import DummyVecEnv

from me3bev_cli.evaluation.course import IDLE, CourseMaker, Visit
from me3bev_cli.evaluation.episode import Ending, Episode, ending, from_records
from me3bev_cli.parallel_envs import ParallelEnvs
from me3bev_cli.pipeline.network import Network
from me3bev_cli.pipeline.transfer import to_tensors


@contextmanager
def undisturbed(network: Network) -> Iterator[None]:
    """What happens inside leaves the network's modes and every global random state as they were."""
    modes = [(module, module.training) for module in network.modules()]
    python, arrays = random.getstate(), np.random.get_state()
    with torch.random.fork_rng():
        network.eval()
        try:
            yield
        finally:
            for module, mode in modes:
                module.training = mode
            random.setstate(python)
            np.random.set_state(arrays)


def split(visits: Sequence[Visit], count: int) -> list[tuple[Visit, ...]]:
    """`count` runs of consecutive visits, as long as each other as can be."""
    bounds = np.linspace(0, len(visits), min(count, len(visits)) + 1).astype(int).tolist()
    return [tuple(visits[low:high]) for low, high in itertools.pairwise(bounds)]


def drive(
    network: Network, makers: Sequence[CourseMaker], workers: int, driver: str, stopping: Callable[[], bool]
) -> list[Episode] | None:
    """Drive the network's mean action through every course.

    Args:
        makers: of the courses, which advance in step with each other.
        workers: processes for them; 1: this one. The episodes do not depend on it.
        driver: the episodes' name for who drives.
        stopping: asked at every step; None is returned when it says so.

    Raises:
        WorkerDiedError: a worker died.
    """
    workers = min(workers, len(makers))
    with undisturbed(network):
        env = ParallelEnvs(makers, workers) if workers > 1 else DummyVecEnv(list(makers))
        try:
            return _drive(network, env, [maker.visits for maker in makers], driver, stopping)
        finally:
            env.close()


@torch.inference_mode()
def _drive(
    network: Network, env: Any, visits: Sequence[Sequence[Visit]], driver: str, stopping: Callable[[], bool]
) -> list[Episode] | None:
    left = [list(course) for course in visits]
    records: list[list[Any]] = [[] for _ in left]
    episodes: list[Episode] = []
    observation = env.reset()
    state = network.initial_state(len(left))
    starts = torch.ones(len(left), dtype=torch.bool, device=network.device)
    while any(left):
        if stopping():
            return None
        decision, state = network.step(to_tensors(observation, network.device), state, starts)
        actions = decision.actions.mode().clamp(-1.0, 1.0).float().cpu().numpy()
        observation, _, dones, infos = env.step(actions)
        starts = torch.as_tensor(dones, device=network.device)
        for course, info in enumerate(infos):
            if info.get(IDLE):
                continue
            records[course].append(dict(info["record"]))
            if dones[course]:
                played, records[course] = records[course], []
                visit = left[course].pop(0)
                ended = ending(played, terminated=not info["TimeLimit.truncated"])
                episodes.append(_episode(played, visit, info["weather"], driver, ended))
    order = {visit: number for number, visit in enumerate(v for course in visits for v in course)}
    return sorted(episodes, key=lambda e: order[Visit(e.map, e.density, e.index, e.seed)])


def _episode(records: list[Any], visit: Visit, weather: str, driver: str, ended: Ending) -> Episode:
    return from_records(
        records,
        map=visit.map,
        density=visit.density,
        weather=weather,
        seed=visit.seed,
        index=visit.index,
        driver=driver,
        ended=ended,
    )

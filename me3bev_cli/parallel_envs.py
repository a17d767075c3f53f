"""Environments in worker processes, for Stable-Baselines3: the same bytes as in one process, on more cores."""

from __future__ import annotations

import weakref
from collections.abc import Callable, Sequence
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv
from stable_baselines3.common.vec_env.base_vec_env import VecEnvIndices, VecEnvStepReturn

from me3bev_cli.environment_host import Play
from me3bev_cli.environment_workers import EnvironmentWorkers, Recovery
from me3bev_cli.shared_observations import Frames


class ParallelEnvs(VecEnv):
    """N environments with dict observations, split over worker processes; observations come through shared memory.

    It behaves as `DummyVecEnv` does, whatever the number of workers: an environment whose episode has ended is
    reset at once, and its info holds the `terminal_observation`. What it returns is the caller's to keep.
    Each worker steps its environments one after another, with one thread per library. Ctrl-C does not reach the
    workers: they go when `close` is called or this process ends.

    Args:
        makers: one for each environment; can be pickled, as infos can.
        workers: processes, at most one per environment.

    Raises:
        UserError: as making, resetting or stepping an environment raised it.
        WorkerDiedError: a worker died, unless `recover_with` has said how to bring its environments back.
        JobError: an environment raised anything else; the text holds its traceback.
    """

    def __init__(self, makers: Sequence[Callable[[], gymnasium.Env[Any, Any]]], workers: int) -> None:
        self._pool = EnvironmentWorkers(makers, workers)
        self._rows = self._pool.rows
        self._tidy = weakref.finalize(self, self._pool.close)
        try:
            super().__init__(len(makers), *self._pool.open())
        except BaseException:
            self.close()
            raise

    def recover_with(self, recovery: Recovery) -> None:
        """From now on start a worker again that has died or hangs, instead of raising WorkerDiedError at once."""
        self._pool.recovery = recovery

    def replay(self, plays: Sequence[Play], check: Callable[[], None] | None = None) -> Frames:
        """Bring every environment where its play says; the observations there.

        Args:
            check: called a few times a second; may raise to give up, which closes the environments.
        """
        return self._pool.replay(plays, check)

    def reset(self) -> Frames:
        """Begin an episode in every environment."""
        self._pool.settle()
        calls = [("reset", self._seeds[rows], self._options[rows]) for rows in self._rows]
        self._pool.send(calls)
        told, observations = self._pool.receive_observations()
        self.reset_infos = [info for infos in told for info in infos]
        self._reset_seeds()
        self._reset_options()
        return observations

    def step_async(self, actions: NDArray[Any]) -> None:
        """Let every worker begin to step its environments."""
        self._pool.send([("step", np.asarray(actions)[rows]) for rows in self._rows])

    def step_wait(self) -> VecEnvStepReturn:
        """Observations (N, ...) by key, rewards (N,), dones (N,) and infos of the step that was begun."""
        rewards: list[float] = []
        dones: list[bool] = []
        infos: list[dict[str, Any]] = []
        results, observations = self._pool.receive_observations()
        for number, (some_rewards, some_dones, some_infos, resets) in enumerate(results):
            rewards += some_rewards
            dones += some_dones
            infos += some_infos
            for i, told in resets.items():
                index = self._rows[number].start + i
                last = self._pool.memories[number].last
                self.reset_infos[index] = told
                infos[index]["terminal_observation"] = {key: array[i].copy() for key, array in last.items()}
        return observations, np.array(rewards, np.float32), np.array(dones, bool), infos

    def close(self) -> None:
        """End the workers; may be called twice."""
        self._tidy()

    def has_attr(self, attr_name: str) -> bool:
        """Whether every environment has an attribute."""
        return all(self._each("has_attr", None, attr_name))

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """An attribute of each environment. Raises AttributeError when one lacks it."""
        if not all(self._each("has_attr", indices, attr_name)):
            raise AttributeError(f"the environments have no attribute '{attr_name}'")
        return self._each("get_attr", indices, attr_name)

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:
        """Set an attribute of each environment's outermost wrapper."""
        self._each("set_attr", indices, attr_name, value)

    def env_method(self, method_name: str, *args: Any, indices: VecEnvIndices = None, **kwargs: Any) -> list[Any]:
        """What a method of each environment returns."""
        return self._each("env_method", indices, method_name, args, kwargs)

    def env_is_wrapped(self, wrapper_class: type[Any], indices: VecEnvIndices = None) -> list[bool]:
        """Whether each environment is inside a wrapper of some class."""
        return self._each("is_wrapped", indices, wrapper_class)

    def get_images(self) -> Sequence[NDArray[np.uint8] | None]:
        """What each environment renders."""
        return self.env_method("render")

    def _each(self, name: str, indices: VecEnvIndices, *arguments: Any) -> list[Any]:
        """What a method of `EnvironmentHost` returns for each chosen environment, in the order of `indices`."""
        chosen = [range(self._rows[-1].stop)[i] for i in self._get_indices(indices)]
        calls = [(name, [i - r.start for i in chosen if r.start <= i < r.stop], *arguments) for r in self._rows]
        answers = [iter(answer) for answer in self._pool.call(calls)]
        owner = {i: number for number, rows in enumerate(self._rows) for i in range(rows.start, rows.stop)}
        return [next(answers[owner[i]]) for i in chosen]

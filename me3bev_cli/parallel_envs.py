"""Environments in worker processes, for Stable-Baselines3: the same bytes as in one process, on more cores."""

from __future__ import annotations

import itertools
import weakref
from collections.abc import Callable, Sequence
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv
from stable_baselines3.common.vec_env.base_vec_env import VecEnvIndices, VecEnvStepReturn

from me3bev_cli.environment_host import EnvironmentHost
from me3bev_cli.errors import UserError
from me3bev_cli.shared_observations import Frames, SharedObservations
from me3bev_cli.workers import JobError, Worker, WorkerDiedError, core_of_each, stop_workers


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
        WorkerDiedError: a worker died.
        JobError: an environment raised anything else; the text holds its traceback.
    """

    def __init__(self, makers: Sequence[Callable[[], gymnasium.Env[Any, Any]]], workers: int) -> None:
        count = len(makers)
        bounds = np.linspace(0, count, max(1, min(workers, count)) + 1).astype(int).tolist()
        self._rows = [slice(low, high) for low, high in itertools.pairwise(bounds)]
        self._pool = pool = _Pool(self._rows)
        self._tidy = weakref.finalize(self, pool.close)
        try:
            for rows, core in zip(self._rows, core_of_each(len(self._rows)), strict=True):
                pool.workers.append(Worker(EnvironmentHost(makers[rows], rows.start), core))
            observation_space, action_space = pool.call([("open",)] * len(self._rows))[0]
            pool.memory = SharedObservations(observation_space, count)
            try:
                pool.call([("attach", pool.memory.name, count)] * len(self._rows))
            finally:
                pool.memory.forget_name()
            super().__init__(count, observation_space, action_space)
        except BaseException:
            self.close()
            raise

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
        for rows, (some_rewards, some_dones, some_infos, resets) in zip(self._rows, results, strict=True):
            rewards += some_rewards
            dones += some_dones
            infos += some_infos
            for i, told in resets.items():
                index = rows.start + i
                self.reset_infos[index] = told
                infos[index]["terminal_observation"] = self._last_of(index)
        return observations, np.array(rewards, np.float32), np.array(dones, bool), infos

    def close(self) -> None:
        """End the workers; may be called twice."""
        self._tidy()

    def _last_of(self, index: int) -> Frames:
        assert self._pool.memory is not None
        return {key: array[index].copy() for key, array in self._pool.memory.last.items()}

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


class _Pool:
    """The worker processes and their memory. Every worker is asked, then every answer is heard."""

    def __init__(self, rows: list[slice]) -> None:
        self.rows = rows
        self.workers: list[Worker] = []
        self.memory: SharedObservations | None = None
        self.busy = False

    def call(self, jobs: Sequence[Any]) -> list[Any]:
        """One job for each worker; their results."""
        self.send(jobs)
        return self.receive()

    def send(self, jobs: Sequence[Any]) -> None:
        """Give each worker a job."""
        if not self.workers:
            raise RuntimeError("the environments are closed")
        if self.busy:
            raise RuntimeError("step_async() was called twice without step_wait()")
        self.busy = True
        for number, job in enumerate(jobs):
            try:
                self.workers[number].send(job)
            except ConnectionError:
                raise self._died(number) from None

    def receive_observations(self) -> tuple[list[Any], Frames]:
        """The workers' results and a copy of the observations, each worker's while later ones are still at work."""
        assert self.memory is not None
        memory = self.memory
        observations = {key: np.empty_like(array) for key, array in memory.newest.items()}
        return self.receive(lambda number: memory.copy(self.rows[number], observations)), observations

    def receive(self, heard: Callable[[int], None] | None = None) -> list[Any]:
        """The workers' results. Raises what the first of them raised, when all have answered.

        Args:
            heard: called with the number of each worker when it has answered.
        """
        if not self.busy:
            raise RuntimeError("step_wait() was called without step_async()")
        results: list[Any] = []
        error: Exception | None = None
        try:
            for number, worker in enumerate(self.workers):
                try:
                    results.append(worker.receive())
                    if heard is not None:
                        heard(number)
                except (EOFError, ConnectionError):
                    raise self._died(number) from None
                except (UserError, JobError) as raised:
                    error = error or raised
        except BaseException:
            # Interrupted between two answers, nobody could tell later whose is whose.
            self.close()
            raise
        self.busy = False
        if error is not None:
            raise error
        return results

    def settle(self) -> None:
        """Hear what is still to be answered, and forget it."""
        if self.busy:
            self.receive()

    def _died(self, number: int) -> WorkerDiedError:
        """The error for a worker that is gone; the others are stopped."""
        rows, count = self.rows[number], len(self.workers)
        cause = self.workers.pop(number).bury()
        self.close()
        return WorkerDiedError(
            f"worker process {number + 1} of {count} (environments {rows.start} to {rows.stop - 1}) died: {cause}",
            hint="When memory is short, fewer workers help",
        )

    def close(self) -> None:
        """Stop every worker, those at work at once."""
        stop_workers(self.workers, at_once=self.busy)
        self.workers.clear()
        self.busy = False
        if self.memory is not None:
            self.memory.close()
            self.memory = None

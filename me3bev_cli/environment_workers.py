"""The worker processes behind `ParallelEnvs`: asked together, heard in order, started again when one is lost."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import gymnasium
import numpy as np
from gymnasium import spaces

from me3bev_cli.environment_host import EnvironmentHost, Play
from me3bev_cli.errors import UserError
from me3bev_cli.shared_observations import Frames, SharedObservations
from me3bev_cli.workers import JobError, Worker, WorkerDiedError, core_of_each, stop_workers

RETRIES = 3
"""How often a worker is started again while it has answered nothing."""

PATIENCE = 10
"""Making a world and playing episodes again may take this many times as long as any other answer."""

GLANCE = 0.2
"""Seconds between two looks at whether a wait is still wanted."""


class Recovery(NamedTuple):
    """How the environments of a lost worker are brought back."""

    plays: Callable[[], Sequence[Play]]
    """Where every environment stood after the last step or reset that was answered."""
    told: Callable[[str], None]
    """Called with what happened, before a worker is started again."""
    silence: float | None
    """Seconds without an answer after which a worker is taken for hung; None: it is waited for without end."""
    check: Callable[[], None] | None = None
    """Called a few times a second while a worker is silent; may raise to give up, which closes the environments."""


class _HungError(Exception):
    """A worker gave no answer in time."""


class EnvironmentWorkers:
    """Worker processes, each with some consecutive environments and with memory for their observations.

    Args:
        makers: one for each environment.
        workers: processes, at most one per environment.
    """

    def __init__(self, makers: Sequence[Callable[[], gymnasium.Env[Any, Any]]], workers: int) -> None:
        count = len(makers)
        bounds = np.linspace(0, count, max(1, min(workers, count)) + 1).astype(int).tolist()
        self.makers = makers
        self.rows = [slice(low, high) for low, high in itertools.pairwise(bounds)]
        self.workers: list[Worker] = []
        self.memories: list[SharedObservations] = []
        self.recovery: Recovery | None = None
        self.busy = False
        self._cores = core_of_each(len(self.rows))
        self._jobs: list[Any] = []
        self._lost = [0] * len(self.rows)

    def open(self) -> tuple[spaces.Dict, spaces.Space[Any]]:
        """Start every worker and make its environments; the spaces of an observation and of an action."""
        for number in range(len(self.rows)):
            self.workers.append(self._start(number))
        space, actions = self.call([("open",)] * len(self.rows))[0]
        for rows in self.rows:
            self.memories.append(SharedObservations(space, rows.stop - rows.start))
        try:
            self.call([("attach", memory.name) for memory in self.memories])
        finally:
            for memory in self.memories:
                memory.forget_name()
        self._space = space
        return space, actions

    def _start(self, number: int) -> Worker:
        return Worker(EnvironmentHost(self.makers[self.rows[number]]), self._cores[number])

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
        self._jobs = list(jobs)
        for number, job in enumerate(self._jobs):
            try:
                self.workers[number].send(job)
            except ConnectionError:
                self._recover(number, self._bury(number))

    def replay(self, plays: Sequence[Play], check: Callable[[], None] | None = None) -> Frames:
        """Bring every environment where its play says; a copy of the observations there.

        Args:
            check: called a few times a second; may raise, which closes the environments.
        """
        self.send([("replay", plays[rows]) for rows in self.rows])
        return self.receive_observations(check, PATIENCE)[1]

    def receive_observations(
        self, check: Callable[[], None] | None = None, patience: float = 1
    ) -> tuple[list[Any], Frames]:
        """The workers' results and a copy of the observations, each worker's while later ones are still at work."""
        count = self.rows[-1].stop
        newest = self.memories[0].newest
        observations = {key: np.empty((count, *array.shape[1:]), array.dtype) for key, array in newest.items()}

        def copy(number: int) -> None:
            self.memories[number].copy(observations, self.rows[number])

        return self.receive(copy, check, patience), observations

    def receive(
        self,
        heard: Callable[[int], None] | None = None,
        check: Callable[[], None] | None = None,
        patience: float = 1,
    ) -> list[Any]:
        """The workers' results. Raises what the first of them raised, when all have answered.

        Args:
            heard: called with the number of each worker when it has answered.
        """
        if not self.busy:
            raise RuntimeError("step_wait() was called without step_async()")
        results: list[Any] = []
        error: Exception | None = None
        try:
            for number in range(len(self.workers)):
                try:
                    results.append(self._result(number, check, patience))
                    if heard is not None:
                        heard(number)
                except (UserError, JobError) as raised:
                    if isinstance(raised, WorkerDiedError):
                        raise
                    error = error or raised
        except BaseException:
            # Interrupted between two answers, nobody could tell later whose is whose.
            self.close()
            raise
        self.busy = False
        if error is not None:
            raise error
        return results

    def _result(self, number: int, check: Callable[[], None] | None, patience: float) -> Any:
        """A worker's result, from one started in its place if need be."""
        while True:
            try:
                result = self._answer(number, check, patience)
            except _HungError:
                self.workers[number].process.kill()
                self._bury(number)
                assert self.recovery is not None
                self._recover(number, f"gave no answer for {patience * (self.recovery.silence or 0):g} s")
            except (EOFError, ConnectionError):
                self._recover(number, self._bury(number))
            else:
                self._lost[number] = 0
                return result

    def _answer(self, number: int, check: Callable[[], None] | None, patience: float) -> Any:
        silence = None if self.recovery is None else self.recovery.silence
        check = check or (None if self.recovery is None else self.recovery.check)
        if silence is not None or check is not None:
            end = None if silence is None else time.monotonic() + patience * silence
            connection = self.workers[number].connection
            while not connection.poll(GLANCE if end is None else max(0.0, min(GLANCE, end - time.monotonic()))):
                if check is not None:
                    check()
                if end is not None and time.monotonic() >= end and not connection.poll():
                    raise _HungError
        return self.workers[number].receive()

    def _bury(self, number: int) -> str:
        return f"died: {self.workers[number].bury()}"

    def _recover(self, number: int, cause: str) -> None:
        """Start a worker in the place of a lost one, bring its environments where they were, give it its job again.

        Raises:
            WorkerDiedError: nobody can tell where they were, or it has been tried too often; all are stopped.
        """
        while True:
            rows = self.rows[number]
            name = f"worker process {number + 1} of {len(self.rows)} (environments {rows.start} to {rows.stop - 1})"
            if self.recovery is None or self._lost[number] >= RETRIES or not self.memories:
                self.workers.pop(number)
                self.close()
                raise WorkerDiedError(f"{name} {cause}", hint="When memory is short, fewer workers help")
            self._lost[number] += 1
            self.recovery.told(f"{name} {cause}; it is started again and its episodes are played again")
            self.workers[number] = self._start(number)
            try:
                self._bring_back(number, self.recovery.plays()[rows])
                self.workers[number].send(self._jobs[number])
                return
            except _HungError:
                self.workers[number].process.kill()
                self._bury(number)
                cause = "gave no answer when it was started again"
            except (EOFError, ConnectionError):
                cause = self._bury(number)

    def _bring_back(self, number: int, plays: Sequence[Play]) -> None:
        rows, worker = self.rows[number], self.workers[number]
        worker.send(("open",))
        worker.receive()
        self.memories[number].close()
        memory = self.memories[number] = SharedObservations(self._space, rows.stop - rows.start)
        try:
            worker.send(("attach", memory.name))
            worker.receive()
        finally:
            memory.forget_name()
        worker.send(("replay", plays))
        self._answer(number, None, PATIENCE)

    def settle(self) -> None:
        """Hear what is still to be answered, and forget it."""
        if self.busy:
            self.receive()

    def close(self) -> None:
        """Stop every worker, those at work at once."""
        stop_workers(self.workers, at_once=self.busy)
        self.workers.clear()
        self.busy = False
        for memory in self.memories:
            memory.close()
        self.memories.clear()

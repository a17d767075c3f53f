"""Jobs on several processes: results in order, a dead worker's job done again.

The one place where work is handed to other processes, so that a cluster engine can take its place.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from multiprocessing.connection import wait
from typing import Any, TypeVar

from me3bev_cli.workers import Worker, WorkerDiedError, stop_workers

J = TypeVar("J")
R = TypeVar("R")

RETRIES = 2
"""How often a job is done again after its worker died."""


def run_jobs(
    function: Callable[[J], R],
    jobs: Sequence[J],
    workers: int,
    on_result: Callable[[int, R], None] | None = None,
    on_death: Callable[[int, int], None] | None = None,
) -> list[R]:
    """`function(job)` for every job, in the order of `jobs`.

    Each worker is a fresh process (spawn) that computes with one thread per library and writes what it prints
    to stderr. It is given `function` once and keeps it, so what the function remembers lasts from job to job.
    Ctrl-C reaches the caller as KeyboardInterrupt, with every worker gone.

    Args:
        function: can be pickled, as jobs and results can.
        workers: processes; 0 runs in this process, with the threads that it has.
        on_result: called here with (index of the job, result) as jobs finish, in any order.
        on_death: called with (index of the job, how often its worker has died so far).

    Raises:
        UserError: as a job raised it.
        WorkerDiedError: the worker died `RETRIES` + 1 times on one job.
        JobError: a job raised anything else.
    """
    results: dict[int, R] = {}

    def keep(index: int, result: R) -> None:
        results[index] = result
        if on_result is not None:
            on_result(index, result)

    if workers == 0:
        for index, job in enumerate(jobs):
            keep(index, function(job))
    else:
        pool = _Pool(function, jobs, workers, keep, on_death)
        try:
            pool.run()
        except BaseException:
            pool.stop(at_once=True)
            raise
        pool.stop(at_once=False)
    return [results[index] for index in range(len(jobs))]


class _Pool:
    """Hands jobs to workers and replaces those that die."""

    def __init__(
        self,
        function: Callable[[Any], Any],
        jobs: Sequence[Any],
        workers: int,
        on_result: Callable[[int, Any], None],
        on_death: Callable[[int, int], None] | None,
    ) -> None:
        self.function, self.jobs, self.on_result, self.on_death = function, jobs, on_result, on_death
        self.size = min(workers, len(jobs))
        self.waiting = deque(range(len(jobs)))
        self.deaths = [0] * len(jobs)
        self.left = len(jobs)
        self.workers: list[Worker] = []
        self.job_of: dict[Worker, int] = {}

    def run(self) -> None:
        for _ in range(self.size):
            self._start()
        while self.left:
            ready = wait([end for w in self.workers for end in (w.connection, w.process.sentinel)])
            for worker in list(self.workers):
                # What a worker sent before it died still counts.
                if worker.connection in ready or worker.process.sentinel in ready:
                    self._hear(worker)

    def _start(self) -> None:
        worker = Worker(self.function)
        self.workers.append(worker)
        self._give(worker)

    def _give(self, worker: Worker) -> None:
        if not self.waiting:
            return
        self.job_of[worker] = self.waiting.popleft()
        try:
            worker.send(self.jobs[self.job_of[worker]])
        except ConnectionError:
            self._bury(worker)

    def _hear(self, worker: Worker) -> None:
        try:
            if not worker.connection.poll():
                raise EOFError
            result = worker.receive()
        except (EOFError, ConnectionError):
            self._bury(worker)
            return
        job = self.job_of.pop(worker, None)
        if job is not None:
            self.left -= 1
            self.on_result(job, result)
        self._give(worker)

    def _bury(self, worker: Worker) -> None:
        """Note a worker's death, put its job back and start another worker."""
        self.workers.remove(worker)
        cause = worker.bury()
        job = self.job_of.pop(worker, None)
        if job is not None:
            self.deaths[job] += 1
            if self.on_death is not None:
                self.on_death(job, self.deaths[job])
            if self.deaths[job] > RETRIES:
                raise WorkerDiedError(
                    f"a worker process died {self.deaths[job]} times on the same work ({cause})",
                    hint="When memory is short, fewer --workers help",
                )
            self.waiting.appendleft(job)
        if self.waiting:
            self._start()

    def stop(self, at_once: bool) -> None:
        """End every worker."""
        stop_workers(self.workers, at_once)
        self.workers.clear()

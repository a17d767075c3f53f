"""Jobs on several processes: results in order, a dead worker's job done again.

The one place where work is handed to other processes, so that a cluster engine can take its place.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import traceback
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import Any, TypeVar

from me3bev_cli.errors import UserError

J = TypeVar("J")
R = TypeVar("R")

THREAD_VARIABLES = (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "VECLIB_MAXIMUM_THREADS",
    "NUMEXPR_NUM_THREADS",
    "NUMBA_NUM_THREADS",
    "OPENCV_FOR_THREADS_NUM",
)
"""What the libraries read, when they are loaded, to learn how many threads to use. torch reads the first."""

RETRIES = 2
"""How often a job is done again after its worker died."""


class WorkerDiedError(UserError):
    """A job whose worker process died every time."""


class JobError(RuntimeError):
    """A defect met in a worker process; the text holds the traceback from there."""


@dataclass(eq=False)
class _Worker:
    process: BaseProcess
    connection: Connection
    job: int | None = None


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
        self.workers: list[_Worker] = []

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
        context = multiprocessing.get_context("spawn")
        here, there = context.Pipe()
        process = context.Process(target=_serve, args=(there, self.function), daemon=True)
        with _one_thread(), _ctrl_c_waits():
            process.start()
        # Ours must be the only open copies, or nobody learns that the other side is gone.
        there.close()
        worker = _Worker(process, here)
        self.workers.append(worker)
        self._give(worker)

    def _give(self, worker: _Worker) -> None:
        worker.job = self.waiting.popleft() if self.waiting else None
        if worker.job is None:
            return
        try:
            worker.connection.send((self.jobs[worker.job],))
        except (BrokenPipeError, ConnectionError):
            self._bury(worker)

    def _hear(self, worker: _Worker) -> None:
        try:
            if not worker.connection.poll():
                raise EOFError
            kind, payload = worker.connection.recv()
        except (EOFError, ConnectionError):
            self._bury(worker)
            return
        if kind == "mistake":
            raise _revived(*payload)
        if kind == "defect":
            raise JobError(payload)
        if worker.job is not None:
            self.left -= 1
            self.on_result(worker.job, payload)
        self._give(worker)

    def _bury(self, worker: _Worker) -> None:
        """Note a worker's death, put its job back and start another worker."""
        self.workers.remove(worker)
        worker.connection.close()
        worker.process.join()
        job = worker.job
        if job is not None:
            self.deaths[job] += 1
            if self.on_death is not None:
                self.on_death(job, self.deaths[job])
            if self.deaths[job] > RETRIES:
                raise WorkerDiedError(
                    f"a worker process died {self.deaths[job]} times on the same work ({_cause(worker.process)})",
                    hint="When memory is short, fewer --workers help",
                )
            self.waiting.appendleft(job)
        if self.waiting:
            self._start()

    def stop(self, at_once: bool) -> None:
        """End every worker: idle ones leave when their pipe closes."""
        for worker in self.workers:
            worker.connection.close()
            if at_once:
                worker.process.terminate()
        for worker in self.workers:
            worker.process.join(5)
            if worker.process.is_alive():
                worker.process.kill()
                worker.process.join()
        self.workers.clear()


def _serve(connection: Connection, function: Callable[[Any], Any]) -> None:
    """A worker's life: do what comes through the pipe until it closes."""
    # Stdout belongs to the command's results; libraries that greet there go to stderr.
    sys.stdout = sys.stderr
    os.dup2(2, 1)
    while True:
        try:
            (job,) = connection.recv()
        except (EOFError, OSError):
            return
        try:
            answer: tuple[str, Any] = ("result", function(job))
        except UserError as error:
            answer = ("mistake", (type(error), error.args, vars(error)))
        except Exception:
            answer = ("defect", f"in a worker process:\n{traceback.format_exc()}")
        try:
            connection.send(answer)
        except (BrokenPipeError, ConnectionError):
            return
        except Exception:
            connection.send(("defect", f"a result cannot be sent:\n{traceback.format_exc()}"))


def _revived(kind: type[UserError], args: tuple[Any, ...], state: dict[str, Any]) -> UserError:
    """The error as it was raised: its constructor may take other arguments than it keeps."""
    error = kind.__new__(kind, *args)
    error.args = args
    vars(error).update(state)
    return error


def _cause(process: BaseProcess) -> str:
    code = process.exitcode
    if code is not None and code < 0:
        return f"killed by {signal.Signals(-code).name}"
    return f"exit code {code}"


@contextmanager
def _one_thread() -> Iterator[None]:
    """Processes started inside compute with one thread."""
    before = {name: os.environ.get(name) for name in THREAD_VARIABLES}
    os.environ.update(dict.fromkeys(THREAD_VARIABLES, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


@contextmanager
def _ctrl_c_waits() -> Iterator[None]:
    """Processes started inside never see Ctrl-C, which the terminal sends to all: their parent ends them."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    # Starting its helper process, multiprocessing would let Ctrl-C through again: have it started already.
    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)

"""A worker: a process of its own that answers calls of one function, until nobody wants it any more."""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import traceback
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection
from typing import Any

from me3bev_cli.allocator import keep_freed_memory
from me3bev_cli.errors import UserError

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


class WorkerDiedError(UserError):
    """A worker process that died, each time when its work was tried again."""


class JobError(RuntimeError):
    """A defect met in a worker process; the text holds the traceback from there."""


def cores() -> int:
    """How many processors this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def core_of_each(workers: int) -> list[int | None]:
    """The processor that each of some workers is to stay on: all, one each, or None where they are not as many.

    Workers that are woken in turn by one process, and wait for each other, are otherwise often put on the same one.
    """
    if not hasattr(os, "sched_getaffinity") or workers != cores():
        return [None] * workers
    return [*sorted(os.sched_getaffinity(0))]


class Worker:
    """A fresh process (spawn) that computes with one thread per library and writes what it prints to stderr.

    It is given `function` once and keeps it, so what the function remembers lasts from call to call; if it has a
    method `close`, that is called at the end. It never sees Ctrl-C, and leaves when this process is gone.

    Args:
        function: of one argument; can be pickled, as its arguments and results can.
        core: the processor to stay on; None: any.
    """

    def __init__(self, function: Callable[[Any], Any], core: int | None = None) -> None:
        context = multiprocessing.get_context("spawn")
        self.connection, there = context.Pipe()
        self.process = context.Process(target=_serve, args=(there, function, core), daemon=True)
        with _one_thread(), _ctrl_c_waits():
            self.process.start()
        # Ours must be the only open copies, or nobody learns that the other side is gone.
        there.close()

    def send(self, job: Any) -> None:
        """Have `function(job)` done. Raises ConnectionError when the process is gone."""
        self.connection.send((job,))

    def receive(self) -> Any:
        """Wait for the result of the job that was sent.

        Raises:
            EOFError, ConnectionError: the process is gone.
            UserError: as the job raised it.
            JobError: the job raised anything else.
        """
        kind, payload = self.connection.recv()
        if kind == "mistake":
            raise _revived(*payload)
        if kind == "defect":
            raise JobError(payload)
        return payload

    def bury(self) -> str:
        """Close what is left of a process that is gone; why it went."""
        self.connection.close()
        self.process.join()
        code = self.process.exitcode
        if code is not None and code < 0:
            return f"killed by {signal.Signals(-code).name}"
        return f"exit code {code}"


def stop_workers(workers: Iterable[Worker], at_once: bool) -> None:
    """End processes: idle ones leave when their pipe closes; `at_once` interrupts the others too."""
    workers = list(workers)
    for worker in workers:
        worker.connection.close()
        if at_once:
            worker.process.terminate()
    for worker in workers:
        worker.process.join(1 if at_once else 5)
        if worker.process.is_alive():
            worker.process.kill()
            worker.process.join()


def _serve(connection: Connection, function: Callable[[Any], Any], core: int | None) -> None:
    """A worker's life: do what comes through the pipe until it closes."""
    if core is not None:
        with suppress(OSError):  # It may have been taken away meanwhile.
            os.sched_setaffinity(0, {core})
    keep_freed_memory()
    # Stdout belongs to the command's results; libraries that greet there go to stderr.
    sys.stdout = sys.stderr
    os.dup2(2, 1)
    while _answer(connection, function):
        pass
    close = getattr(function, "close", None)
    if close is not None:
        close()


def _answer(connection: Connection, function: Callable[[Any], Any]) -> bool:
    """Do one job; False when nobody asks any more."""
    try:
        (job,) = connection.recv()
    except (EOFError, OSError):
        return False
    try:
        answer: tuple[str, Any] = ("result", function(job))
    except UserError as error:
        answer = ("mistake", (type(error), error.args, vars(error)))
    except Exception:
        answer = ("defect", f"in a worker process:\n{traceback.format_exc()}")
    try:
        connection.send(answer)
    except (BrokenPipeError, ConnectionError):
        return False
    except Exception:
        connection.send(("defect", f"a result cannot be sent:\n{traceback.format_exc()}"))
    return True


def _revived(kind: type[UserError], args: tuple[Any, ...], state: dict[str, Any]) -> UserError:
    """The error as it was raised: its constructor may take other arguments than it keeps."""
    error = kind.__new__(kind, *args)
    error.args = args
    vars(error).update(state)
    return error


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

"""Draws jobs' frames in worker processes while the network learns, or here when there is but one process."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from multiprocessing.connection import wait

from me3bev_cli.parallel import RETRIES
from me3bev_cli.perception.frames import Frames, FrameSource, Job
from me3bev_cli.workers import Worker, WorkerDiedError, stop_workers

PATIENCE = 0.2
"""Seconds between two looks at whether to go on waiting."""


class Drawer:
    """Does jobs in the background; a dead worker's job is done again. What comes out depends on the jobs alone.

    Args:
        source: what does a job.
        workers: processes; 1 draws in this one.
    """

    def __init__(self, source: FrameSource, workers: int) -> None:
        self.source, self.size = source, 0 if workers <= 1 else workers
        self._workers: list[Worker] = []
        self._job_of: dict[Worker, int] = {}
        self._jobs: list[Job] = []
        self._waiting: deque[int] = deque()
        self._results: dict[int, Frames] = {}
        self._deaths = 0

    def begin(self, jobs: Sequence[Job]) -> None:
        """Have jobs done; those of before are forgotten when they have been taken."""
        self._jobs, self._results = list(jobs), {}
        self._waiting.extend(range(len(jobs)))
        while len(self._workers) < min(self.size, len(jobs)):
            self._workers.append(Worker(self.source))
        for worker in self._workers:
            self._give(worker)

    def attend(self) -> None:
        """Keep the workers busy; to be called often between `begin` and `take`."""
        if self._job_of:
            self._hear(0.0)

    def take(self, going: Callable[[], None]) -> list[Frames]:
        """Wait for the jobs that were begun: their frames, in order.

        Args:
            going: called now and then; what it raises ends the waiting.

        Raises:
            UserError: as a job raised it.
            WorkerDiedError: workers died time and again.
        """
        while len(self._results) < len(self._jobs):
            going()
            if self.size:
                self._hear(PATIENCE)
            else:
                number = self._waiting.popleft()
                self._results[number] = self.source(self._jobs[number])
        return [self._results.pop(number) for number in range(len(self._jobs))]

    def close(self) -> None:
        """End the workers at once."""
        stop_workers(self._workers, at_once=True)
        self._workers.clear()
        self.source.close()

    def _give(self, worker: Worker) -> None:
        if not self._waiting:
            return
        self._job_of[worker] = self._waiting.popleft()
        try:
            worker.send(self._jobs[self._job_of[worker]])
        except ConnectionError:
            self._replace(worker)

    def _hear(self, timeout: float) -> None:
        ready = wait([end for worker in self._job_of for end in (worker.connection, worker.process.sentinel)], timeout)
        for worker in list(self._job_of):
            if worker.connection in ready or worker.process.sentinel in ready:
                try:
                    if not worker.connection.poll():
                        raise EOFError
                    self._results[self._job_of[worker]] = worker.receive()
                except (EOFError, ConnectionError):
                    self._replace(worker)
                    continue
                del self._job_of[worker]
                self._give(worker)

    def _replace(self, worker: Worker) -> None:
        """Start another process in place of one that died, and have its job done again."""
        cause = worker.bury()
        self._workers.remove(worker)
        self._waiting.appendleft(self._job_of.pop(worker))
        self._deaths += 1
        if self._deaths > RETRIES:
            raise WorkerDiedError(
                f"worker processes died {self._deaths} times while they drew frames ({cause})",
                hint="When memory is short, fewer workers help",
            )
        self._workers.append(Worker(self.source))
        self._give(self._workers[-1])

"""How far an evaluation has come, on stderr: a live bar in a terminal, now and then a line elsewhere."""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from types import TracebackType
from typing import TYPE_CHECKING, TextIO

from me3bev_cli.evaluation.episode import Episode
from me3bev_cli.training.display import clock

if TYPE_CHECKING:
    from rich.progress import Progress, TaskID

LINE_EVERY = 10.0
"""Seconds between two lines where there is no terminal."""


class EvaluationProgress:
    """Counts episodes and steps; use it as a context.

    Args:
        total: episodes.
        stream: where to show it; stderr by default.
    """

    def __init__(self, total: int, stream: TextIO | None = None) -> None:
        self.total, self.stream = total, stream or sys.stderr
        self.episodes = self.steps = self.collisions = self.deaths = self.before = 0
        self.start = self.shown = time.monotonic()
        self.bar: Progress | None = None
        self.task: TaskID | None = None

    def __enter__(self) -> EvaluationProgress:
        if self.stream.isatty():
            from rich.console import Console
            from rich.progress import BarColumn, Progress, TextColumn

            columns = (BarColumn(bar_width=24), TextColumn("{task.description}"))
            self.bar = Progress(*columns, console=Console(file=self.stream, highlight=False), transient=True)
            self.bar.start()
            self.task = self.bar.add_task("starting", total=self.total)
        else:
            self.stream.write(f"evaluating: {self.total} episodes\n")
            self.stream.flush()
        return self

    def begin(self, done: Sequence[Episode]) -> None:
        """Some episodes have been driven before: they are counted, but not in the rate."""
        self.start = self.shown = time.monotonic()
        self.episodes = self.before = len(done)
        self.collisions = sum(episode.ended == "collision" for episode in done)
        if done and self.bar is None:
            self.stream.write(f"{len(done)} of them have been driven already\n")
            self.stream.flush()

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None) -> None:
        if self.bar is not None:
            self.bar.stop()

    def add(self, episodes: Sequence[Episode]) -> None:
        """Some episodes are finished."""
        self.episodes += len(episodes)
        self.steps += sum(len(episode) for episode in episodes)
        self.collisions += sum(episode.ended == "collision" for episode in episodes)
        now = time.monotonic()
        if self.bar is not None and self.task is not None:
            self.bar.update(self.task, completed=self.episodes, description=self.text())
        elif now - self.shown >= LINE_EVERY or self.episodes == self.total:
            self.shown = now
            self.stream.write(self.text() + "\n")
            self.stream.flush()

    def died(self, job: int, times: int) -> None:
        """A worker died; its work is done again."""
        self.deaths += 1

    @property
    def seconds(self) -> float:
        """Time since the start."""
        return time.monotonic() - self.start

    def text(self) -> str:
        """Episodes, rate, time left, collisions."""
        rate = self.steps / max(self.seconds, 1e-9)
        left = self.seconds / max(self.episodes - self.before, 1) * (self.total - self.episodes)
        text = f"{self.episodes}/{self.total} episodes  {rate:.0f} steps/s  left {clock(left)}"
        text += f"  collisions {self.collisions / max(self.episodes, 1):.2f}"
        return text + (f"  workers lost {self.deaths}" if self.deaths else "")

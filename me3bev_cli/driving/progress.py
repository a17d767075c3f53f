"""How far a drive has come, on stderr: a live line in a terminal, now and then a plain one elsewhere."""

from __future__ import annotations

import sys
import time
from typing import TextIO

from me3bev_cli.training.display import clock

LIVE_EVERY, LINE_EVERY = 0.5, 10.0
"""Seconds between two lines, in a terminal and elsewhere."""


class DriveProgress:
    """Counts steps.

    Args:
        episodes: how many there will be.
        longest: steps that an episode may have; only a guess for the time that is left.
        stream: where to show it; stderr by default.
    """

    def __init__(self, episodes: int, longest: int, stream: TextIO | None = None) -> None:
        self.episodes, self.longest = episodes, longest
        self.stream = stream or sys.stderr
        self.live = self.stream.isatty()
        self.done = self.steps = self.total = 0
        self.start = self.shown = time.monotonic()

    def step(self) -> None:
        """One more step."""
        now = time.monotonic()
        if not self.total:
            # What goes before the first step (a map is opened, code is compiled) says nothing of the rate.
            self.start = now
        self.steps += 1
        self.total += 1
        if now - self.shown >= (LIVE_EVERY if self.live else LINE_EVERY):
            self.shown = now
            self.stream.write(("\r\x1b[2K" if self.live else "") + self.text() + ("" if self.live else "\n"))
            self.stream.flush()

    def episode(self) -> None:
        """An episode is over; the live line makes room for its outcome."""
        self.done, self.steps = self.done + 1, 0
        self.clear()

    def clear(self) -> None:
        """Take the live line away."""
        if self.live:
            self.stream.write("\r\x1b[2K")
            self.stream.flush()

    def text(self) -> str:
        """Episode, step, rate and the time that is left if every episode is as long as it may be."""
        rate = (self.total - 1) / max(time.monotonic() - self.start, 1e-9)
        left = max(0, (self.episodes - self.done) * self.longest - self.steps)
        return (
            f"episode {self.done + 1}/{self.episodes}  step {self.steps}"
            f"  {rate:.0f} steps/s  left at most {clock(left / rate) if rate > 0 else '?'}"
        )

"""How far the measuring has come, on stderr: a live line in a terminal, now and then a line elsewhere."""

from __future__ import annotations

import sys
import time
from typing import TextIO

from me3bev_cli.training.display import clock

LINE_EVERY = 10.0
"""Seconds between two lines where there is no terminal."""


class LatencyProgress:
    """Called with what is done, how much of it, of how much, and the seconds left, if known."""

    def __init__(self, stream: TextIO | None = None) -> None:
        self.stream = stream or sys.stderr
        self.live = self.stream.isatty()
        self.shown = time.monotonic()

    def __call__(self, what: str, done: int, total: int, left: float | None) -> None:
        now = time.monotonic()
        if not self.live and now - self.shown < LINE_EVERY:
            return
        self.shown = now
        text = f"{what} {done + 1}/{total}" + ("" if left is None else f"  left {clock(left)}")
        self.stream.write(f"\r\x1b[2K{text}" if self.live else text + "\n")
        self.stream.flush()

    def end(self) -> None:
        """Clear the live line."""
        if self.live:
            self.stream.write("\r\x1b[2K")
            self.stream.flush()

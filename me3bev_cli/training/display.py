"""What training shows: a live line in a terminal, a plain line per update elsewhere."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from typing import Any, TextIO


def clock(seconds: float) -> str:
    """Seconds as h:mm:ss or m:ss."""
    whole = max(0, round(seconds))
    hours, rest = divmod(whole, 3600)
    minutes, secs = divmod(rest, 60)
    return f"{hours}:{minutes:02}:{secs:02}" if hours else f"{minutes}:{secs:02}"


def _number(value: float | None, digits: int) -> str:
    return "-" if value is None else f"{value:.{digits}f}"


class Display:
    """Shows stage, steps, rate, time left, reward, collision rate and KL.

    Args:
        total: environment steps of all stages.
        done: steps done in earlier sittings.
    """

    LIVE_EVERY = 0.5
    """Seconds between two refreshes of the live line."""

    def __init__(self, total: int, stages: int, done: int = 0, stream: TextIO | None = None) -> None:
        self.total, self.stages, self.begun_at = total, stages, done
        self.stream = stream or sys.stderr
        self.live = self.stream.isatty()
        self.start = time.monotonic()
        self.shown = 0.0
        self.last: dict[str, Any] = {}

    def step(self, line: Callable[[], dict[str, Any]]) -> None:
        """Refresh the live line, at most twice a second; `line` is asked for only then."""
        now = time.monotonic()
        if self.live and now - self.shown > self.LIVE_EVERY:
            self.shown = now
            row = line()
            kept = {key: self.last.get(key) for key in ("kl", "reward_per_step")}
            merged = row | {key: value for key, value in kept.items() if row.get(key) is None}
            self.stream.write("\r\x1b[2K" + self._text(merged)[:150])
            self.stream.flush()

    def update(self, row: dict[str, Any]) -> None:
        """One line for a finished rollout."""
        self.last = row
        self.stream.write(("\r\x1b[2K" if self.live else "") + self._text(row) + "\n")
        self.stream.flush()

    def say(self, text: str) -> None:
        """A line of its own."""
        self.stream.write(("\r\x1b[2K" if self.live else "") + text + "\n")
        self.stream.flush()

    def _text(self, row: dict[str, Any]) -> str:
        rate = (row["steps"] - self.begun_at) / max(time.monotonic() - self.start, 1e-9)
        left = clock((self.total - row["steps"]) / rate) if rate > 0 else "?"
        return (
            f"stage {row['stage'] + 1}/{self.stages}  {row['steps']:,}/{self.total:,} steps"
            f"  {rate:.0f}/s  left {left}"
            f"  reward/step {_number(row['reward_per_step'], 2)}"
            f"  collisions {_number(row['collision_rate'], 2)}"
            f"  completion {_number(row['route_completion'], 2)}"
            f"  kl {_number(row.get('kl'), 4)}"
        )

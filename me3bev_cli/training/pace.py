"""How fast training goes and how long it will take."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from typing import Any


def clock(seconds: float) -> str:
    """Seconds as h:mm:ss or m:ss."""
    whole = max(0, round(seconds))
    hours, rest = divmod(whole, 3600)
    minutes, secs = divmod(rest, 60)
    return f"{hours}:{minutes:02}:{secs:02}" if hours else f"{minutes}:{secs:02}"


class Pace:
    """The rate of the present stage over its last updates: stages of another kind have rates of their own.

    Args:
        stages: kind and environment steps of each.
        done: steps of earlier sittings.
        now: the time in seconds.
    """

    WINDOW = 10
    """Updates that the rate is taken over."""

    def __init__(
        self, stages: Sequence[tuple[str, int]], done: int = 0, now: Callable[[], float] = time.monotonic
    ) -> None:
        self.stages, self._now = stages, now
        self._stage = -1
        self._marks: deque[tuple[float, int]] = deque(maxlen=self.WINDOW + 1)
        self.begin(done)

    def begin(self, done: int) -> None:
        """Count from here: so many steps were done in earlier sittings."""
        self._stage, self._last = -1, (self._now(), done)

    def see(self, row: Mapping[str, Any], updated: bool = False) -> None:
        """Take notice of where training stands; `updated` after an update."""
        if row["stage"] != self._stage:
            self._stage = row["stage"]
            self._marks.clear()
            self._marks.append(self._last)
        self._last = (self._now(), row["steps"])
        if updated:
            self._marks.append(self._last)

    @property
    def rate(self) -> float:
        """Environment steps per second; 0 where nothing is known yet."""
        if not self._marks:
            return 0.0
        (then, before), (now, steps) = self._marks[0], self._last
        return (steps - before) / (now - then) if now > then else 0.0

    def left(self, row: Mapping[str, Any]) -> str:
        """Time to the end of the run, or to the end of the stage where others of another kind come after it."""
        if self.rate <= 0:
            return "?"
        kind, steps = self.stages[row["stage"]]
        later = self.stages[row["stage"] + 1 :]
        here = max(0, steps - row["stage_steps"])
        if all(name == kind for name, _ in later):
            return clock((here + sum(number for _, number in later)) / self.rate)
        more = f"{len(later)} more stage{'s' if len(later) > 1 else ''}"
        return f"{clock(here / self.rate)} and {more}"

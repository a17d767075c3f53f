"""Ctrl-C as a request: what is under way is finished and kept."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from signal import SIGINT, SIGTERM, signal
from typing import Any


class Stop:
    """Turns Ctrl-C and SIGTERM into a request that is honoured between two steps."""

    def __init__(self) -> None:
        self.asked = False

    def _ask(self, *_: Any) -> None:
        if self.asked:
            raise KeyboardInterrupt
        self.asked = True

    @contextmanager
    def listening(self) -> Iterator[None]:
        """Honour signals inside the block; a second Ctrl-C stops at once."""
        before = {number: signal(number, self._ask) for number in (SIGINT, SIGTERM)}
        try:
            yield
        finally:
            for number, handler in before.items():
                signal(number, handler)

"""The live table of a training in a terminal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TextIO

from rich.console import Console
from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.table import Table

COLUMNS = 2
"""Pairs of label and value side by side: it fits 80 characters."""


def start(stream: TextIO) -> Live:
    """An empty live region at the end of a terminal."""
    console = Console(file=stream, highlight=False)
    # Nothing else writes to stdout or stderr through it: results that go to stdout stay as they are.
    live = Live(console=console, auto_refresh=False, redirect_stdout=False, redirect_stderr=False)
    live.start()
    return live


def table(where: Mapping[str, str], figures: Sequence[tuple[str, str]], steps: int, total: int) -> Table:
    """A bar, and pairs of label and value below it.

    Args:
        where: stage, steps, rate and time left.
        figures: what is learned.
    """
    grid = Table.grid(padding=(0, 2))
    for _ in range(COLUMNS):
        grid.add_column(style="dim", no_wrap=True)
        grid.add_column(no_wrap=True, min_width=18)
    pairs = [*where.items(), *figures]
    for first in range(0, len(pairs), COLUMNS):
        grid.add_row(*(cell for pair in pairs[first : first + COLUMNS] for cell in pair))
    whole = Table.grid()
    whole.add_row(ProgressBar(total=max(total, 1), completed=min(steps, total), width=60))
    whole.add_row(grid)
    return whole

"""What training shows: a live table in a terminal, a plain line per update elsewhere."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, TextIO

from me3bev_cli.training.best import SCORE
from me3bev_cli.training.pace import Pace, clock

if TYPE_CHECKING:
    from rich.live import Live

__all__ = ["Display", "clock"]

LABELS = {
    "reward_per_step": ("reward/step", 2),
    "shaped_reward_per_step": ("with terms", 2),
    "collision_rate": ("collisions", 2),
    "route_completion": ("completion", 2),
    "kl": ("kl", 4),
}
"""Column of the log -> label and decimals, in the order in which they are shown."""

MOST = 20
"""Figures in the table: it must fit a screen of 24 lines."""

EVALUATION = {
    SCORE: ("driving score", 1),
    "eval_collision_rate": ("collisions", 2),
    "eval_completion": ("completion", 2),
    "eval_success": ("success", 2),
}

HIDDEN = (
    "stage", "kind", "steps", "stage_steps", "episodes", "steps_per_second", "episode_steps", "learning_rate",
    "value_loss", "policy_loss", "entropy_loss", "clip_fraction", "explained_variance",
)  # fmt: skip
"""For those who read the log."""


def number(value: float | None, digits: int) -> str:
    """For people; a dash for what is not known."""
    return "-" if value is None else f"{value:.{digits}f}"


def figures(row: Mapping[str, Any]) -> list[tuple[str, str]]:
    """What of a row is shown, with labels: what every stage has first, then what is this kind of stage's own."""
    known = [(label, number(row[key], digits)) for key, (label, digits) in LABELS.items() if key in row]
    own = [
        (key.replace("_", " "), number(value, 3))
        for key, value in row.items()
        if key not in LABELS and key not in HIDDEN and not key.startswith("eval_")
    ]
    return known + own


class Display:
    """Shows stage, steps, rate, time left, what is learned, and the best evaluation.

    Args:
        total: environment steps of all stages.
        stages: how many there are.
        done: steps done in earlier sittings.
        stream: where to; stderr by default.
        plan: kind and environment steps of each stage, where they are known.
    """

    LIVE_EVERY = 0.5
    """Seconds between two refreshes of the table."""

    def __init__(
        self,
        total: int,
        stages: int,
        done: int = 0,
        stream: TextIO | None = None,
        plan: Sequence[tuple[str, int]] | None = None,
    ) -> None:
        self.total, self.stages = total, stages
        self.stream = stream or sys.stderr
        self.live = self.stream.isatty() and os.environ.get("TERM") != "dumb"
        self.pace = Pace(plan or [("", total)] * stages, done)
        self.shown = 0.0
        self.last: dict[str, Any] = {}
        self.best: tuple[float, int] | None = None
        """Score and step of the best evaluation."""
        self._table: Live | None = None

    def begin(self, done: int, best: Mapping[str, Any] | None = None) -> None:
        """A sitting begins after so many steps, with this best evaluation of earlier ones."""
        self.pace.begin(done)
        if best is not None:
            self.best = (best[SCORE], best["steps"])

    def step(self, line: Callable[[], dict[str, Any]]) -> None:
        """Refresh the table, at most twice a second; `line` is asked for only then."""
        now = time.monotonic()
        if self.live and now - self.shown > self.LIVE_EVERY:
            self.shown = now
            row = line()
            self.pace.see(row)
            if self.last.get("stage") == row["stage"]:
                row = self.last | {key: value for key, value in row.items() if value is not None}
            self._draw(row)

    def update(self, row: dict[str, Any]) -> None:
        """An update or an evaluation is finished."""
        judged = SCORE in row
        self.pace.see(row, updated=not judged)
        if judged:
            self._judge(row)
        elif self.live:
            if self.last and self.last["stage"] != row["stage"]:
                self._print(self._text(self.last))
                self.last = {}
            # What is not measured at every update stays to be seen.
            self.last = self.last | row
            self._draw(self.last)
        else:
            self.last = row
            self._print(self._text(row))

    def say(self, text: str) -> None:
        """A line of its own."""
        self._print(text)

    def close(self) -> None:
        """Leave the table as it is; what comes after it is written below."""
        if self._table is not None:
            self._table.stop()
            self._table = None

    def _judge(self, row: Mapping[str, Any]) -> None:
        better = row[SCORE] is not None and (self.best is None or row[SCORE] > self.best[0])
        if better:
            self.best = (row[SCORE], row["steps"])
        shown = "  ".join(f"{label} {number(row.get(key), digits)}" for key, (label, digits) in EVALUATION.items())
        count = f"{row['eval_episodes']:.0f} episodes in {row['eval_seconds']:.0f} s"
        self._print(f"evaluation at {row['steps']:,} steps  {shown}  ({count}){'  best so far' if better else ''}")

    def _print(self, text: str) -> None:
        if self._table is not None:
            self._table.console.print(text, markup=False, soft_wrap=True)
        else:
            self.stream.write(text + "\n")
            self.stream.flush()

    def where(self, row: Mapping[str, Any]) -> dict[str, str]:
        """Stage, steps, rate and time left, by label."""
        kind = f" {row['kind']}" if row.get("kind") else ""
        return {
            "stage": f"{row['stage'] + 1}/{self.stages}{kind}",
            "steps": f"{row['steps']:,}/{self.total:,}",
            "steps/s": f"{self.pace.rate:.0f}",
            "left": self.pace.left(row),
        }

    def _text(self, row: Mapping[str, Any]) -> str:
        here = self.where(row)
        parts = [f"stage {here['stage']}", f"{here['steps']} steps", f"{here['steps/s']}/s", f"left {here['left']}"]
        return "  ".join([*parts, *(f"{label} {value}" for label, value in figures(row))])

    def _draw(self, row: Mapping[str, Any]) -> None:
        from me3bev_cli.training.display_table import start, table

        if self._table is None:
            self._table = start(self.stream)
        shown = figures(row)[:MOST]
        if self.best is not None:
            shown.append(("best evaluation", f"{self.best[0]:.1f} at {self.best[1]:,}"))
        self._table.update(table(self.where(row), shown, row["steps"], self.total), refresh=True)

"""Latency from raw observation to action, whole and by stage, of networks and contexts that take turns.

Timed: from uint8 images and float32 features in host memory to a clipped action in host memory, the policy's memory
included. Not timed: the simulator, building the network, and the first calls (warm-up). Networks take turns frame by
frame, so that a change of the machine's speed touches all of them, and the machine's ceilings are sampled between.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from me3bev_cli.bench.flops import Cost
from me3bev_cli.bench.latency_network import Bench, Conditions, Variant
from me3bev_cli.bench.latency_subjects import Subject
from me3bev_cli.bench.machine_ceilings import Ceilings

LEAST = 3
"""Calls that even the slowest context gets."""
WARMUP_SECONDS = 0.2
"""A context that has taken this long is warm."""
CEILING_SAMPLES = 10
"""Rounds after which the ceilings are measured, at first; later every tenth of all rounds."""

Progress = Callable[[str, int, int, float | None], None]
"""What is done, how much of it, of how much, and the seconds left, if known."""


@dataclass(frozen=True)
class Effort:
    """How long to measure."""

    warmup: int = 5
    """Frames before the timing begins."""
    repeats: int = 50
    """Timed frames of each network in each context, at most."""
    seconds: float = 90.0
    """Of timing in all; slow contexts end when they have used their share."""


@dataclass
class Measured:
    """What was found before the time was over or somebody stopped it."""

    benches: list[Bench]
    ceilings: Ceilings
    stopped: bool = False

    @property
    def variants(self) -> list[Variant]:
        """Those that were timed at least once."""
        return [variant for bench in self.benches for variant in bench.variants if variant.samples]


def _silent(what: str, done: int, total: int, left: float | None) -> None:
    pass


def measure(
    subjects: Sequence[Subject],
    conditions: Conditions,
    effort: Effort,
    lengths: Sequence[int] | None = None,
    progress: Progress = _silent,
    stopped: Callable[[], bool] = lambda: False,
    ceilings: Ceilings | None = None,
) -> Measured:
    """Build the networks and time them in turns.

    Args:
        lengths: of the contexts; None: the usual ones and each recipe's own.
        stopped: asked between two frames; what has been measured by then is kept.
    """
    ceilings = ceilings or Ceilings(conditions.device, conditions.dtype)
    measured, known = Measured([], ceilings), dict[Any, Cost]()
    begun = time.perf_counter()
    for number, subject in enumerate(subjects):
        left = None if number == 0 else (time.perf_counter() - begun) / number * (len(subjects) - number)
        progress("building", number, len(subjects), None if left is None else left + effort.seconds)
        if stopped():
            break
        bench = Bench(subject, conditions, lengths, known)
        _warm_up(bench, effort.warmup)
        measured.benches.append(bench)
    ceilings.sample()
    if not stopped():
        _take_turns(measured, effort, progress, stopped)
    measured.stopped = stopped()
    return measured


def _warm_up(bench: Bench, frames: int) -> None:
    """Each context for so many frames, or until it is warm: it has been called once for its costs already."""
    due = list(bench.variants)
    spent = dict.fromkeys(due, 0.0)
    for _ in range(frames):
        if not due:
            return
        for variant, seconds in bench.turn(due, keep=False).items():
            spent[variant] += seconds
        due = [variant for variant in due if spent[variant] < WARMUP_SECONDS]


def _take_turns(measured: Measured, effort: Effort, progress: Progress, stopped: Callable[[], bool]) -> None:
    """Rounds in which every network has a turn, until all contexts have enough calls or the time is over."""
    count = sum(len(bench.variants) for bench in measured.benches)
    share = effort.seconds / max(count, 1)
    spent = {variant: 0.0 for bench in measured.benches for variant in bench.variants}
    begun, pause = time.perf_counter(), max(1, effort.repeats // CEILING_SAMPLES)

    def due(bench: Bench) -> list[Variant]:
        return [v for v in bench.variants if len(v.samples) < LEAST or spent[v] < share]

    for number in range(effort.repeats):
        passed = time.perf_counter() - begun
        if number >= LEAST and passed > effort.seconds:
            return
        expected = passed / max(number, 1) * (effort.repeats - number)
        progress("timing", number, effort.repeats, min(expected, effort.seconds - passed) if number else None)
        for bench in measured.benches:
            if stopped():
                return
            for variant, seconds in bench.turn(due(bench)).items():
                spent[variant] += seconds
        if number < CEILING_SAMPLES or number % pause == 0:
            measured.ceilings.sample()

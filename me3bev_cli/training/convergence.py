"""Convergence: reward per step against environment steps, over seeds, and where a run comes near its plateau."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from me3bev_cli.training.curve import read_metrics, reward_rows

Floats = NDArray[np.float64]

TAIL = 0.1
"""Share of the steps at the end whose mean is the plateau."""
NEAR = 0.9
"""Share of the plateau that counts as reaching it."""
STILL_RISING = 0.05
"""A last tenth that is above the one before by more than this share of the whole rise says that it goes on."""


@dataclass(frozen=True, eq=False)
class Curve:
    """One run's reward.

    Args:
        steps: (U,) environment steps of the run at each update, rising; earlier stages of other kinds shift them.
        reward: (U,) per step, as logged.
        smooth: (U,) moving average of it.
        before: kinds of the stages before the first update that is shown.
    """

    run: Path
    seed: int
    steps: Floats
    reward: Floats
    smooth: Floats
    before: tuple[str, ...] = ()


@dataclass(frozen=True)
class Reached:
    """Where a curve comes near its plateau."""

    plateau: float
    """Mean of the moving average over the last tenth of the steps."""
    threshold: float
    """0.9 of a positive plateau; otherwise 0.9 of the way up to it from the first value."""
    step: int | None
    """First environment step whose moving average is at the threshold; None when the curve never rose."""
    rising: bool
    """The curve was still rising at its end: a longer run would have a higher plateau, and reach it later."""


@dataclass(frozen=True, eq=False)
class Group:
    """Runs of the same recipe but for the seed."""

    label: str
    curves: tuple[Curve, ...]
    steps: Floats
    """(S,) where all of them have values."""
    mean: Floats
    low: Floats
    high: Floats
    """(S,) over the runs: mean, least and greatest moving average."""


def moving_average(values: Floats, window: int) -> Floats:
    """The mean of each value and of the `window` - 1 before it, of fewer at the beginning: (U,) -> (U,)."""
    sums = np.concatenate([[0.0], np.cumsum(values)])
    ends = np.arange(1, len(values) + 1)
    begins = np.maximum(0, ends - window)
    return np.asarray((sums[ends] - sums[begins]) / (ends - begins))


def read_curve(run: Path, seed: int, window: int) -> Curve | None:
    """The curve of a run; None while it has no update with a reward."""
    rows = read_metrics(run)
    shown = reward_rows(rows)
    if not shown:
        return None
    steps = np.array([row["steps"] for row in shown], np.float64)
    reward = np.array([row["reward_per_step"] for row in shown], np.float64)
    first = shown[0]["stage"]
    before = {row["stage"]: str(row.get("kind", "?")) for row in rows if row["stage"] < first}
    return Curve(run, seed, steps, reward, moving_average(reward, window), tuple(before[key] for key in sorted(before)))


def reached(steps: Floats, smooth: Floats) -> Reached:
    """Where a moving average comes near its plateau.

    Args:
        steps: (U,) rising.
        smooth: (U,).
    """
    end, length = steps[-1], steps[-1] - steps[0]
    tail = steps >= end - TAIL * length
    plateau, start = float(smooth[tail].mean()), float(smooth[0])
    threshold = NEAR * plateau if plateau > 0 else start + NEAR * (plateau - start)
    risen = plateau > start
    at = np.flatnonzero(smooth >= threshold - 1e-12)
    earlier = (steps >= end - 2 * TAIL * length) & ~tail
    gain = plateau - float(smooth[earlier].mean()) if earlier.any() else 0.0
    rising = risen and gain > STILL_RISING * (plateau - start)
    return Reached(plateau, threshold, int(steps[at[0]]) if risen and len(at) else None, rising)


def groups(runs: Sequence[Path], window: int) -> list[Group]:
    """The runs in groups of the same recipe but for the seed, in the order of each one's first run.

    Runs without an update are left out.
    """
    recipes = {run: yaml.safe_load((run / "recipe.yaml").read_text()) for run in runs}
    found: dict[str, list[Curve]] = {}
    names: dict[str, str] = {}
    for run, recipe in recipes.items():
        curve = read_curve(run, int(recipe.get("seed", 0)), window)
        if curve is not None:
            key = json.dumps({name: block for name, block in recipe.items() if name != "seed"}, sort_keys=True)
            found.setdefault(key, []).append(curve)
            names[key] = str(recipe.get("name", run.name))
    labels = list(names.values())
    return [
        joined(names[key] if labels.count(names[key]) == 1 else f"{names[key]} ({curves[0].run.name})", curves)
        for key, curves in found.items()
    ]


def joined(label: str, curves: Sequence[Curve]) -> Group:
    """Curves as one line: between the last of their first steps and the first of their last ones."""
    low, high = max(c.steps[0] for c in curves), min(c.steps[-1] for c in curves)
    grid = np.unique(np.concatenate([c.steps for c in curves]))
    grid = grid[(grid >= low) & (grid <= high)]
    if not len(grid):
        # They have no steps in common.
        longest = max(curves, key=lambda c: float(c.steps[-1]))
        return Group(label, tuple(curves), longest.steps, *[longest.smooth] * 3)
    table = np.stack([np.interp(grid, c.steps, c.smooth) for c in curves])
    return Group(label, tuple(curves), grid, table.mean(axis=0), table.min(axis=0), table.max(axis=0))


def sentences(group: Group) -> list[str]:
    """What there is to say of a group and of its runs."""
    whole = reached(group.steps, group.mean)
    count = len(group.curves)
    lines = [f"{group.label}: {_said(whole)}" + (f" (mean of {count} runs)" if count > 1 else "")]
    if count > 1:
        lines += [f"  seed {c.seed}: {_said(reached(c.steps, c.smooth))} ({c.run})" for c in group.curves]
    before = group.curves[0].before
    if before:
        lines.append(f"  the curve begins at step {group.curves[0].steps[0]:,.0f}, after {', '.join(before)}")
    return lines


def _said(found: Reached) -> str:
    if found.step is None:
        return f"does not rise: it ends at {found.plateau:.3g} per step"
    text = f"90 % of its plateau ({found.plateau:.3g} per step) first at step {found.step:,}"
    return text + ("; still rising at the end" if found.rising else "")


def document(found: Sequence[Group], window: int) -> dict[str, Any]:
    """Every curve and figure as plain values."""
    return {
        "window": window,
        "groups": [
            {
                "label": group.label,
                **_figures(group.steps, group.mean),
                "steps": group.steps.tolist(),
                "mean": group.mean.tolist(),
                "low": group.low.tolist(),
                "high": group.high.tolist(),
                "runs": [
                    {"run": str(c.run), "seed": c.seed, "before": list(c.before), **_figures(c.steps, c.smooth)}
                    for c in group.curves
                ],
            }
            for group in found
        ],
    }


def _figures(steps: Floats, smooth: Floats) -> dict[str, Any]:
    found = reached(steps, smooth)
    plateau = found.plateau if math.isfinite(found.plateau) else None
    return {
        "plateau": plateau,
        "threshold": found.threshold,
        "reaches_90_percent_at": found.step,
        "still_rising": found.rising,
    }

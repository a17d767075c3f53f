"""Convergence: reward per step and the score of periodic evaluations against environment steps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from me3bev_cli.errors import UserError
from me3bev_cli.recipe_diff import run_recipe
from me3bev_cli.reporting.bars import Picture
from me3bev_cli.reporting.chart import Chart, colour
from me3bev_cli.training.best import SCORE
from me3bev_cli.training.convergence import Group, document, groups, reached, sentences
from me3bev_cli.training.curve import WINDOW, read_metrics

POINTS = 400
"""Of a line at most."""


@dataclass
class Curves:
    """What there is to say of the trainings."""

    pictures: list[Picture] = field(default_factory=list)
    legend: list[tuple[str, int]] = field(default_factory=list)
    """Name and number of each line."""
    sentences: list[str] = field(default_factory=list)
    left_out: list[str] = field(default_factory=list)
    data: dict[str, Any] = field(default_factory=dict)


def curves(runs: Sequence[Path]) -> Curves:
    """The curves of runs; those that differ in the seed only are one line."""
    readable, found = [], Curves()
    for run in runs:
        try:
            run_recipe(run)
            groups([run], WINDOW)
            readable.append(run)
        except (UserError, OSError, ValueError, KeyError, TypeError, AttributeError) as error:
            found.left_out.append(f"{run}: its log cannot be read ({type(error).__name__})")
    drawn = groups(readable, WINDOW)
    told = [curve.run for group in drawn for curve in group.curves]
    found.left_out += [f"{run}: no update has a reward" for run in readable if run not in told]
    if not drawn:
        return found
    found.legend = [(_name(group), number) for number, group in enumerate(drawn)]
    found.sentences = [line.strip() for group in drawn for line in sentences(group)]
    found.data = document(drawn, WINDOW)
    several = any(len(group.curves) > 1 for group in drawn)
    spread = "; shaded: least to greatest run" if several else "; thin: each update"
    caption = f"Reward per step, mean of {WINDOW} updates{spread}; dots: 90 % of the plateau"
    found.pictures.append(Picture(caption, _rewards(drawn)))
    scores = _scores(drawn)
    if scores:
        found.pictures.append(Picture("Driving score of the evaluations during training", _score_chart(scores)))
    return found


def _name(group: Group) -> str:
    count = len(group.curves)
    if count > 1:
        return f"{group.label}, {count} seeds"
    run = group.curves[0].run.name
    return group.label if run in group.label else f"{group.label} ({run})"


def _rewards(drawn: Sequence[Group]) -> Any:
    last = max(float(curve.steps[-1]) for group in drawn for curve in group.curves)
    values = [float(v) for group in drawn for curve in group.curves for v in (curve.reward.min(), curve.reward.max())]
    low, high = min(0.0, *values), max(values)
    chart = Chart((0.0, last or 1.0), (low, high if high > low else low + 1.0), "Reward per step against steps")
    chart.axes("environment steps", "reward per step")
    for number, group in enumerate(drawn):
        kind = colour(number)
        for curve in group.curves:
            fine = curve.smooth if len(group.curves) > 1 else curve.reward
            chart.line(_thinned(curve.steps.tolist(), fine.tolist()), f"line thin {kind}")
        if len(group.curves) > 1:
            chart.band(group.steps.tolist(), group.low.tolist(), group.high.tolist(), number)
        chart.line(_thinned(group.steps.tolist(), group.mean.tolist()), f"line {kind}")
        where = reached(group.steps, group.mean)
        if where.step is not None:
            at = int((group.steps >= where.step).argmax())
            said = f"{group.label}: 90 % of the plateau first at step {where.step:,}"
            chart.dot(where.step, float(group.mean[at]), number, said)
    return chart.svg()


def _thinned(steps: Sequence[float], values: Sequence[float]) -> list[tuple[float, float]]:
    """Every n-th point, and the last one."""
    stride = max(1, len(steps) // POINTS)
    points = list(zip(steps, values, strict=True))
    return [*points[:-1:stride], points[-1]]


def _scores(drawn: Sequence[Group]) -> list[tuple[int, list[tuple[float, float]]]]:
    """(number of the group, its points) of each run with evaluations during training."""
    found = []
    for number, group in enumerate(drawn):
        for curve in group.curves:
            rows = [row for row in read_metrics(curve.run) if row.get(SCORE) is not None]
            if rows:
                found.append((number, [(float(row["steps"]), float(row[SCORE])) for row in rows]))
    return found


def _score_chart(lines: Sequence[tuple[int, list[tuple[float, float]]]]) -> Any:
    last = max(point[0] for _, points in lines for point in points)
    chart = Chart((0.0, last or 1.0), (0.0, 100.0), "Driving score of periodic evaluations against steps")
    chart.axes("environment steps", "driving score")
    for number, points in lines:
        chart.line(points, f"line {colour(number)}")
        for steps, score in points:
            chart.dot(steps, score, number, f"step {steps:,.0f}: {score:.1f}")
    return chart.svg()

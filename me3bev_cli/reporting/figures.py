"""Figures as people read them: decimals by metric, intervals, a chart's scale."""

from __future__ import annotations

import math
from collections.abc import Iterable

from me3bev_cli.evaluation.definitions import METRICS, Metric
from me3bev_cli.evaluation.summary import Row

NOTHING = "–"
ARROWS = {"higher": "↑", "lower": "↓", "neither": ""}


def figure(value: float, metric: str) -> str:
    """A mean; what no episode says anything about is a dash."""
    return NOTHING if math.isnan(value) else f"{value:.{_digits(metric)}f}"


def interval(row: Row) -> str:
    """As `58.1 to 66.2`; nothing where there is none."""
    if math.isnan(row.low) or math.isnan(row.high):
        return ""
    return f"{figure(row.low, row.metric)} to {figure(row.high, row.metric)}"


def whole(row: Row) -> str:
    """The mean and its interval in words."""
    ends = interval(row)
    return figure(row.mean, row.metric) + (f" ({ends})" if ends else "")


def compact(row: Row) -> str:
    """The same in little room."""
    return whole(row).replace(" to ", "–")


def known(name: str) -> Metric | None:
    """What a metric means; None for one of another version of me3bev."""
    return METRICS.get(name)


def title(name: str) -> str:
    """A metric for people."""
    metric = known(name)
    return metric.label if metric else name.replace("_", " ")


def better(name: str) -> str:
    """Which direction is better, in words."""
    metric = known(name)
    words = {"higher": "higher is better", "lower": "lower is better"}
    return words.get(metric.direction, "") if metric else ""


def arrow(name: str) -> str:
    """The same as an arrow."""
    metric = known(name)
    return ARROWS[metric.direction] if metric else ""


def scale(name: str, rows: Iterable[Row]) -> tuple[float, float]:
    """A chart's axis: the whole of a share or a score, so that pictures can be compared; else from 0."""
    metric = known(name)
    unit = metric.unit if metric else ""
    if unit.startswith("share"):
        return 0.0, 1.0
    if unit == "0-100":
        return 0.0, 100.0
    ends = [v for row in rows for v in (row.mean, row.low, row.high) if not math.isnan(v)] or [1.0]
    low, high = min(0.0, *ends), max(ends)
    return low, high + 0.05 * (high - low) if high > low else low + 1.0


def _digits(name: str) -> int:
    metric = known(name)
    return metric.digits if metric else 2

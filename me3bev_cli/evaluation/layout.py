"""What Markdown and LaTeX tables share: the paper's layout of metrics x methods x maps, and which figures are best."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

from me3bev_cli.evaluation.definitions import METRICS
from me3bev_cli.evaluation.results import Results
from me3bev_cli.evaluation.summary import AVERAGE, Row


@dataclass(frozen=True)
class Cell:
    """One figure in a table."""

    text: str
    """`-` where there is none."""
    best: bool = False
    """Of its column, among those that were measured here, in the direction of the metric; ties are all best."""
    verdict: str = ""
    """Beside the baseline's: better, worse, other or nothing."""


@dataclass(frozen=True)
class Layout:
    """Columns are (density, map); each metric has a line per method."""

    columns: tuple[tuple[str, str], ...]
    methods: tuple[str, ...]
    published: frozenset[str]
    """Those of the methods whose figures are the paper's."""
    metrics: tuple[str, ...]
    cells: dict[tuple[str, str], tuple[Cell, ...]]
    """(metric, method) -> a cell per column."""

    @property
    def densities(self) -> dict[str, int]:
        """Each density with its number of columns."""
        return dict(Counter(density for density, _ in self.columns))


def lay_out(results: Results, metrics: Sequence[str], density: str | None = None) -> Layout:
    """The table of some metrics, over all densities or one of them."""
    rows = [r for r in results.shown if r.metric in metrics and density in (None, r.density)]
    columns = tuple(dict.fromkeys((r.density, r.map) for r in rows))
    methods = tuple(dict.fromkeys(r.method for r in rows))
    published = frozenset(r.method for r in results.published)
    found = {(r.metric, r.method, r.density, r.map): r for r in rows}
    verdicts = results.verdicts
    cells = {}
    for metric in metrics:
        lines = {method: [found.get((metric, method, *column)) for column in columns] for method in methods}
        best = [_best([lines[m][i] for m in methods if m not in published], metric) for i in range(len(columns))]
        for method, line in lines.items():
            cells[metric, method] = tuple(
                Cell(
                    shown(row),
                    method not in published and row is not None and row.mean == best[i],
                    verdicts.get((row.method, row.map, row.density, row.metric), "") if row is not None else "",
                )
                for i, row in enumerate(line)
            )
    return Layout(columns, methods, published, tuple(metrics), cells)


def _best(rows: Sequence[Row | None], metric: str) -> float:
    """The best figure of at least two; NaN, which equals nothing, where there is none."""
    values = [row.mean for row in rows if row is not None and not math.isnan(row.mean)]
    direction = METRICS[metric].direction
    if len(values) < 2 or direction == "neither":
        return math.nan
    return max(values) if direction == "higher" else min(values)


def shown(row: Row | None) -> str:
    """A figure as people read it."""
    if row is None or math.isnan(row.mean):
        return "-"
    return f"{row.mean:.{METRICS[row.metric].digits}f}"


def heading(map: str) -> str:
    """A column's title."""
    return "Avg." if map == AVERAGE else map

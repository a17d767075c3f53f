"""Rows for people: a table of metrics x maps that fits a terminal, and CSV."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING

from me3bev_cli.evaluation.metrics import METRICS, PAPER, Metric
from me3bev_cli.evaluation.summary import AVERAGE, Row

if TYPE_CHECKING:
    from rich.table import Table

ARROWS = {"higher": "↑", "lower": "↓", "neither": " "}
WITH_INTERVALS = 3
"""Up to this many columns every figure is shown with its interval; beyond, only the average is."""


def tables(rows: Sequence[Row]) -> list[Table]:
    """One table per method and density."""
    keys = dict.fromkeys((row.method, row.density) for row in rows)
    return [_table(*key, [row for row in rows if (row.method, row.density) == key]) for key in keys]


def _table(method: str, density: str, rows: Sequence[Row]) -> Table:
    from rich.markup import escape
    from rich.table import Table

    maps = list(dict.fromkeys(row.map for row in rows))
    found = {(row.map, row.metric): row for row in rows}
    counts = {row.n for row in rows if row.metric == PAPER[0] and row.map != AVERAGE}
    many = f"{min(counts)}" if len(counts) == 1 else f"{min(counts)}-{max(counts)}"
    each = " each" if len(maps) > 1 else ""
    table = Table(
        title=escape(f"{method}, {density} density, episodes: {many}{each}"), title_justify="left", title_style="bold"
    )
    table.add_column("metric", no_wrap=True)
    table.add_column("")
    for map in maps:
        table.add_column(escape(map), justify="right", no_wrap=True, style="bold" if map == AVERAGE else None)
    for name, metric in METRICS.items():
        cells = [_cell(found[map, name], metric, len(maps) <= WITH_INTERVALS or map == AVERAGE) for map in maps]
        table.add_row(metric.label, ARROWS[metric.direction], *cells, end_section=name == PAPER[-1])
    return table


def _cell(row: Row, metric: Metric, with_interval: bool) -> str:
    if math.isnan(row.mean):
        return "-"
    text = f"{row.mean:.{metric.digits}f}"
    if with_interval and not math.isnan(row.low):
        text += f" ({row.low:.{metric.digits}f}..{row.high:.{metric.digits}f})"
    return text


FIELDS = ("method", "map", "density", "metric", "mean", "low", "high", "n")


def csv_text(rows: Sequence[Row]) -> str:
    """The rows as CSV; what is unknown is left empty."""
    buffer = io.StringIO()
    writer = csv.DictWriter(buffer, FIELDS, lineterminator="\n")
    writer.writeheader()
    for row in rows:
        values = asdict(row)
        writer.writerow({k: "" if isinstance(v, float) and math.isnan(v) else v for k, v in values.items()})
    return buffer.getvalue()

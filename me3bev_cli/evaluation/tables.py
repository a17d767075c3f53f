"""Rows for people: tables that fit a terminal, and CSV."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING

from me3bev_cli.evaluation.definitions import METRICS, PAPER, Metric
from me3bev_cli.evaluation.summary import AVERAGE, Row, WeatherRow

if TYPE_CHECKING:
    from rich.table import Table

    from me3bev_cli.evaluation.results import Results

ARROWS = {"higher": "↑", "lower": "↓", "neither": " "}
WITH_INTERVALS = 3
"""Up to this many columns every figure is shown with its interval; beyond, only the average is."""


def tables(rows: Sequence[Row]) -> list[tuple[str, Table]]:
    """A headline and a table per method and density."""
    groups: dict[tuple[str, str], list[Row]] = {}
    for row in rows:
        groups.setdefault((row.method, row.density), []).append(row)
    return [(_headline(*key, group), _map_table(group)) for key, group in groups.items()]


MARKS = {"better": " ▲", "worse": " ▼", "other": " *", "": ""}
"""Beside the baseline."""


def side_by_side(results: Results) -> list[tuple[str, Table]]:
    """A headline and a table of metrics x methods per density: over the only map, or the average over the maps.

    The published figures, if there are any, have tables of their own.
    """
    many = len({row.map for row in results.rows}) > 1
    place = "average over the maps" if many else results.rows[0].map
    against = f"; ▲ better, ▼ worse than {results.comparisons[0].baseline}" if results.comparisons else ""
    own = [(f"{place}, {d} density{against}", t) for d, t in _by_method(results.rows, many, results.verdicts)]
    published = [(f"published, CARLA: {place}, {d} density", t) for d, t in _by_method(results.published, many, {})]
    return own + published


def _by_method(
    rows: Sequence[Row], many: bool, verdicts: Mapping[tuple[str, str, str, str], str]
) -> list[tuple[str, Table]]:
    """(density, its table)."""
    groups: dict[str, dict[str, dict[str, Row]]] = {}
    for row in rows:
        if row.map == AVERAGE or not many:
            groups.setdefault(row.density, {}).setdefault(row.method, {})[row.metric] = row
    found = []
    for density, columns in groups.items():
        marks = {
            (method, name): MARKS[verdicts.get((method, row.map, density, name), "")]
            for method, column in columns.items()
            for name, row in column.items()
        }
        found.append((density, _table(columns, columns if len(columns) <= WITH_INTERVALS else (), marks)))
    return found


def weather_tables(rows: Sequence[WeatherRow]) -> list[tuple[str, Table]]:
    """A headline and a table of metrics x kinds of weather per method and density, each over all of its maps."""
    groups: dict[tuple[str, str], dict[str, dict[str, Row]]] = {}
    for row in rows:
        # The average follows the maps that it is made of, so the last row of a metric is the one over all maps.
        groups.setdefault((row.method, row.density), {}).setdefault(row.weather, {})[row.metric] = row
    found = []
    for (method, density), columns in groups.items():
        titled = {f"{weather}\n({column[PAPER[0]].n})": column for weather, column in columns.items()}
        headline = f"{method}, {density} density, by weather (episodes)"
        found.append((headline, _table(titled, titled if len(titled) <= WITH_INTERVALS else ())))
    return found


def _headline(method: str, density: str, rows: Sequence[Row]) -> str:
    counts = {row.n for row in rows if row.metric == PAPER[0] and row.map != AVERAGE}
    many = f"{min(counts)}" if len(counts) == 1 else f"{min(counts)} to {max(counts)}"
    each = " per map" if any(row.map == AVERAGE for row in rows) else ""
    return f"{method}, {density} density, {many} episode{'s' if max(counts) > 1 else ''}{each}"


def _map_table(rows: Sequence[Row]) -> Table:
    columns: dict[str, dict[str, Row]] = {}
    for row in rows:
        columns.setdefault(row.map, {})[row.metric] = row
    return _table(columns, columns if len(columns) <= WITH_INTERVALS else (AVERAGE,))


def _table(
    columns: Mapping[str, Mapping[str, Row]],
    with_intervals: Collection[str],
    marks: Mapping[tuple[str, str], str] | None = None,
) -> Table:
    """Metrics x columns; each column's rows by metric. Marks are put behind the figures of (column, metric)."""
    from rich import box
    from rich.markup import escape
    from rich.table import Table

    # No lines between columns: seven maps and the average fit 100 columns.
    table = Table(box=box.SIMPLE, padding=(0, 1, 0, 0), show_edge=False)
    table.add_column("metric", no_wrap=True)
    for title in columns:
        table.add_column(escape(title), justify="right", no_wrap=True, style="bold" if title == AVERAGE else None)
    for name, metric in METRICS.items():
        line = {title: column.get(name) for title, column in columns.items()}
        if all(row is None for row in line.values()):
            continue
        decimals = _decimals([row for row in line.values() if row is not None], metric)
        cells = [
            _cell(row, decimals, title in with_intervals) + (marks or {}).get((title, name), "")
            for title, row in line.items()
        ]
        table.add_row(f"{metric.label} {ARROWS[metric.direction]}", *cells, end_section=name == PAPER[-1])
    return table


def _decimals(line: Iterable[Row], metric: Metric) -> int:
    """Three figures of the line's largest are enough for people; files have them all."""
    largest = max((abs(row.mean) for row in line if not math.isnan(row.mean)), default=0.0)
    return max(0, min(metric.digits, 3 - len(f"{largest:.0f}")))


def _cell(row: Row | None, decimals: int, with_interval: bool) -> str:
    if row is None or math.isnan(row.mean):
        return "-"
    text = f"{row.mean:.{decimals}f}"
    if with_interval and not math.isnan(row.low):
        text += f" ({row.low:.{decimals}f}..{row.high:.{decimals}f})"
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

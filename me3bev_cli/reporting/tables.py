"""The report's tables: what each cell says, and the number that it is sorted by."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

from me3bev_cli.evaluation.summary import Row
from me3bev_cli.reporting.figures import NOTHING, arrow, better, figure, interval, title
from me3bev_cli.reporting.suites import Suite

HEAD = (
    "driving_score", "success", "route_completion", "relative_progress", "collision_rate", "timesteps", "similarity",
    "waypoint_distance", "paper_score",
)  # fmt: skip
SAFETY = (
    "collision_rate", "at_fault_collision_rate", "at_fault_share", "vehicle_collision_rate",
    "pedestrian_collision_rate", "static_collision_rate", "red_lights", "red_light_violation_rate", "stop_signs",
    "lane_departures", "off_road",
)  # fmt: skip
DRIVE = (
    "efficiency", "comfort", "mean_speed", "return_per_step", "efficiency_bench2drive", "comfort_bench2drive",
)  # fmt: skip
MARKS = {"better": ("▲", "better than"), "worse": ("▼", "worse than"), "other": ("*", "differs from")}


@dataclass(frozen=True)
class Cell:
    """One cell. `value` is None where there is nothing to sort by; such rows stay at the end."""

    text: str
    value: float | str | None = None
    note: str = ""
    """In small letters below."""
    mark: str = ""
    mark_words: str = ""
    """What the mark means."""
    series: int | None = None
    """Which colour stands beside it."""


@dataclass(frozen=True)
class Column:
    """A column's heading."""

    text: str
    hint: str = ""
    numeric: bool = True


@dataclass(frozen=True)
class Table:
    """A table that can be sorted."""

    caption: str
    columns: Sequence[Column]
    lines: Sequence[Sequence[Cell]]
    quiet: Sequence[bool] = field(default=())
    """Lines to be shown paler: drivers to compare with."""


def method_table(suite: Suite, metrics: Sequence[str], caption: str) -> Table:
    """A line per method and density, a column per metric that any of them has."""
    there = {row.metric for row in suite.rows if not math.isnan(row.mean)}
    shown = [name for name in metrics if name in there]
    dense = len(suite.densities) > 1
    columns = [Column("method", numeric=False), *([Column("density", numeric=False)] if dense else [])]
    columns += [_column(name) for name in shown]
    lines, quiet = [], []
    for density in suite.densities:
        for number, method in enumerate(suite.methods):
            rows = [suite.row(method.label, density, name) for name in shown]
            if all(row is None for row in rows):
                continue
            line = [Cell(method.label, method.label, series=number)]
            line += [Cell(density, density)] if dense else []
            line += [
                _cell(row, suite.verdict(method.label, density, m), suite.baseline)
                for m, row in zip(shown, rows, strict=True)
            ]
            lines.append(line)
            quiet.append(not method.is_policy)
    return Table(caption, columns, lines, quiet)


def map_table(suite: Suite, density: str, metrics: Sequence[str]) -> Table:
    """The figures behind the bars: a line per map and method."""
    places = [*suite.maps, *([suite.whole] if suite.whole not in suite.maps else [])]
    columns = [Column("map", numeric=False), Column("method", numeric=False), *(_column(name) for name in metrics)]
    lines = []
    for place in places:
        for number, method in enumerate(suite.methods):
            cells = [
                _cell(
                    suite.row(method.label, density, name, place),
                    suite.verdict(method.label, density, name, place),
                    suite.baseline,
                )
                for name in metrics
            ]
            lines.append([Cell(place, place), Cell(method.label, method.label, series=number), *cells])
    return Table(f"Figures of each map, {density} density", columns, lines)


def published_table(suite: Suite) -> Table | None:
    """The paper's own figures, without intervals, which nobody has published."""
    if not suite.published:
        return None
    shown = list(dict.fromkeys(row.metric for row in suite.published))
    found = {(row.method, row.density, row.map, row.metric): row for row in suite.published}
    cells = dict.fromkeys((row.method, row.density, row.map) for row in suite.published)
    lines = [
        [*(Cell(word, word) for word in cell), *(_cell(found.get((*cell, name))) for name in shown)] for cell in cells
    ]
    columns = [*(Column(word, numeric=False) for word in ("method", "density", "map")), *map(_column, shown)]
    return Table("Published results in CARLA", columns, lines)


def _column(name: str) -> Column:
    return Column(f"{title(name)} {arrow(name)}".strip(), better(name))


def _cell(row: Row | None, verdict: str = "", baseline: str = "") -> Cell:
    if row is None or math.isnan(row.mean):
        return Cell(NOTHING)
    mark, words = MARKS.get(verdict, ("", ""))
    return Cell(
        figure(row.mean, row.metric), row.mean, interval(row), mark, f"{words} {baseline}" if words else ""
    )  # fmt: skip

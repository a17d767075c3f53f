"""One picture of an evaluation: bars of the main metrics with their intervals, and what the driver saw."""

from __future__ import annotations

import io
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from me3bev_cli.evaluation.definitions import METRICS, PAPER
from me3bev_cli.evaluation.summary import Row
from me3bev_cli.pictures import CAMERA_COLUMNS, colour_map, tile

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from me3bev_cli.evaluation.snapshot import Snapshot

SHOWN = (*PAPER, "route_completion")
COLOURS = ("#2f6fb5", "#d9822b", "#4c9a5b", "#8c5fa8")
"""Of the bars, a colour per method and density."""


def picture_bytes(rows: Sequence[Row], title: str, snapshot: Snapshot | None) -> bytes:
    """The picture as PNG."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(13, 8.6 if snapshot else 5.4), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    figure.suptitle(title, x=0.01, ha="left", fontsize=12, fontweight="bold")
    if snapshot is None:
        _bars(figure, rows)
    else:
        halves: Any = figure.subfigures(2, 1, height_ratios=(3.2, 5.2))
        upper, lower = halves
        _scene(upper, snapshot)
        _bars(lower, rows)
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png")
    return buffer.getvalue()


def _scene(figure: Any, snapshot: Snapshot) -> None:
    sheet = tile(snapshot.images)
    plan = colour_map(snapshot.bev)
    height = sheet.shape[0]
    left, right = figure.subplots(1, 2, width_ratios=(sheet.shape[1] / height, 1.0))
    left.imshow(sheet, aspect="auto" if sheet.shape[1] < 2 * height else "equal")
    where = f"{snapshot.method}, {snapshot.map}, {snapshot.density}, {snapshot.weather}, step {snapshot.step}"
    left.set_title(f"{where}: {_names(snapshot)}", fontsize=9)
    right.imshow(plan)
    middle = (len(plan) - 1) / 2
    right.plot(middle, middle, marker="^", color="white", markersize=6)
    right.set_title("bird's-eye view", fontsize=9)
    for axes in (left, right):
        axes.set_axis_off()


def _names(snapshot: Snapshot) -> str:
    names = [name.replace("_", " ") for name in snapshot.cameras]
    rows = [names[i : i + CAMERA_COLUMNS] for i in range(0, len(names), CAMERA_COLUMNS)]
    return " / ".join(", ".join(row) for row in rows)


def _bars(figure: Any, rows: Sequence[Row]) -> None:
    series = list(dict.fromkeys((row.method, row.density) for row in rows))
    maps = list(dict.fromkeys(row.map for row in rows))
    for axes, name in zip(figure.subplots(2, 4).flat, SHOWN, strict=True):
        found = {(row.method, row.density, row.map): row for row in rows if row.metric == name}
        for i, key in enumerate(series):
            _series(axes, [found.get((*key, map)) for map in maps], i, len(series))
        metric = METRICS[name]
        better = {"higher": " (higher is better)", "lower": " (lower is better)"}.get(metric.direction, "")
        axes.set_title(f"{metric.label}{better}", fontsize=9)
        axes.set_xticks(range(len(maps)), maps, fontsize=8, rotation=30 if max(map(len, maps)) > 4 else 0)
        axes.tick_params(axis="y", labelsize=8)
        axes.set_ylabel(metric.unit, fontsize=8)
        _limit(axes, metric.unit)
        axes.spines[["top", "right"]].set_visible(False)
    if len(series) > 1:
        handles = [_swatch(COLOURS[i % len(COLOURS)]) for i in range(len(series))]
        labels = [f"{method}, {density}" for method, density in series]
        figure.legend(handles, labels, loc="outside lower center", ncols=len(series), fontsize=8)


def _limit(axes: Axes, unit: str) -> None:
    """A whole scale where there is one, so that pictures can be compared; else from 0."""
    if unit.startswith("share") or unit == "0-100":
        axes.set_ylim(0, 105 if unit == "0-100" else 1.05)
    elif axes.get_ylim()[0] >= 0:
        axes.set_ylim(bottom=0)


def _swatch(colour: str) -> Any:
    from matplotlib.patches import Patch

    return Patch(color=colour)


def _series(axes: Axes, rows: Sequence[Row | None], index: int, count: int) -> None:
    width = 0.8 / count
    for place, row in enumerate(rows):
        if row is None or math.isnan(row.mean):
            continue
        x = place - 0.4 + width * (index + 0.5)
        axes.bar(x, row.mean, width * 0.9, color=COLOURS[index % len(COLOURS)])
        if not math.isnan(row.low):
            # A bootstrap interval nearly always holds the mean; error bars cannot be negative.
            ends = [[max(0.0, row.mean - row.low)], [max(0.0, row.high - row.mean)]]
            axes.errorbar(x, row.mean, yerr=ends, color="#222222", capsize=2, linewidth=1)

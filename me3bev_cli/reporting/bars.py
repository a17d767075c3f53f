"""Bars of each map: a chart per metric and density, a group of bars per map, a bar per method."""

from __future__ import annotations

import math
from dataclasses import dataclass

from markupsafe import Markup

from me3bev_cli.evaluation.summary import AVERAGE
from me3bev_cli.reporting.chart import UNTITLED, Chart
from me3bev_cli.reporting.figures import better, scale, title, whole
from me3bev_cli.reporting.suites import Suite

SHOWN = (
    "driving_score", "success", "route_completion", "collision_rate", "efficiency", "comfort", "similarity",
    "waypoint_distance", "timesteps",
)  # fmt: skip
"""The paper's seven, and beside them what its score leaves out."""
CROWDED = 40
"""With more bars than this a chart is drawn larger, and without those who need no picture."""
PLAIN = ("idle", "random", "untrained")
FILLED = 0.84
"""Share of a group's room that its bars take."""


@dataclass(frozen=True)
class Picture:
    """A chart with its caption."""

    caption: str
    svg: Markup


def crowded(suite: Suite) -> bool:
    """Whether there are many bars."""
    return len(suite.methods) * len(suite.maps) > CROWDED


def drawn(suite: Suite) -> list[tuple[str, int]]:
    """Label and number of the methods that have bars."""
    numbered = [(method, number) for number, method in enumerate(suite.methods)]
    some = [(m.label, n) for m, n in numbered if not (crowded(suite) and m.about.get("driver") in PLAIN)]
    return some or [(method.label, number) for method, number in numbered]


def bar_charts(suite: Suite, density: str) -> list[Picture]:
    """The charts of a suite's density; metrics that no method has are left out."""
    found = []
    for metric in SHOWN:
        if any(row.metric == metric and row.density == density and not math.isnan(row.mean) for row in suite.rows):
            words = better(metric)
            found.append(Picture(f"{title(metric)}{f' ({words})' if words else ''}", _chart(suite, density, metric)))
    return found


def _chart(suite: Suite, density: str, metric: str) -> Markup:
    places = [*suite.maps, *([AVERAGE] if suite.whole == AVERAGE else [])]
    rows = [row for row in suite.rows if row.metric == metric and row.density == density]
    label = f"{title(metric)} by map and method, {density} density"
    chart = Chart((0.0, float(len(places))), scale(metric, rows), label, UNTITLED)
    chart.axes(x_ticks=False)
    methods = drawn(suite)
    width = FILLED / len(methods)
    for group, place in enumerate(places):
        chart.name(group + 0.5, "mean" if place == AVERAGE else _short(place, len(places)))
        for order, (name, number) in enumerate(methods):
            row = suite.row(name, density, metric, place)
            if row is None or math.isnan(row.mean):
                continue
            left = group + (1 - FILLED) / 2 + order * width
            chart.bar(left, left + 0.92 * width, row.mean, number, f"{name}, {place}: {whole(row)}")
            if not math.isnan(row.low):
                chart.whisker(left + 0.46 * width, row.low, row.high, caps=not crowded(suite))
    return chart.svg()


def _short(name: str, groups: int) -> str:
    """A map's name, cut where groups are narrow."""
    room = max(3, 48 // groups)
    return name if len(name) <= room else f"{name[: room - 1]}…"

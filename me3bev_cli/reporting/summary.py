"""What stands at the top of the page: each policy's main figures, and what they should be seen beside."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from me3bev_cli.reporting.figures import compact, figure, interval, title
from me3bev_cli.reporting.suites import Method, Suite

BESIDE = ("success", "route_completion", "collision_rate", "comfort")
MAIN = "driving_score"
CARDS = 6
"""The table has the others."""


@dataclass(frozen=True)
class Card:
    """One method in one density."""

    name: str
    place: str
    score: str
    ends: str
    """The score's interval."""
    facts: Sequence[tuple[str, str]]
    series: int


def cards(suite: Suite) -> list[Card]:
    """The policies, or every driver where there is none."""
    found = []
    for number, method in enumerate(suite.methods):
        for density in suite.densities:
            row = suite.row(method.label, density, MAIN)
            if method in leading(suite) and row is not None and not math.isnan(row.mean):
                rows = [suite.row(method.label, density, name) for name in BESIDE]
                facts = [(title(r.metric), compact(r)) for r in rows if r is not None and not math.isnan(r.mean)]
                ends = interval(row)
                found.append(Card(method.label, f"{density} density", figure(row.mean, MAIN), ends, facts, number))
    return found[:CARDS]


def leading(suite: Suite) -> list[Method]:
    """The methods that a report is about."""
    return [method for method in suite.methods if method.is_policy] or suite.methods


def beside(suite: Suite) -> list[str]:
    """A sentence for each density: the drivers to compare with, then what differs from the baseline for certain."""
    found = []
    for density in suite.densities:
        rows = [(m.label, suite.row(m.label, density, MAIN)) for m in suite.methods if m not in leading(suite)]
        words = [f"{label} {figure(row.mean, MAIN)}" for label, row in rows if row is not None]
        if words:
            found.append(f"Driving score of drivers to compare with, {density} density: {', '.join(words)}.")
    for one in suite.comparisons:
        wanted = one["metric"] == MAIN and one["map"] == suite.whole
        if wanted and one.get("verdict") in ("better", "worse") and one["method"] in {m.label for m in leading(suite)}:
            ends = f"{one['difference']:+.1f} ({one['low']:+.1f} to {one['high']:+.1f})"
            found.append(
                f"{one['method']} is {one['verdict']} than {one['baseline']} on the same seeds, {one['density']} "
                f"density: driving score {ends}."
            )
    return found

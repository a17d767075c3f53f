"""What stands at the top of the page: each policy's main figures, and what they should be seen beside."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from me3bev_cli.reporting.figures import NOTHING, compact, figure, interval, title
from me3bev_cli.reporting.suites import Method, Suite

BESIDE = ("success", "route_completion", "collision_rate", "comfort")
MAIN = "driving_score"
CARDS = 8
"""The table has the others."""


@dataclass(frozen=True)
class Card:
    """One method."""

    name: str
    scores: Sequence[tuple[str, str, str]]
    """Density, driving score, its interval."""
    facts: Sequence[tuple[str, str]]
    """Figures beside it, of each density in turn."""
    series: int


def cards(suite: Suite) -> list[Card]:
    """The policies, or every driver where there is none; the best `CARDS` of them."""
    found: list[tuple[float, Card]] = []
    for number, method in enumerate(suite.methods):
        rows = [suite.row(method.label, density, MAIN) for density in suite.densities]
        there = [row for row in rows if row is not None and not math.isnan(row.mean)]
        if method in leading(suite) and there:
            scores = [(f"{row.density} density", figure(row.mean, MAIN), interval(row)) for row in there]
            facts = [(title(name), _fact(suite, method.label, name)) for name in BESIDE]
            card = Card(method.label, scores, [fact for fact in facts if fact[1]], number)
            found.append((there[0].mean, card))
    kept = sorted(found, key=lambda pair: -pair[0])[:CARDS]
    return [card for _, card in found if card in [one for _, one in kept]]


def _fact(suite: Suite, method: str, name: str) -> str:
    """A figure of each density; of a single one with its interval."""
    rows = [row for row in (suite.row(method, density, name) for density in suite.densities) if row is not None]
    if not rows or all(math.isnan(row.mean) for row in rows):
        return ""
    return compact(rows[0]) if len(suite.densities) == 1 else " · ".join(figure(row.mean, name) for row in rows)


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
    named = {method.label for method in leading(suite)}
    for one in sorted(suite.comparisons, key=lambda one: suite.densities.index(one["density"])):
        if one["metric"] == MAIN and one["map"] == suite.whole and one["method"] in named:
            found.append(_paired(one))
    return found


def _paired(one: Mapping[str, Any]) -> str:
    """How a policy stands beside the baseline on the same episodes."""
    verb = {"better": "is better than", "worse": "is worse than"}.get(one["verdict"], "cannot be told apart from")
    text = f"{one['method']} {verb} {one['baseline']} on the same seeds, {one['density']} density: driving score "
    text += f"{_signed(one['difference'])} ({_signed(one['low'])} to {_signed(one['high'])})"
    chance, low, high = (one.get(key) for key in ("improvement", "improvement_low", "improvement_high"))
    if chance is not None and low is not None and high is not None:
        text += f", better in an episode with probability {chance:.2f} ({low:.2f} to {high:.2f})"
    return f"{text}."


def _signed(value: float | None) -> str:
    return NOTHING if value is None or math.isnan(value) else f"{value:+.1f}"

"""Evaluations that can be compared: the same maps, densities, weather, number of episodes and seed are one suite."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

from me3bev_cli.evaluation.maps import shorten
from me3bev_cli.evaluation.summary import AVERAGE, Row
from me3bev_cli.reporting.sources import Evaluation

Key = tuple[tuple[str, ...], tuple[str, ...], tuple[str, ...], Any, Any]


@dataclass(frozen=True, eq=False)
class Method:
    """A row of the report's tables."""

    label: str
    """Which no other method of the suite has."""
    about: dict[str, Any]
    """What its evaluation says of it."""
    evaluation: Evaluation

    @property
    def is_policy(self) -> bool:
        """Whether a run's policy drives, rather than a driver to compare it with."""
        return self.about.get("driver") == "policy"

    @property
    def name(self) -> str:
        """What its own evaluation calls it."""
        return str(self.about["method"])


@dataclass(eq=False)
class Suite:
    """Everything that was measured on the same episodes."""

    maps: tuple[str, ...]
    densities: tuple[str, ...]
    weather: tuple[str, ...]
    episodes: int | None
    """Of each map and density; None for logs from elsewhere."""
    seed: int | None
    methods: list[Method] = field(default_factory=list)
    rows: list[Row] = field(default_factory=list)
    published: list[Row] = field(default_factory=list)
    comparisons: list[dict[str, Any]] = field(default_factory=list)
    evaluations: list[Evaluation] = field(default_factory=list)

    @property
    def places(self) -> str:
        """The maps in few words."""
        return shorten(self.maps).replace(",", ", ")

    @property
    def title(self) -> str:
        """Where the episodes are."""
        return f"{self.places}, {' and '.join(self.densities)} density"

    @property
    def about(self) -> str:
        """How many episodes there are, and what else they have in common."""
        words = []
        if self.episodes is not None:
            words.append(f"{self.episodes} episodes per map and density, seed {self.seed}")
        if self.weather:
            words.append(f"weather {shorten(self.weather).replace('_', ' ').replace(',', ', ')}")
        return "; ".join(words)

    @property
    def whole(self) -> str:
        """The place that stands for all: the average, or the only map."""
        return AVERAGE if any(row.map == AVERAGE for row in self.rows) else self.maps[0]

    @property
    def baseline(self) -> str:
        """The method that the others are compared with, or nothing."""
        return str(self.comparisons[0]["baseline"]) if self.comparisons else ""

    @property
    def size(self) -> int:
        """Episodes of a method in all."""
        return len(self.maps) * len(self.densities) * (self.episodes or 1)

    def row(self, method: str, density: str, metric: str, place: str | None = None) -> Row | None:
        """One figure, over all maps unless a place is named."""
        return self._index.get((method, density, metric, place or self.whole))

    @cached_property
    def _index(self) -> dict[tuple[str, str, str, str], Row]:
        return {(row.method, row.density, row.metric, row.map): row for row in self.rows}

    @cached_property
    def _verdicts(self) -> dict[tuple[str, str, str, str], str]:
        return {(c["method"], c["density"], c["metric"], c["map"]): c["verdict"] for c in self.comparisons}

    def verdict(self, method: str, density: str, metric: str, place: str | None = None) -> str:
        """How a figure stands beside the baseline's: better, worse, other, or nothing."""
        return self._verdicts.get((method, density, metric, place or self.whole), "")


def suites(evaluations: Sequence[Evaluation]) -> list[Suite]:
    """The evaluations by what they measured, the one with the most episodes first."""
    found: dict[Key, Suite] = {}
    for evaluation in evaluations:
        data = evaluation.document
        sets = (tuple(data["maps"]), tuple(data["densities"]), tuple(data.get("weather") or ()))
        key = (*sets, data.get("episodes"), data.get("seed"))
        _add(found.setdefault(key, Suite(*key)), evaluation)
    return sorted(found.values(), key=lambda suite: -suite.size)


def _add(suite: Suite, evaluation: Evaluation) -> None:
    """Join one more evaluation. A method that is there with the same figures is the same; another gets its own name."""
    suite.evaluations.append(evaluation)
    names: dict[str, str] = {}
    for about in evaluation.methods:
        name = str(about["method"])
        rows = [row for row in evaluation.rows if row.method == name]
        label, count = name, 1
        while label in {method.label for method in suite.methods}:
            if _same(rows, [row for row in suite.rows if row.method == label]):
                break
            count += 1
            label = f"{name} ({count})"
        else:
            suite.methods.append(Method(label, about, evaluation))
            suite.rows += [replace(row, method=label) for row in rows]
        names[name] = label
    known = {(row.method, row.map, row.density, row.metric) for row in suite.published}
    suite.published += [
        row for row in evaluation.published if (row.method, row.map, row.density, row.metric) not in known
    ]
    if not suite.comparisons:
        suite.comparisons = [
            {**one, "method": names[one["method"]], "baseline": names[one["baseline"]]}
            for one in evaluation.document.get("comparisons") or ()
            if one["method"] in names and one["baseline"] in names
        ]
    suite.methods.sort(key=lambda method: not method.is_policy)


def _same(rows: Sequence[Row], others: Sequence[Row]) -> bool:
    """Whether figures agree, but for those that depend on who else was there."""

    def figures(of: Sequence[Row]) -> set[tuple[str, str, str, str, int]]:
        return {
            (r.map, r.density, r.metric, f"{r.mean:.9g}", r.n) for r in of if r.metric != "relative_progress"
        }  # fmt: skip

    return figures(rows) == figures(others)

"""Two methods on the same episodes: the difference of each metric with its interval, and how often one is better."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from me3bev_cli.errors import UserError, unknown_name
from me3bev_cli.evaluation.definitions import METRICS
from me3bev_cli.evaluation.summary import Scored, estimates


@dataclass(frozen=True)
class Comparison:
    """One metric of a method beside the baseline's, on the episodes that both have driven and that say something."""

    method: str
    baseline: str
    map: str
    density: str
    metric: str
    difference: float
    """Mean over pairs of the method's figure less the baseline's."""
    low: float
    high: float
    """Ends of its 95 % interval."""
    improvement: float
    """Share of pairs in which the method is better, a tie counting half; NaN where neither direction is better."""
    improvement_low: float
    improvement_high: float
    n: int
    """Pairs."""
    significant: bool
    """Whether the interval of the difference leaves out 0."""

    @property
    def verdict(self) -> str:
        """`better`, `worse`, `other` where neither direction is better, or nothing."""
        direction = METRICS[self.metric].direction
        if not self.significant:
            return ""
        if direction == "neither":
            return "other"
        return "better" if (self.difference > 0) == (direction == "higher") else "worse"


def compare(scored: Sequence[Scored], baseline: str) -> list[Comparison]:
    """Every other method beside the baseline: each metric in each cell, and the average over the maps.

    Pairs are of one map, density and seed. Both intervals are percentiles of bootstrap means of pairs, resampled
    within each map; nothing is corrected for the number of comparisons.

    Raises:
        UserError: the baseline has no episode, or shares none with another method.
    """
    methods = list(dict.fromkeys(one.episode.driver for one in scored))
    if baseline not in methods:
        raise unknown_name("baseline", baseline, methods, where="--baseline")
    found = []
    for method in methods:
        if method != baseline:
            found.extend(_pairwise(scored, method, baseline))
    return found


def _pairwise(scored: Sequence[Scored], method: str, baseline: str) -> list[Comparison]:
    mine, theirs = ({_key(one): one for one in scored if one.episode.driver == who} for who in (method, baseline))
    shared = [key for key in mine if key in theirs]
    if not shared:
        raise UserError(
            f"'{method}' and '{baseline}' share no episode of the same map, density and seed", where="--baseline"
        )
    found = []
    for density in dict.fromkeys(key[1] for key in shared):
        for metric in METRICS:
            pairs: dict[str, list[tuple[float, float]]] = {}
            for key in shared:
                if key[1] == density:
                    pair = mine[key].values[metric], theirs[key].values[metric]
                    pairs.setdefault(key[0], []).append(pair)
            found.extend(_compare(method, baseline, density, metric, pairs))
    return found


def _key(one: Scored) -> tuple[str, str, int]:
    return one.episode.map, one.episode.density, one.episode.seed


def _compare(
    method: str, baseline: str, density: str, metric: str, pairs: dict[str, list[tuple[float, float]]]
) -> list[Comparison]:
    sign = {"higher": 1.0, "lower": -1.0, "neither": math.nan}[METRICS[metric].direction]
    differences = {map: np.array([a - b for a, b in values]) for map, values in pairs.items()}
    # 1 for a win, 0.5 for a tie; NaN stays NaN.
    wins = {map: (np.sign(sign * array) + 1.0) / 2.0 for map, array in differences.items()}
    return [
        Comparison(
            method, baseline, d.map, density, metric, d.mean, d.low, d.high, w.mean, w.low, w.high, d.n,
            significant=bool(d.low > 0 or d.high < 0),
        )
        for d, w in zip(estimates(differences, density), estimates(wins, density), strict=True)
    ]  # fmt: skip

"""From episodes to rows: mean, 95 % interval and count of every metric in every cell, and over the maps."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from me3bev_cli.evaluation.episode import Episode
from me3bev_cli.evaluation.metrics import METRICS, measure
from me3bev_cli.seeding import derive_seed

AVERAGE = "average"
"""Stands for all maps in a row."""
RESAMPLES = 1000
LEVEL = 0.95

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Row:
    """One figure."""

    method: str
    map: str
    """A map's name, or `average`: the mean of the maps' means."""
    density: str
    metric: str
    mean: float
    """NaN when no episode says anything about it."""
    low: float
    high: float
    """Ends of the 95 % interval; NaN for fewer than two episodes in a cell."""
    n: int
    """Episodes that the figure rests on."""


@dataclass(frozen=True)
class WeatherRow(Row):
    """One figure of the episodes that had one kind of weather."""

    weather: str


def by_weather(episodes: Sequence[Episode], weathers: Sequence[str]) -> list[WeatherRow]:
    """The rows of `summarise` for each kind of weather on its own, in the order given."""
    return [
        WeatherRow(**vars(row), weather=weather)
        for weather in weathers
        for row in summarise([episode for episode in episodes if episode.weather == weather])
    ]


def summarise(episodes: Sequence[Episode]) -> list[Row]:
    """Rows for every method, density, metric and map, and the average over the maps where there are several.

    Intervals are percentiles of `RESAMPLES` bootstrap means, resampled within each map; their seed comes from
    the cell's name, so the same episodes always give the same rows.
    """
    cells: dict[tuple[str, str], dict[str, list[dict[str, float]]]] = {}
    for episode in episodes:
        group = cells.setdefault((episode.driver, episode.density), {})
        group.setdefault(episode.map, []).append(measure(episode))
    rows = []
    for (method, density), maps in cells.items():
        for metric in METRICS:
            values = {map: np.array([found[metric] for found in list_]) for map, list_ in maps.items()}
            rows.extend(_rows(method, density, metric, values))
    return rows


def _rows(method: str, density: str, metric: str, values: Mapping[str, Floats]) -> list[Row]:
    known = {map: array[~np.isnan(array)] for map, array in values.items()}
    means = {map: resampled_means(array, derive_seed("bootstrap", map, density)) for map, array in known.items()}
    rows = [
        Row(method, map, density, metric, _mean(array), *interval(means[map]), len(array))
        for map, array in known.items()
    ]
    if len(known) > 1:
        there = [map for map, array in known.items() if len(array)]
        mean = _mean(np.array([_mean(known[map]) for map in there]))
        ends = interval(np.mean([means[map] for map in there], axis=0)) if there else (math.nan, math.nan)
        rows.append(Row(method, AVERAGE, density, metric, mean, *ends, sum(len(known[map]) for map in there)))
    return rows


def resampled_means(values: Floats, seed: int) -> Floats:
    """Means (`RESAMPLES`,) of samples drawn from `values` (n,) with replacement; NaN for fewer than two values."""
    if len(values) < 2:
        return np.full(RESAMPLES, math.nan)
    drawn = np.random.default_rng(seed).integers(len(values), size=(RESAMPLES, len(values)))
    return np.asarray(values[drawn].mean(axis=1))


def interval(means: Floats) -> tuple[float, float]:
    """The middle `LEVEL` of resampled means; NaN when they are."""
    if np.isnan(means).any():
        return math.nan, math.nan
    low, high = np.quantile(means, [(1 - LEVEL) / 2, (1 + LEVEL) / 2])
    return float(low), float(high)


def _mean(values: Floats) -> float:
    return float(values.mean()) if len(values) else math.nan

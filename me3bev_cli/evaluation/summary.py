"""From episodes to rows: mean, 95 % interval and count of every metric in every cell, and over the maps."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from me3bev_cli.evaluation.episode import Episode
from me3bev_cli.evaluation.metrics import METRICS, measure
from me3bev_cli.seeding import derive_seed

AUTOPILOT = "autopilot"
"""Its episodes stand beside those of the same seed."""
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


class Scored(NamedTuple):
    """An episode and its metrics."""

    episode: Episode
    values: dict[str, float]


def score(episodes: Sequence[Episode]) -> list[Scored]:
    """Every metric of every episode, beside the autopilot's of the same seed where it is among them."""
    pilots = {_seed(episode): episode for episode in episodes if episode.driver == AUTOPILOT}
    return [Scored(episode, measure(episode, pilots.get(_seed(episode)))) for episode in episodes]


def _seed(episode: Episode) -> tuple[str, str, int]:
    """What two episodes share that begin in the same world; the weather does not change it."""
    return episode.map, episode.density, episode.seed


@dataclass(frozen=True)
class WeatherRow(Row):
    """One figure of the episodes that had one kind of weather."""

    weather: str


def by_weather(episodes: Sequence[Episode], weathers: Sequence[str]) -> list[WeatherRow]:
    """The rows of `summarise` for each kind of weather on its own, in the order given."""
    scored = score(episodes)
    return [
        WeatherRow(**vars(row), weather=weather)
        for weather in weathers
        for row in rows_of([one for one in scored if one.episode.weather == weather])
    ]


def summarise(episodes: Sequence[Episode]) -> list[Row]:
    """The rows of episodes, as `rows_of`."""
    return rows_of(score(episodes))


def rows_of(scored: Sequence[Scored]) -> list[Row]:
    """Rows for every method, density, metric and map, and the average over the maps where there are several.

    Intervals are percentiles of `RESAMPLES` bootstrap means, resampled within each map; their seed comes from
    the cell's name, so the same episodes always give the same rows.
    """
    cells: dict[tuple[str, str], dict[str, list[dict[str, float]]]] = {}
    for episode, values_of in scored:
        group = cells.setdefault((episode.driver, episode.density), {})
        group.setdefault(episode.map, []).append(values_of)
    rows = []
    for (method, density), maps in cells.items():
        for metric in METRICS:
            values = {map: np.array([found[metric] for found in list_]) for map, list_ in maps.items()}
            rows.extend(_rows(method, density, metric, values))
    return rows


def _rows(method: str, density: str, metric: str, values: Mapping[str, Floats]) -> list[Row]:
    return [Row(method, e.map, density, metric, e.mean, e.low, e.high, e.n) for e in estimates(values, density)]


class Estimate(NamedTuple):
    """A mean with its interval."""

    map: str
    mean: float
    low: float
    high: float
    n: int


def estimates(values: Mapping[str, Floats], density: str) -> list[Estimate]:
    """The mean of each map's values (n,), and where there are several maps the mean of these means.

    Of each map as many values are drawn as it has; NaN among them are left out.
    """
    known = {map: array[~np.isnan(array)] for map, array in values.items()}
    means = {map: resampled_means(array, derive_seed("bootstrap", map, density)) for map, array in known.items()}
    found = [Estimate(map, _mean(array), *interval(means[map]), len(array)) for map, array in known.items()]
    if len(known) > 1:
        there = [map for map, array in known.items() if len(array)]
        mean = _mean(np.array([_mean(known[map]) for map in there]))
        ends = interval(np.mean([means[map] for map in there], axis=0)) if there else (math.nan, math.nan)
        found.append(Estimate(AVERAGE, mean, *ends, sum(len(known[map]) for map in there)))
    return found


def resampled_means(values: Floats, seed: int) -> Floats:
    """Means (`RESAMPLES`,) of samples drawn from `values` (n,) with replacement; NaN for fewer than two values."""
    if len(values) < 2:
        return np.full(RESAMPLES, math.nan)
    return np.asarray(values[_drawn(seed, len(values))].mean(axis=1))


@lru_cache(maxsize=16)
def _drawn(seed: int, count: int) -> NDArray[np.int64]:
    """Which values each resample takes (`RESAMPLES`, count): the same for all metrics of a cell."""
    return np.random.default_rng(seed).integers(count, size=(RESAMPLES, count))


def interval(means: Floats) -> tuple[float, float]:
    """The middle `LEVEL` of resampled means; NaN when they are."""
    if np.isnan(means).any():
        return math.nan, math.nan
    low, high = np.quantile(means, [(1 - LEVEL) / 2, (1 + LEVEL) / 2])
    return float(low), float(high)


def _mean(values: Floats) -> float:
    return float(values.mean()) if len(values) else math.nan

"""Rows: means and intervals against an independent bootstrap, NaN, the average over maps."""

from __future__ import annotations

import csv
import io
import math

import numpy as np
import pytest
from episodes import episode

from me3bev_cli.evaluation.episode import Episode
from me3bev_cli.evaluation.metrics import METRICS
from me3bev_cli.evaluation.summary import AVERAGE, Row, by_weather, interval, resampled_means, summarise
from me3bev_cli.evaluation.tables import csv_text, tables, weather_tables


def drives(map: str, rewards: list[float], **columns: object) -> list[Episode]:
    return [episode(4, map=map, reward=reward, **columns) for reward in rewards]


def row(rows: list[Row], map: str, metric: str) -> Row:
    (found,) = [r for r in rows if r.map == map and r.metric == metric]
    return found


def test_a_cell_has_mean_and_count() -> None:
    rows = summarise(drives("T1", [1, 2, 6]))
    found = row(rows, "T1", "return_per_step")
    assert (found.mean, found.n, found.method, found.density) == (3, 3, "me", "low")
    assert 1 <= found.low < 3 < found.high <= 6
    # One map needs no average.
    assert {r.map for r in rows} == {"T1"}
    assert [r.metric for r in rows] == list(METRICS)


def test_the_interval_covers_the_mean_as_often_as_it_says() -> None:
    rng = np.random.default_rng(0)
    hits = 0
    for trial in range(300):
        low, high = interval(resampled_means(rng.normal(7, 2, size=60), trial))
        hits += low <= 7 <= high
    assert 0.91 <= hits / 300 <= 0.98


def test_the_interval_is_near_the_normal_one() -> None:
    values = np.random.default_rng(1).normal(0, 3, size=400)
    low, high = interval(resampled_means(values, 5))
    half = 1.96 * values.std() / 20
    assert low == pytest.approx(values.mean() - half, abs=0.05)
    assert high == pytest.approx(values.mean() + half, abs=0.05)


def test_the_average_weighs_maps_alike() -> None:
    rows = summarise([*drives("T1", [0, 0, 0, 0, 0, 0]), *drives("T2", [6, 6])])
    found = row(rows, AVERAGE, "return_per_step")
    # Not 1.5, the mean over episodes; and resampling within maps leaves no doubt.
    assert (found.mean, found.low, found.high, found.n) == (3, 3, 3, 8)


def test_what_says_nothing_is_left_out() -> None:
    silent = drives("T1", [1, 1], traffic_speed=math.nan)
    heard = drives("T2", [1, 1], traffic_speed=2.5) + drives("T2", [1], traffic_speed=math.nan)
    rows = summarise([*silent, *heard])
    assert math.isnan(row(rows, "T1", "efficiency").mean)
    assert row(rows, "T1", "efficiency").n == 0
    assert (row(rows, "T2", "efficiency").mean, row(rows, "T2", "efficiency").n) == (2.0, 2)
    assert (row(rows, AVERAGE, "efficiency").mean, row(rows, AVERAGE, "efficiency").n) == (2.0, 2)
    assert math.isnan(row(summarise(silent), "T1", "efficiency").mean)


def test_one_episode_has_no_interval() -> None:
    found = row(summarise(drives("T1", [2])), "T1", "return_per_step")
    assert found.mean == 2
    assert math.isnan(found.low)
    assert math.isnan(found.high)


def test_the_same_episodes_give_the_same_rows() -> None:
    episodes = drives("T1", [1, 2, 6]) + drives("T2", [3, 2, 2])
    assert repr(summarise(episodes)) == repr(summarise(episodes))
    cell = [repr(r) for r in summarise(episodes) if r.map == "T2"]
    # A cell does not depend on its neighbours.
    assert cell == [repr(r) for r in summarise(episodes[3:])]


def seven() -> list[Row]:
    return summarise([e for i in range(1, 8) for e in drives(f"T{i}", [-1.0, -234.5])])


def test_the_table_of_seven_maps_fits_a_terminal() -> None:
    from rich.console import Console

    console = Console(file=io.StringIO(), width=100)
    ((headline, table),) = tables(seven())
    console.print(table)
    text = console.file.getvalue()  # type: ignore[attr-defined]
    assert headline == "me, low density, 2 episodes per map"
    assert "…" not in text
    lines = text.splitlines()
    assert max(map(len, lines)) <= 100
    assert all(f"T{i}" in lines[0] for i in range(1, 8))
    assert "average" in lines[0]
    assert [metric.label in text for metric in METRICS.values()] == [True] * len(METRICS)


def test_few_columns_show_intervals() -> None:
    from rich.console import Console

    console = Console(file=io.StringIO(), width=100)
    console.print(tables(summarise(drives("T1", [1, 3])))[0][1])
    assert "2.00 (1.00..3.00)" in console.file.getvalue()  # type: ignore[attr-defined]


def test_csv_has_the_rows() -> None:
    rows = seven()
    read = list(csv.DictReader(io.StringIO(csv_text(rows))))
    assert len(read) == len(rows)
    assert list(read[0]) == ["method", "map", "density", "metric", "mean", "low", "high", "n"]
    for line, found in zip(read, rows, strict=True):
        assert line["metric"] == found.metric
        assert (line["mean"] == "") == math.isnan(found.mean)
        if line["mean"]:
            assert float(line["mean"]) == found.mean


def test_weathers_are_summed_up_apart() -> None:
    noon = drives("T1", [1, 3], weather="noon") + drives("T2", [5, 7], weather="noon")
    fog = drives("T1", [10], weather="fog")
    rows = by_weather([*fog, *noon], ["noon", "fog", "rain"])
    assert list(dict.fromkeys(r.weather for r in rows)) == ["noon", "fog"]
    found = {(r.weather, r.map): (r.mean, r.n) for r in rows if r.metric == "return_per_step"}
    assert found == {
        ("noon", "T1"): (2, 2),
        ("noon", "T2"): (6, 2),
        ("noon", AVERAGE): (4, 4),
        ("fog", "T1"): (10, 1),
    }


def test_the_table_of_six_weathers_fits_a_terminal() -> None:
    from rich.console import Console

    names = ("clear_noon", "cloudy", "dusk", "night", "rain", "fog")
    episodes = [e for name in names for e in drives("T1", [-1, -234.5], weather=name) + drives("T2", [5], weather=name)]
    console = Console(file=io.StringIO(), width=100)
    ((headline, table),) = weather_tables(by_weather(episodes, names))
    console.print(table)
    lines = console.file.getvalue().splitlines()  # type: ignore[attr-defined]
    assert headline == "me, low density, by weather (episodes)"
    assert max(map(len, lines)) <= 100
    assert "…" not in "".join(lines)
    assert lines[0].split() == list(names)
    assert lines[1].split() == ["metric", *["(3)"] * 6]
    (shown,) = [line for line in lines if line.startswith("return per step")]
    # The mean of the maps' means: (-117.75 + 5) / 2.
    assert shown.split()[-6:] == ["-56.4"] * 6

"""What stands behind the page: charts, tables, choices; numbers worked out by hand."""

from __future__ import annotations

import json
import math
import re
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from episodes import episode

from me3bev_cli.evaluation.episode import Episode
from me3bev_cli.evaluation.published import published_rows
from me3bev_cli.evaluation.summary import Row
from me3bev_cli.reporting.chart import BOTTOM, HEIGHT, LEFT, RIGHT, TOP, WIDTH, Chart, number_text, tick_values
from me3bev_cli.reporting.failures import chosen, counted, failures
from me3bev_cli.reporting.figures import figure, interval, scale
from me3bev_cli.reporting.scatter import pareto
from me3bev_cli.reporting.sources import Evaluation, read_evaluation
from me3bev_cli.reporting.suites import Suite, suites
from me3bev_cli.reporting.summary import beside, cards
from me3bev_cli.reporting.tables import method_table, published_table

NAN = math.nan


def evaluation(
    folder: Path, method: str, score: float, *, driver: str = "policy", seed: int = 0, **more: Any
) -> Evaluation:
    """Results of one method and of the autopilot on T1 and T2."""
    found = []
    for name, value in ((method, score), ("autopilot", 95.0)):
        for place, shift in (("T1", -1.0), ("T2", 1.0), ("average", 0.0)):
            found.append(Row(name, place, "low", "driving_score", value + shift, value - 3, value + 3, 20))
    about = {"run": f"runs/{method}", "checkpoint": "step_1", "recipe": "small"}
    document = {
        "maps": ["T1", "T2"], "densities": ["low"], "episodes": 10, "seed": seed,
        "methods": [{"method": method, "driver": driver, **about}, {"method": "autopilot", "driver": "autopilot"}],
        "rows": [asdict(row) for row in found], **more,
    }  # fmt: skip
    folder.mkdir(parents=True)
    (folder / "results.json").write_text(json.dumps(document))
    return read_evaluation(folder)


def test_ticks_are_round_and_few() -> None:
    assert tick_values(0, 1) == pytest.approx([0, 0.2, 0.4, 0.6, 0.8, 1])
    assert tick_values(0, 41_000) == [0, 10_000, 20_000, 30_000, 40_000]
    assert tick_values(-3, 7) == [-2, 0, 2, 4, 6]
    assert tick_values(2, 2) == [2]
    assert [number_text(v) for v in (0, 0.30000000000000004, 20_000, 2.5e6)] == ["0", "0.3", "20k", "2.5M"]


def test_a_chart_has_its_ends_where_its_axes_end() -> None:
    chart = Chart((0.0, 10.0), (0.0, 100.0), "a <b>")
    assert chart.at(0, 0) == (LEFT, HEIGHT - BOTTOM)
    assert chart.at(10, 100) == (WIDTH - RIGHT, TOP)
    chart.bar(0, 5, 50, 13, 'say "x" & y')
    svg = str(chart.svg())
    # Half the room is 162 x 99 units.
    assert 'class="fill s1 again" x="46.0" y="111.0" width="162.0" height="99.0"' in svg
    assert "say &#34;x&#34; &amp; y" in svg
    assert 'aria-label="a &lt;b&gt;"' in svg
    assert "<b>" not in svg


def test_figures_have_their_metrics_decimals() -> None:
    assert [figure(v, m) for v, m in ((61.84, "driving_score"), (0.126, "success"), (NAN, "success"))] == [
        "61.8", "0.13", "–",
    ]  # fmt: skip
    assert interval(Row("m", "T1", "low", "driving_score", 60.0, 51.25, 66.0, 9)) == "51.2 to 66.0"
    assert interval(Row("m", "T1", "low", "driving_score", 60.0, NAN, NAN, 1)) == ""
    assert figure(1.23456, "of_another_version") == "1.23"
    assert scale("success", []) == (0.0, 1.0)
    low, high = scale("timesteps", [Row("m", "T1", "low", "timesteps", 90.0, 80.0, 100.0, 9)])
    assert (low, high) == (0.0, 105.0)


def test_evaluations_of_the_same_episodes_are_one_suite(tmp_path: Path) -> None:
    one, two = evaluation(tmp_path / "a", "one", 60.0), evaluation(tmp_path / "b", "two", 70.0)
    other = evaluation(tmp_path / "c", "one", 65.0)
    elsewhere = evaluation(tmp_path / "d", "one", 50.0, seed=1)
    first, second = suites([one, two, other, elsewhere])
    assert (first.title, first.about) == ("T1, T2, low density", "10 episodes per map and density, seed 0")
    # The autopilot's figures are the same everywhere; a second `one` is another method.
    assert [method.label for method in first.methods] == ["one", "two", "one (2)", "autopilot"]
    assert [method.is_policy for method in first.methods] == [True, True, True, False]
    row = first.row("one (2)", "low", "driving_score")
    assert row is not None
    assert (row.mean, row.map) == (65.0, "average")
    assert [method.label for method in second.methods] == ["one", "autopilot"]
    assert second.seed == 1


def test_cards_and_sentences_are_of_the_policies(tmp_path: Path) -> None:
    told = [
        {"method": "autopilot", "baseline": "one", "map": "average", "density": "low", "metric": "driving_score",
         "difference": 35.0, "low": 30.0, "high": 40.0, "verdict": "better"},
    ]  # fmt: skip
    (suite,) = suites([evaluation(tmp_path / "a", "one", 60.0, comparisons=told)])
    (card,) = cards(suite)
    assert (card.name, card.scores) == ("one", [("low density", "60.0", "57.0 to 63.0")])
    assert beside(suite) == ["Driving score of drivers to compare with, low density: autopilot 95.0."]
    table = method_table(suite, ("driving_score", "comfort"), "Driving")
    assert [column.text for column in table.columns] == ["method", "driving score ↑"]
    assert [(line[0].text, line[1].value, line[1].mark) for line in table.lines] == [
        ("one", 60.0, ""),
        ("autopilot", 95.0, "▲"),
    ]
    assert table.lines[1][1].mark_words == "better than one"
    assert table.quiet == [False, True]


def test_published_figures_stand_apart_and_without_intervals(tmp_path: Path) -> None:
    (plain,) = suites([evaluation(tmp_path / "a", "one", 60.0)])
    assert published_table(plain) is None
    rows = [asdict(row) for row in published_rows(["T1", "T2"], ["low"])]
    rows = [{**row, "low": None, "high": None} for row in rows]
    (suite,) = suites([evaluation(tmp_path / "b", "one", 60.0, published={"note": "", "rows": rows})])
    table = published_table(suite)
    assert table is not None
    assert [column.text for column in table.columns[:3]] == ["method", "density", "map"]
    assert [cell.text for cell in table.lines[0][:3]] == ["ME3-BEV (CARLA)", "low", "T1"]
    assert {cell.note for line in table.lines for cell in line} == {""}
    assert "ME3-BEV (CARLA)" not in [method.label for method in suite.methods]


def bench(**median_ms: float) -> dict[str, Any]:
    rows = [
        {"name": name, "context": "window", "length": length, "own": length == 4, "median_ms": ms * length / 4,
         "p95_ms": 1.5 * ms, "stages": {}}
        for name, ms in median_ms.items() for length in (4, 16)
    ]  # fmt: skip
    return {"setup": {"device": "cpu", "threads": 2, "dtype": "float32", "batch": 1}, "rows": rows}


def test_the_front_holds_what_none_beats_in_both(tmp_path: Path) -> None:
    scores = {"fast": 50.0, "good": 80.0, "slow": 70.0, "untimed": 99.0}
    found = suites([evaluation(tmp_path / name, name, score) for name, score in scores.items()])
    shown = pareto(found, [(Path("latency.json"), bench(fast=2.0, good=8.0, slow=9.0, stranger=1.0))])
    assert [(p["run"], p["median_ms"], p["score"], p["front"]) for p in shown.data] == [
        ("fast", 2.0, 50.0, True), ("good", 8.0, 80.0, True), ("slow", 9.0, 70.0, False),
    ]  # fmt: skip
    assert len(re.findall('class="dot hollow', str(shown.pictures[0].svg))) == 1
    assert "on cpu, 2 threads, float32, batch 1" in shown.notes[0]
    alone = pareto(found, [(Path("x.json"), bench(stranger=1.0))])
    assert (alone.pictures, alone.notes) == (
        [],
        ["x.json has the speed of stranger, none of which is a method of this report."],
    )


def test_a_benchs_own_scores_are_used_where_no_method_is_timed() -> None:
    own = {"run": "r", "cell": "T3, low; 50 episodes", "context": "window 4", "median_ms": 3.0, "p95_ms": 4.0,
           "score": 60.0, "low": 50.0, "high": 70.0, "front": True}  # fmt: skip
    shown = pareto([Suite(("T1",), ("low",), (), 1, 0)], [(Path("b.json"), bench(r=3.0) | {"scores": [own]})])
    assert [(p["run"], p["front"]) for p in shown.data] == [("r", True)]


def at(length: int, *steps: int) -> Any:
    found = np.zeros(length, bool)
    found[list(steps)] = True
    return found


def test_each_kind_of_failure_where_it_first_happens() -> None:
    hit = np.array([""] * 9 + ["vehicle"], "<U10")
    one = episode(
        ended="collision", collision=hit, at_fault=at(10, 9), red_light=at(10, 3, 6), off_road=at(10, 5, 6),
        lane_departure=at(10, 5),
    )  # fmt: skip
    assert [(f.kind, f.step, f.at_fault) for f in failures(one)] == [
        ("vehicle", 9, True), ("red_light", 3, False), ("off_road", 5, False),
    ]  # fmt: skip
    assert [(f.kind, f.step) for f in failures(episode(lane_departure=at(10, 2)))] == [
        ("lane_departure", 2),
        ("timeout", 9),
    ]
    assert failures(episode(ended="finished")) == []
    assert counted([one, one, episode()])["timeout"] == {"me": 1}
    assert counted([one, one, episode()])["vehicle"] == {"me": 2}


def test_the_choice_has_every_driver_and_map_before_any_twice() -> None:
    def hit(driver: str, place: str, index: int, fault: bool = False) -> Episode:
        found = episode(1, "collision", place, driver=driver, collision="vehicle", at_fault=fault)
        object.__setattr__(found, "index", index)
        return found

    episodes = [hit("a", "T1", 0), hit("a", "T1", 1, True), hit("a", "T2", 2), hit("b", "T1", 0), hit("b", "T1", 1)]

    def names(each: int) -> list[tuple[str, str, int]]:
        return [(f.episode.driver, f.episode.map, f.episode.index) for f in chosen(episodes, each)]

    assert names(9) == [("a", "T1", 1), ("b", "T1", 0), ("a", "T2", 2), ("b", "T1", 1), ("a", "T1", 0)]
    assert names(2) == names(9)[:2]
    assert names(0) == []

"""Speed against driving score: which evaluation counts, and whom nobody beats, by hand."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import pytest

from me3bev_cli.bench.latency_picture import score_picture
from me3bev_cli.bench.latency_scores import Score, points, scores
from me3bev_cli.bench.latency_subjects import Subject
from me3bev_cli.bench.latency_tables import score_tables
from me3bev_cli.errors import UserError
from me3bev_cli.recipe_loading import resolve_recipe


def write(run: Path, folder: str, mean: float, **more: Any) -> Path:
    """A file of results as `me3bev eval` leaves it: two maps and their average."""
    row = {"method": "m", "density": "low", "low": mean - 5, "high": mean + 5, "n": 20}
    rows = [
        row | {"map": "T1", "metric": "driving_score", "mean": 1.0},
        row | {"map": "T3", "metric": "driving_score", "mean": 2.0},
        row | {"map": "average", "metric": "driving_score", "mean": mean, "n": 40},
        row | {"map": "average", "metric": "route_completion", "mean": 0.3},
    ]
    data = {
        "driver": "policy", "checkpoint": "step_1", "maps": ["T1", "T3"], "weather": ["clear_noon"], "episodes": 20,
        "seed": 0, "rows": rows,
    }  # fmt: skip
    path = run / "eval" / folder / "results.json"
    path.parent.mkdir(parents=True)
    path.write_text(json.dumps(data | more))
    return path


def subject(name: str, run: Path | None, checkpoint: str = "step_1") -> Subject:
    return Subject(name, resolve_recipe("quickstart"), None if run is None else run / "checkpoints" / checkpoint, run)


def test_the_average_of_each_cell_is_read(tmp_path: Path) -> None:
    write(tmp_path / "a", "T1,T3-low", 70.0)
    write(tmp_path / "a", "deeper/T3-high", 60.0, maps=["T3"], seed=4)
    # A reference driver's results in the run's folder are not the run's.
    write(tmp_path / "a", "autopilot", 99.0, driver="autopilot", maps=["T2"])
    found = scores([subject("a", tmp_path / "a"), subject("recipe", None)])
    assert {(score.run, score.cell, score.mean, score.low, score.high, score.n) for score in found} == {
        ("a", "T1,T3, low, clear_noon; 20 episodes per map, seed 0", 70, 65, 75, 40),
        ("a", "T3, low, clear_noon; 20 episodes per map, seed 4", 60, 55, 65, 40),
    }


def test_one_map_alone_is_its_own_average(tmp_path: Path) -> None:
    row = {"method": "m", "map": "T3", "density": "high", "metric": "driving_score", "mean": 50.0, "n": 1}
    write(tmp_path / "a", "x", 0.0, maps=["T3"], rows=[row | {"low": None, "high": None}], weather=[])
    (found,) = scores([subject("a", tmp_path / "a")])
    assert (found.cell, found.mean, found.low) == ("T3, high; 20 episodes per map, seed 0", 50, None)


def test_the_timed_checkpoints_evaluation_comes_first_then_the_newest(tmp_path: Path) -> None:
    run = tmp_path / "a"
    for seconds, (folder, checkpoint, mean) in enumerate(
        [("mine", "step_2", 20.0), ("old", "step_1", 10.0), ("new", "step_3", 30.0)]
    ):
        path = write(run, folder, mean, checkpoint=checkpoint)
        os.utime(path, (1_000_000 + seconds, 1_000_000 + seconds))
    assert [score.mean for score in scores([subject("a", run, "step_2")])] == [20]
    assert [score.mean for score in scores([subject("a", run, "step_9")])] == [30]


def test_mistakes(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="no run that is compared has been evaluated"):
        scores([subject("a", tmp_path)])
    path = write(tmp_path, "x", 1.0)
    path.write_text('{"driver": "policy"}')
    with pytest.raises(UserError, match=r"results\.json: is no file of results \(KeyError: 'rows'\)"):
        scores([subject("a", tmp_path)])


def score(run: str, mean: float, cell: str = "here") -> Score:
    return Score(run, cell, "step_1", mean, None, None, 1)


def row(name: str, median: float, context: str = "window", length: int = 4, own: bool = True) -> dict[str, Any]:
    return {"name": name, "median_ms": median, "p95_ms": 2 * median, "context": context, "length": length, "own": own}


def test_the_front() -> None:
    """By time: a (10 ms, 50), b (20, 40) is beaten by a, c (20, 60) is not, d (30, 60) is by c, e ties with c."""
    timed = [row("a", 10), row("b", 20), row("c", 20), row("d", 30), row("e", 20)]
    found = points([score(n, s) for n, s in zip("abcde", (50, 40, 60, 60, 60), strict=True)], timed)
    assert {point.score.run: point.front for point in found} == {
        "a": True,
        "b": False,
        "c": True,
        "d": False,
        "e": True,
    }
    # Scores of other cells do not compare.
    apart = points([score("a", 50), score("b", 40, "there")], timed)
    assert [point.front for point in apart] == [True, True]


def test_a_runs_speed_is_that_of_its_own_context() -> None:
    """Of a stream the longest; where its own was not asked for, the first; nothing where nothing was timed."""
    timed = [
        row("a", 1, length=4, own=False), row("a", 2, length=8), row("a", 3, "stream", 8, own=False),
        row("s", 4, own=False), row("s", 5, "stream", 4), row("s", 6, "stream", 64),
        row("o", 7, own=False), row("o", 8, length=9, own=False),
    ]  # fmt: skip
    found = points([score(name, 50) for name in ("a", "s", "o", "gone")], timed)
    assert [(p.score.run, p.context, p.median_ms) for p in found] == [
        ("a", "window 8", 2),
        ("s", "stream 64", 6),
        ("o", "window 4", 7),
    ]


def test_table_and_picture() -> None:
    timed = [row("a", 10), row("b", 20)]
    found = points([score("a", 50), score("b", 40), score("a", 30, "there"), score("b", 70, "third")], timed)
    titles = [title for title, _ in score_tables(found)]
    assert [title.split(": ")[1].split(";")[0] for title in titles] == ["here", "there", "third"]
    table = score_tables(found)[0][1]
    columns = {str(column.header): list(column.cells) for column in table.columns}
    assert columns["run"] == ["a", "b"]
    assert columns["front"] == ["*", ""]
    assert score_picture(found, "title").startswith(b"\x89PNG")

"""Speed against driving score: evaluations of the runs that were timed, and which no other one beats in both."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from me3bev_cli.bench.latency_rows import Row
from me3bev_cli.bench.latency_subjects import Subject
from me3bev_cli.errors import UserError
from me3bev_cli.evaluation.maps import shorten
from me3bev_cli.evaluation.results import JSON
from me3bev_cli.evaluation.summary import AVERAGE
from me3bev_cli.pretrained import results_home

METRIC = "driving_score"
FOLDER = "eval"


@dataclass(frozen=True)
class Score:
    """A run's driving score in one cell: what can be compared with other runs of the same cell."""

    run: str
    """Name of the subject."""
    cell: str
    """Maps, density, weather, episodes and seed, for people."""
    checkpoint: str
    mean: float
    low: float | None
    """Ends of the 95 % interval; None for too few episodes."""
    high: float | None
    n: int


@dataclass(frozen=True)
class Point:
    """A run's speed and score."""

    score: Score
    context: str
    median_ms: float
    p95_ms: float
    front: bool
    """Whether no other run of the cell is both as fast and as good, and better in one of the two."""


def scores(subjects: Sequence[Subject]) -> list[Score]:
    """Driving scores of the runs; of several evaluations of a cell that of the timed checkpoint, then the newest.

    Raises:
        UserError: none of them has been evaluated, or a file of results is damaged.
    """
    found: dict[tuple[str, str], tuple[tuple[bool, int], Score]] = {}
    for subject in subjects:
        for path in sorted((results_home(subject.run) / FOLDER).rglob(JSON)) if subject.run is not None else ():
            for score in _read(path, subject.name):
                mine = subject.checkpoint is not None and score.checkpoint == subject.checkpoint.name
                rank, key = (mine, path.stat().st_mtime_ns), (score.run, score.cell)
                if key not in found or found[key][0] < rank:
                    found[key] = rank, score
    if not found:
        raise UserError(
            "no run that is compared has been evaluated", where="--with-scores", hint="`me3bev eval --run RUN` does it"
        )
    return [score for _, score in found.values()]


def _read(path: Path, name: str) -> Iterator[Score]:
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
        if data["driver"] != "policy":
            return
        # Beside the run there may be rows of other drivers.
        rows = [r for r in data["rows"] if r["metric"] == METRIC and data.get("method") in (None, r.get("method"))]
        many = any(row["map"] == AVERAGE for row in rows)
        for row in rows:
            if many and row["map"] != AVERAGE:
                continue
            if row["mean"] is not None:
                cell = _cell(data, row["density"])
                yield Score(name, cell, data["checkpoint"], row["mean"], row["low"], row["high"], row["n"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise UserError(f"is no file of results ({type(error).__name__}: {error})", where=str(path)) from error


def _cell(data: Mapping[str, Any], density: str) -> str:
    weather = data.get("weather") or []
    words = [shorten(tuple(data["maps"])), density, *([shorten(tuple(weather))] if weather else [])]
    return f"{', '.join(words)}; {data['episodes']} episodes per map, seed {data['seed']}"


def points(found: Sequence[Score], rows: Sequence[Row]) -> list[Point]:
    """Each score beside the speed of its run in the run's own context: for a stream, the longest that was timed."""
    speed: dict[str, Row] = {}
    for row in rows:
        # Without its own context among those that were asked for, the first one stands for the run.
        if row["name"] not in speed or row["own"]:
            speed[row["name"]] = row
    timed = [(score, speed[score.run]) for score in found if score.run in speed]
    return [
        Point(
            score, f"{row['context']} {row['length']}", row["median_ms"], row["p95_ms"], not _beaten(score, row, timed)
        )
        for score, row in timed
    ]


def _beaten(score: Score, row: Row, timed: Sequence[tuple[Score, Row]]) -> bool:
    """Whether another run of the cell is at least as fast and as good, and better in one of the two."""
    mine = -row["median_ms"], score.mean
    others = [(-other["median_ms"], rival.mean) for rival, other in timed if rival.cell == score.cell]
    return any(all(a >= b for a, b in zip(its, mine, strict=True)) and its != mine for its in others)

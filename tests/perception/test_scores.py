"""Scores by mask, and a run's grid scored on several maps."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from me3bev_cli.decoding.scores import Tally, confusion
from me3bev_cli.perception.evaluation import mean_rows, score_grid
from me3bev_cli.perception.scoring import shown_scores
from me3bev_cli.recipe_loading import dump, resolve_recipe
from me3bev_cli.stopping import Stop
from me3bev_cli.training.display import Display
from me3bev_cli.training.run import make_run
from me3bev_cli.training.trainer import Trainer


def test_only_the_cells_of_a_mask_are_counted() -> None:
    truth, decoded = np.array([[1, 1, 6, 0]], np.uint8), np.array([[1, 6, 6, 0]], np.uint8)
    counts = confusion(truth, decoded, np.array([[True, False, True, False]]))
    assert (counts[1, 1], counts[6, 6], counts.sum()) == (1, 1, 2)


def test_a_tally_adds_up_what_comes_in_parts() -> None:
    rng = np.random.default_rng(0)
    truth, decoded = rng.integers(0, 8, (2, 4, 200, 200), np.uint8)
    seen = rng.random(truth.shape) < 0.3
    whole, halves, other = Tally(), Tally(), Tally()
    whole.add(truth, decoded, seen)
    halves.add(truth[:3], decoded[:3], seen[:3])
    other.add(truth[3:], decoded[3:], seen[3:])
    halves.merge(other)
    assert (whole.frames, halves.frames) == (4, 4)
    assert whole.rows("grid") == halves.rows("grid")
    assert int(whole.counts["seen"].sum()) == int(seen.sum())
    assert int(whole.counts["near"].sum()) == 4 * 100 * 100
    assert {row["mask"] for row in whole.rows("grid", map="T1")} == {"all", "seen", "near"}


def test_without_sight_nothing_is_said_of_it() -> None:
    tally = Tally()
    tally.add(np.ones((1, 200, 200), np.uint8), np.ones((1, 200, 200), np.uint8))
    assert {row["mask"] for row in tally.rows("grid")} == {"all", "near"}
    assert set(shown_scores(tally)) == {"near_road", "near_lane_marking", "near_vehicle", "near_pedestrian"}


def test_the_mean_over_maps_leaves_out_what_is_nowhere() -> None:
    rows = [
        {"source": "grid", "mask": "near", "map": place, "class": name, "iou": value}
        for place, name, value in [("A", "road", 0.5), ("B", "road", 0.7), ("A", "vehicle", float("nan"))]
    ]
    assert mean_rows(rows) == [
        {"source": "grid", "mask": "near", "map": "mean", "class": "road", "iou": pytest.approx(0.6)}
    ]


def test_a_run_is_scored_on_maps(line_recipe: Path, overrides: list[str], run: Path) -> None:
    recipe = resolve_recipe(line_recipe, overrides)
    make_run(run, dump(recipe))
    Trainer(recipe, run, Display(96, 1), Stop()).train()
    shown: list[str] = []
    rows = score_grid(run, ["F1", "F2"], "low", frames=8, shown=lambda place, tally: shown.append(place))
    assert shown == ["F1", "F2"]
    found = {(row["map"], row["mask"], row["class"]): row["iou"] for row in rows}
    assert {row["source"] for row in rows} == {"grid"}
    assert 0 <= float(found[("mean", "near", "road")]) <= 1  # type: ignore[arg-type]
    assert found[("mean", "near", "road")] == pytest.approx(
        (found[("F1", "near", "road")] + found[("F2", "near", "road")]) / 2  # type: ignore[operator]
    )

"""The bench times what it says: every stage, every recipe, as often as asked."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import torch
from typer.testing import CliRunner

from me3bev_cli.bench.latency import STAGES, Bench, measure
from me3bev_cli.pipeline.control import Controller
from me3bev_cli.recipe_loading import resolve_recipe


def test_rows_hold_every_stage_and_add_up(line_recipe: Path) -> None:
    recipes = [resolve_recipe(line_recipe), resolve_recipe(line_recipe, ["name=none", "temporal=null"])]
    rows = measure(recipes, torch.device("cpu"), repeats=5, warmup=1)
    assert [row["name"] for row in rows] == ["line", "none"]
    for row in rows:
        assert set(row["stages"]) == set(STAGES)
        assert 0 < row["median_ms"] <= row["p95_ms"] <= row["p99_ms"]
        assert row["frames_per_s"] == pytest.approx(1000 / row["median_ms"])


def test_the_bench_calls_what_drives(line_recipe: Path) -> None:
    """The timed path gives the action that the controller gives."""
    recipe = resolve_recipe(line_recipe)
    bench = Bench(recipe, torch.device("cpu"), 1)
    bench.call(keep=True)
    controller = Controller.untrained(recipe)
    controller.act({key: value[0] for key, value in bench.observation.items()})
    for name, mine in bench.state["frames"].items():
        torch.testing.assert_close(mine, controller.state["frames"][name])
    assert len(bench.timing.whole) == 1


def test_by_command_line(line_recipe: Path) -> None:
    from me3bev_cli.main import app

    arguments = ["bench-latency", str(line_recipe), "--repeats", "2", "--warmup", "1", "--device", "cpu", "--json", "-"]
    result = CliRunner().invoke(app, arguments, catch_exceptions=False)
    assert result.exit_code == 0
    data = json.loads(result.stdout)
    assert data["setup"]["batch"] == 1
    assert data["rows"][0]["name"] == "line"

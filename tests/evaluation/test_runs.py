"""Policies of runs: several in one table, and what may be wrong with them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from scripted_world import RECIPE
from typer.testing import CliRunner, Result

from me3bev_cli.main import app
from me3bev_cli.pipeline.assemble import build_network
from me3bev_cli.recipe_loading import dump, resolve_recipe
from me3bev_cli.training.checkpoint import Progress, save_checkpoint

OPTIONS = ("--maps", "M1,M2", "--episodes", "6", "--workers", "0")


def run(*arguments: object) -> Result:
    return CliRunner().invoke(app, ["eval", *map(str, arguments)])


def make_run(folder: Path, seed: int) -> Path:
    folder.mkdir(parents=True)
    path = folder / "recipe.yaml"
    path.write_text(RECIPE)
    recipe = resolve_recipe(path, [f"seed={seed}"])
    path.write_text(dump(recipe))
    (folder / "metrics.jsonl").touch()
    save_checkpoint(folder, build_network(recipe, seed).state_dict(), recipe, Progress(total_steps=10), {})
    return folder


@pytest.fixture
def runs(scripted: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Two runs, `old` and `new`."""
    monkeypatch.chdir(tmp_path)
    for name, seed in (("old", 1), ("new", 2)):
        make_run(tmp_path / "runs" / name, seed)
    return tmp_path / "runs"


def document(out: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((out / "results.json").read_text())
    return found


def test_several_runs_in_one_table(runs: Path) -> None:
    result = run("--run", "runs/old", "--run", "runs/new", "--reference", "idle", *OPTIONS, "--baseline", "old")
    assert result.exit_code == 0, result.output
    found = document(runs / "eval" / "old,new,idle" / "M1,M2-high")
    assert list(dict.fromkeys(row["method"] for row in found["rows"])) == ["old", "new", "idle"]
    assert [(m["method"], m["driver"], m["checkpoint"]) for m in found["methods"]] == [
        ("old", "policy", "step_000000010"),
        ("new", "policy", "step_000000010"),
        ("idle", "idle", None),
    ]
    assert found["methods"][0]["identity"]["weights"] != found["methods"][1]["identity"]["weights"]
    assert {(c["method"], c["baseline"]) for c in found["comparisons"]} == {("new", "old"), ("idle", "old")}
    assert {c["n"] for c in found["comparisons"] if (c["metric"], c["map"]) == ("timesteps", "average")} == {12}
    assert "average over the maps, high density; ▲ better, ▼ worse than old" in result.stdout


def test_the_baseline_may_be_a_run_or_a_driver(runs: Path) -> None:
    assert run("--run", "runs/new", *OPTIONS, "--baseline", "runs/old", "--out", "a").exit_code == 0
    assert {c["baseline"] for c in document(Path("a"))["comparisons"]} == {"old"}
    assert run("--run", "runs/new", *OPTIONS, "--baseline", "autopilot", "--out", "b").exit_code == 0
    found = document(Path("b"))
    assert {c["baseline"] for c in found["comparisons"]} == {"autopilot"}
    # The autopilot has driven the same seeds, so there is something to set progress against.
    (progress,) = [
        row
        for row in found["rows"]
        if (row["method"], row["map"], row["metric"]) == ("new", "average", "relative_progress")
    ]
    assert progress["n"] == 12
    assert progress["mean"] > 0


def test_a_runs_evaluation_is_kept_with_it(runs: Path) -> None:
    assert run("--run", "runs/new", "--reference", "idle", *OPTIONS).exit_code == 0
    assert (runs / "new" / "eval" / "M1,M2-high" / "results.json").is_file()
    # Another checkpoint of the run is another evaluation.
    make_run(runs / "newer", 3)
    (runs / "newer" / "checkpoints" / "step_000000010").rename(runs / "new" / "checkpoints" / "step_000000020")
    result = run("--run", "runs/new", "--reference", "idle", *OPTIONS)
    assert result.exit_code == 2
    assert "the checkpoint of 'new' is step_000000010, not step_000000020" in result.stderr
    assert run("--run", "runs/new", "--reference", "idle", *OPTIONS, "--checkpoint", "step_000000010").exit_code == 0


def test_runs_of_one_name_are_told_apart(runs: Path) -> None:
    make_run(runs / "elsewhere" / "new", 5)
    assert run("--run", "runs/new", "--run", "runs/elsewhere/new", *OPTIONS, "--out", "both").exit_code == 0
    assert [m["method"] for m in document(Path("both"))["methods"]] == ["runs-new", "elsewhere-new"]
    twice = run("--run", "runs/new", "--run", "runs/new", *OPTIONS)
    assert twice.exit_code == 2
    assert "is named twice. Rename one of the folders, or leave it out" in twice.stderr


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("concat", "cocnat"), "unknown fusion plugin 'cocnat'; did you mean 'concat'?"),
        (("width: 8", "width: 16"), "another architecture"),
        (("name: scripted", "name: scriptde"), "unknown simulator plugin 'scriptde'; did you mean 'scripted'?"),
    ],
)
def test_runs_that_cannot_drive(runs: Path, change: tuple[str, str], message: str) -> None:
    for path in (runs / "new").rglob("recipe.yaml"):
        path.write_text(path.read_text().replace(*change))
    result = run("--run", "runs/new", *OPTIONS)
    assert result.exit_code == 2, result.output
    assert message in result.stderr
    assert not (runs / "new" / "eval").exists()

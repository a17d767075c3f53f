"""The policy in the box: what is in it, when it drives, and that it drives as it did."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from typer.testing import CliRunner, Result

from me3bev_cli import pretrained
from me3bev_cli.evaluation.episode import Episode, load
from me3bev_cli.main import app
from me3bev_cli.perception.model import HEAD, load_model
from me3bev_cli.recipe_diff import differences, run_recipe
from me3bev_cli.recipe_loading import resolve_recipe
from me3bev_cli.training.checkpoint import find_checkpoint, load_network
from me3bev_cli.training.run import is_run, make_run
from me3bev_cli.training.takeover import check_takeover

CELL = json.loads((Path(__file__).parent / "pretrained_cell.json").read_text())
"""What the shipped policy drove: where the ego was at every so many steps, in metres."""
NEAR = 0.25
"""Metres. Another processor, or other instructions of the same one, adds in another order: seen to make 0.03."""


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("ME3BEV_RUNS", raising=False)
    return tmp_path


def run(*arguments: object) -> Result:
    return CliRunner().invoke(app, [*map(str, arguments)])


def test_it_is_a_whole_run_of_at_most_12_megabytes() -> None:
    box = pretrained.box()
    assert is_run(box)
    assert sum(path.stat().st_size for path in box.rglob("*") if path.is_file()) <= 12e6
    network, recipe = load_network(find_checkpoint(box), torch.device("cpu"))
    assert recipe.name == "small-me3bev"
    assert (box / HEAD).is_file()
    load_model(network, box)


def test_it_was_trained_by_the_recipe_that_is_shipped() -> None:
    shipped = resolve_recipe("small/me3bev").model_dump(mode="json")
    assert differences([shipped, run_recipe(pretrained.box())]) == []


@pytest.mark.parametrize("recipe", ["small/me3bev", "small/me3bev_gru", "scratch/me3bev"])
def test_it_has_the_eyes_of_the_recipes_that_are_shipped(recipe: str) -> None:
    check_takeover(resolve_recipe(recipe), pretrained.box())


def test_the_card_says_what_a_user_must_know() -> None:
    card = (pretrained.box() / "MODEL_CARD.md").read_text()
    for heading in ("Recipe", "Data", "Seeds", "Figures", "Limits", "Licence"):
        assert f"\n## {heading}" in card
    weights = find_checkpoint(pretrained.box()) / "policy.safetensors"
    assert hashlib.sha256(weights.read_bytes()).hexdigest() in card


def test_it_drives_where_no_run_is_named_and_there_is_none(capsys: pytest.CaptureFixture[str]) -> None:
    assert pretrained.default_run() == pretrained.box()
    assert "there is none under runs: this is the shipped policy" in capsys.readouterr().err
    make_run(Path("runs/mine"), "name: mine\n")
    assert pretrained.default_run() == Path("runs/mine")
    assert "this is the newest, runs/mine; `pretrained` is the shipped" in capsys.readouterr().err


def test_its_name_means_it_unless_there_is_a_run_of_that_name() -> None:
    # What it is measured by is kept in a folder of its name, which is no run.
    Path("runs/pretrained/eval").mkdir(parents=True)
    assert pretrained.find_run("pretrained") == pretrained.run_path("pretrained") == pretrained.box()
    assert pretrained.find_run("other") == Path("other")
    make_run(Path("runs/pretrained"), "name: mine\n")
    assert pretrained.run_path("pretrained") == Path("runs/pretrained")
    make_run(Path("pretrained"), "name: mine\n")
    assert pretrained.find_run("pretrained") == Path("pretrained")


def test_nothing_is_written_into_the_box() -> None:
    box = pretrained.box()
    assert pretrained.results_home(box) == pretrained.results_home(find_checkpoint(box)) == Path("runs/pretrained")
    assert pretrained.results_home(Path("runs/mine")) == Path("runs/mine")
    assert (pretrained.named(box), pretrained.named(Path("runs/mine"))) == ("pretrained", "runs/mine")


def test_a_cell_is_driven_as_it_was_when_the_policy_was_shipped() -> None:
    """As the record on any processor; to the last bit on one, with another number of worker processes."""
    place, density, episodes = CELL["map"], CELL["density"], CELL["episodes"]
    options = ("--maps", place, "--density", density, "--episodes", len(episodes))
    result = run("eval", *options, "--workers", 0)
    assert result.exit_code == 0, result.output
    assert "this is the shipped policy, `pretrained`" in result.stderr
    folder = Path("runs/pretrained/eval") / f"{place}-{density}"
    logs = logs_in(folder)
    assert [(log.seed, len(log), log.ended) for log in logs] == [(e["seed"], e["steps"], e["ended"]) for e in episodes]
    for log, episode in zip(logs, episodes, strict=True):
        path = np.stack([log.steps["x"], log.steps["y"]], axis=1)[:: CELL["every"]]
        np.testing.assert_allclose(path, episode["path"], atol=NEAR)
    # Its results name it, so that a report finds it on another machine.
    assert json.loads((folder / "results.json").read_text())["run"] == "pretrained"
    assert run("eval", *options, "--workers", 2, "--out", "again").exit_code == 0
    assert [log.steps.tobytes() for log in logs_in(Path("again"))] == [log.steps.tobytes() for log in logs]


def logs_in(folder: Path) -> list[Episode]:
    return [load(path) for path in sorted(folder.glob("**/episodes/pretrained/*.npz"))]


def test_it_can_be_compared_filmed_and_reported() -> None:
    os.environ.setdefault("SDL_VIDEODRIVER", "dummy")
    options = ("--maps", "T3", "--density", "low", "--episodes", 1, "--workers", 0, "--reference", "idle")
    compared = run("eval", "--run", "pretrained", "--baseline", "idle", *options)
    assert compared.exit_code == 0, compared.output
    drive = run("drive", "--driver", "pretrained", "--map", "T3", "--density", "low", "--steps", 3)
    assert drive.exit_code == 0, drive.output
    assert run("report", "--clips", 0).exit_code == 0
    assert "me3bev eval --run pretrained" in Path("report/index.html").read_text()


def test_logs_are_collected_with_it() -> None:
    result = run("collect", "--driver", "pretrained", "--maps", "T3", "--episodes", 1, "--out", "logs")
    assert result.exit_code == 0, result.output
    assert [path.name for path in Path("logs").glob("*.mcap")] == ["T3-low-00000.mcap"]


def test_a_run_can_have_its_eyes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from me3bev_cli.training.takeover import begin_run, check_takeover

    recipe: Any = resolve_recipe("small/me3bev_gru")
    check_takeover(recipe, Path("pretrained"))
    begin_run(recipe, tmp_path / "gru", Path("pretrained"))
    taken = find_checkpoint(tmp_path / "gru")
    assert taken.name == "step_000032768"
    mine, theirs = (load_network(find_checkpoint(place), torch.device("cpu"))[0] for place in (taken, pretrained.box()))
    pairs = zip(mine.spatial.state_dict().values(), theirs.spatial.state_dict().values(), strict=True)
    assert all(torch.equal(a, b) for a, b in pairs)
    shutil.rmtree(tmp_path / "gru")

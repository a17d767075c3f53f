"""Figures from logs alone, and gates at the command line."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from scripted_world import RECIPE
from typer.testing import CliRunner, Result

from me3bev_cli.evaluation.definitions import METRICS
from me3bev_cli.evaluation.drivers import DriverSpec
from me3bev_cli.evaluation.player import Job, Method, Player
from me3bev_cli.evaluation.recompute import recover
from me3bev_cli.evaluation.runner import World
from me3bev_cli.main import app
from me3bev_cli.recipe_loading import resolve_recipe


def run(*arguments: object) -> Result:
    return CliRunner().invoke(app, ["eval", *map(str, arguments)])


@pytest.fixture
def evaluation(scripted: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A finished one of two drivers on two maps."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "by-script.yaml").write_text(RECIPE)
    options = ("--recipe", "by-script.yaml", "--maps", "M1,M2", "--episodes", 3, "--workers", 0, "--out", "done")
    result = run("--driver", "random", "--driver", "autopilot", *options, "--baseline", "autopilot")
    assert result.exit_code == 0, result.output
    return tmp_path / "done"


FIGURES = ("results.json", "results.csv", "results.md", "results.tex", "results.png")


def test_the_figures_follow_from_the_logs(evaluation: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before = {name: (evaluation / name).read_bytes() for name in FIGURES}
    # Nobody drives.
    monkeypatch.setattr(World, "open", lambda _: pytest.fail("a simulator was opened"))
    for name in FIGURES[1:]:
        (evaluation / name).unlink()
    result = run("--from-logs", "done", "--baseline", "autopilot")
    assert result.exit_code == 0, result.output
    assert {name: (evaluation / name).read_bytes() for name in FIGURES} == before
    assert result.stderr == ""


def test_two_evaluations_in_one_table(evaluation: Path) -> None:
    options = ("--recipe", "by-script.yaml", "--maps", "M1,M2", "--episodes", 3, "--workers", 0, "--out", "other")
    assert run("--driver", "idle", *options).exit_code == 0
    # Beside the logs there is the picture's snapshot, which is no log.
    assert (evaluation / "snapshot.npz").is_file()
    result = run("--from-logs", "done", "--from-logs", "other", "--baseline", "idle", "--out", "both")
    assert result.exit_code == 0, result.output
    assert "damaged" not in result.stderr
    rows = json.loads(Path("both/results.json").read_text())["rows"]
    assert {row["method"] for row in rows} == {"random", "autopilot", "idle"}


def test_logs_that_are_lost_are_named(evaluation: Path) -> None:
    logs = evaluation / "episodes" / "random"
    (logs / "M1-high-00001.npz").unlink()
    (logs / "M2-high-00002.npz").write_bytes((logs / "M2-high-00002.npz").read_bytes()[:-40])
    result = run("--from-logs", "done")
    assert result.exit_code == 0, result.output
    assert "M2-high-00002.npz: the log is damaged or truncated" in result.stderr
    assert "1 episode is missing in done" in result.stderr
    assert "the figures rest on the other 10 episodes" in result.stderr
    document = json.loads((evaluation / "results.json").read_text())
    assert len(document["lost"]) == 2
    counts = {(r["method"], r["map"]): r["n"] for r in document["rows"] if r["metric"] == "timesteps"}
    assert (counts["random", "M1"], counts["random", "M2"], counts["autopilot", "M1"]) == (2, 2, 3)


def test_results_of_chosen_logs_go_where_they_are_told(evaluation: Path, tmp_path: Path) -> None:
    result = run("--from-logs", "done/episodes/random", "--out", "mine", "--json", "all.json")
    assert result.exit_code == 0, result.output
    assert (tmp_path / "mine" / "results.json").read_bytes() == (tmp_path / "all.json").read_bytes()
    assert {row["method"] for row in json.loads((tmp_path / "all.json").read_text())["rows"]} == {"random"}
    again = run("--from-logs", "done/episodes/random", "--out", "mine")
    assert again.exit_code == 2
    assert "--out: mine exists and is not empty" in again.stderr
    # Without --out only the table is shown.
    alone = run("--from-logs", "done/episodes/random")
    assert "random, high density, 3 episodes per map" in alone.stdout
    assert "wrote" not in alone.stdout


@pytest.mark.parametrize("kind", ["empty", "damaged", "twice"])
def test_folders_without_a_whole_log(evaluation: Path, tmp_path: Path, kind: str) -> None:
    (tmp_path / "logs").mkdir()
    arguments: list[object] = ["--from-logs", "logs"]
    if kind == "damaged":
        (tmp_path / "logs" / "a.npz").write_bytes(b"PK")
    elif kind == "twice":
        arguments = ["--from-logs", "done/episodes/random", "--from-logs", "done"]
    result = run(*arguments)
    message = {
        "empty": "logs: the folder holds no log. Allowed: .npz, .mcap",
        "damaged": "none of the 1 logs is whole",
        "twice": "holds the same episode as done/episodes/random/M1-high-00000.npz",
    }[kind]
    assert result.exit_code == 2, result.output
    assert message in result.stderr


def test_a_recorded_episode_has_the_figures_of_the_drive(line_recipe: Path, tmp_path: Path) -> None:
    from me3bev_cli.evaluation.choice import world_of
    from me3bev_cli.evaluation.metrics import measure
    from me3bev_cli.recording.collect import Recorder, Take, collect

    recipe = resolve_recipe(line_recipe)
    world = world_of(recipe)
    recorder = Recorder(world, DriverSpec("random", "random"), 0, tmp_path / "logs")
    takes = [Take("F1", "low", number) for number in range(2)]
    collect(recorder, takes, 0)
    found = recover([tmp_path / "logs"], None, False)
    assert found.lost == []
    assert [(e.map, e.density, e.index, e.driver) for e in found.episodes] == [
        ("F1", "low", n, "random") for n in (0, 1)
    ]
    player = Player((Method(DriverSpec("random", "random"), world),), 0)
    for episode in found.episodes:
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr("me3bev_cli.evaluation.player.episode_seed", lambda *_, seed=episode.seed: seed)
            (driven,) = player(Job(0, "F1", "low", (episode.index,))).episodes
        assert repr(measure(episode)) == repr(measure(driven))
        assert episode.steps.tobytes() == driven.steps.tobytes()
        assert episode.ended == driven.ended


def test_a_recording_that_is_cut_off_is_no_episode(line_recipe: Path, tmp_path: Path) -> None:
    from me3bev_cli.evaluation.choice import world_of
    from me3bev_cli.recording.collect import Recorder, Take, collect

    world = world_of(resolve_recipe(line_recipe))
    collect(Recorder(world, DriverSpec("idle", "idle"), 0, tmp_path), [Take("F1", "low", n) for n in (0, 1)], 0)
    path = tmp_path / "F1-low-00001.mcap"
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    found = recover([tmp_path], None, False)
    assert [episode.index for episode in found.episodes] == [0]
    assert len(found.lost) == 1
    assert "F1-low-00001.mcap" in found.lost[0]


@pytest.mark.parametrize(("least", "code"), [(-1000, 0), (1e6, 3)])
def test_a_gate_at_the_command_line(evaluation: Path, tmp_path: Path, least: float, code: int) -> None:
    (tmp_path / "gate.yaml").write_text(f"thresholds:\n  - {{metric: return_per_step, at_least: {least:.0f}}}\n")
    result = run("--from-logs", "done", "--gate", "gate.yaml")
    assert result.exit_code == code, result.output
    if code:
        assert "fell short: random, average, high: return_per_step is" in result.stderr
        assert "should be at least 1e+06" in result.stderr
    else:
        assert "the gate is kept: 1 threshold" in result.stderr
    # The figures are written either way.
    assert "wrote done/results.json" in result.stdout


def test_a_gate_is_read_before_anything_is_driven(evaluation: Path, tmp_path: Path) -> None:
    (tmp_path / "gate.yaml").write_text("thresholds:\n  - {metric: return_per_step, at_least: 1, map: M9}\n")
    options = ("--driver", "idle", "--recipe", "by-script.yaml", "--maps", "M1", "--gate", "gate.yaml")
    result = run(*options, "--out", "gated")
    assert result.exit_code == 2
    assert "gate.yaml:2: thresholds.0.map: the map 'M9' is not evaluated. Allowed: M1" in result.stderr
    assert not (tmp_path / "gated").exists()


def test_the_metrics_are_listed(tmp_path: Path) -> None:
    result = CliRunner().invoke(app, ["metrics"])
    assert result.exit_code == 0
    assert "driving_score v1  driving score; 0-100; higher is better\n    100 x route completion x" in result.stdout
    result = CliRunner().invoke(app, ["metrics", "--json", "-"])
    listed: list[dict[str, Any]] = json.loads(result.stdout)["metrics"]
    assert [metric["name"] for metric in listed] == list(METRICS)
    assert set(listed[0]) == {"name", "version", "label", "unit", "direction", "formula", "source"}

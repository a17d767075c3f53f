"""`me3bev eval` as a user meets it."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from statistics import mean
from typing import Any

import pytest
from scripted_world import RECIPE
from typer.testing import CliRunner, Result

from me3bev_cli.evaluation.episode import Episode, load
from me3bev_cli.evaluation.metrics import METRICS, measure
from me3bev_cli.main import app


@pytest.fixture
def recipe(scripted: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "by-script.yaml"
    path.write_text(RECIPE)
    return path


def run(*arguments: object) -> Result:
    return CliRunner().invoke(app, ["eval", *map(str, arguments)])


def test_it_ends_with_a_table_and_files(recipe: Path, tmp_path: Path) -> None:
    result = run("--driver", "idle", "--recipe", recipe, "--maps", "M1-M2", "--episodes", 3, "--workers", 0)
    assert result.exit_code == 0, result.output
    assert "idle, high density, 3 episodes per map" in result.stdout
    assert "6/6 episodes" in result.stderr
    out = tmp_path / "runs" / "eval" / "idle-by-script" / "M1,M2-high"
    assert sorted(path.name for path in out.iterdir()) == [
        "episodes", "evaluation.json", "results.csv", "results.json", "results.md", "results.png", "results.tex",
        "snapshot.npz", "timing.json",
    ]  # fmt: skip
    for path in out.glob("results.*"):
        assert f"wrote {path}" in result.stdout
    assert (out / "results.png").read_bytes().startswith(b"\x89PNG")
    report = json.loads((out / "results.json").read_text())
    assert (report["method"], report["seed"], report["maps"]) == ("idle", 0, ["M1", "M2"])
    assert report["simulator_settings"] == {"horizon": 40}
    assert set(report["metrics"]) == set(METRICS)
    assert set(report["rows"][0]) == {"method", "map", "density", "metric", "mean", "low", "high", "n"}
    assert (report["weather"], report["by_weather"]) == (["dry"], [])
    # The rows follow from the logs.
    logs = [load(path) for path in sorted((out / "episodes" / "idle").glob("M1-*.npz"))]
    found = sum(measure(log)["timesteps"] for log in logs) / 3
    (row,) = [r for r in report["rows"] if (r["map"], r["metric"]) == ("M1", "timesteps")]
    assert row["mean"] == pytest.approx(found)
    assert row["n"] == 3


@pytest.mark.parametrize(("driver", "others"), [("random", (2, 4)), ("untrained", (2,))])
def test_the_same_seed_writes_the_same_bytes(
    recipe: Path, tmp_path: Path, driver: str, others: tuple[int, ...]
) -> None:
    options = ("--driver", driver, "--recipe", recipe, "--maps", "M1,M3", "--density", "low", "--episodes", 5)
    for workers in (1, *others):
        # Without what was kept of the driver before.
        shutil.rmtree(tmp_path / "runs", ignore_errors=True)
        result = run(*options, "--workers", workers, "--out", tmp_path / f"w{workers}")
        assert result.exit_code == 0, result.output
    for path in sorted((tmp_path / "w1").rglob("*")):
        if path.is_file() and path.name != "timing.json":
            for workers in others:
                assert path.read_bytes() == (tmp_path / f"w{workers}" / path.relative_to(tmp_path / "w1")).read_bytes()
    assert "NaN" not in (tmp_path / "w1" / "results.json").read_text()


def test_json_alone_is_on_stdout(recipe: Path, tmp_path: Path) -> None:
    copies = ("--csv", tmp_path / "rows.csv", "--picture", tmp_path / "bars.png")
    result = run(
        "--driver", "idle", "--recipe", recipe, "--maps", "M1", "--episodes", 1, "--workers", 0, "--json", "-", *copies
    )
    assert result.exit_code == 0, result.output
    assert json.loads(result.stdout)["method"] == "idle"
    assert "idle, high density, 1 episode" in result.stderr
    assert (tmp_path / "rows.csv").read_text().startswith("method,map,density,metric")
    assert (tmp_path / "bars.png").read_bytes().startswith(b"\x89PNG")


def test_an_untrained_policy_drives(recipe: Path) -> None:
    result = run("--driver", "untrained", "--recipe", recipe, "--maps", "M1", "--episodes", 1, "--workers", 0)
    assert result.exit_code == 0, result.output
    assert "untrained-by-script, high density, 1 episode" in result.stdout


def results(out: Path) -> tuple[dict[str, Any], list[Episode]]:
    return json.loads((out / "results.json").read_text()), [load(path) for path in sorted(out.glob("episodes/*/*.npz"))]


def test_several_kinds_of_weather_are_drawn_and_scored_apart(recipe: Path, tmp_path: Path) -> None:
    options = ("--driver", "idle", "--recipe", recipe, "--maps", "M1,M2", "--workers", 0, "--episodes", 8)
    result = run(*options, "--weather", "all")
    assert result.exit_code == 0, result.output
    report, logs = results(tmp_path / "runs" / "eval" / "idle-by-script" / "M1,M2-high-dry,wet,white")
    assert report["weather"] == ["dry", "wet", "white"]
    assert {log.weather for log in logs} == {"dry", "wet", "white"}
    assert "idle, high density, 8 episodes per map" in result.stdout
    assert "idle, high density, by weather (episodes)" in result.stdout
    wet = [log for log in logs if log.weather == "wet"]
    (row,) = [
        row
        for row in report["by_weather"]
        if (row["weather"], row["map"], row["metric"]) == ("wet", "average", "timesteps")
    ]
    means = [mean(len(log) for log in wet if log.map == map) for map in ("M1", "M2")]
    assert (row["mean"], row["n"]) == (pytest.approx(mean(means)), len(wet))
    # The rows by map and density are those of all episodes, as ever.
    assert sum(row["n"] for row in report["rows"] if (row["map"], row["metric"]) == ("M1", "timesteps")) == 8


def test_the_same_drives_are_paired_over_weather(recipe: Path, tmp_path: Path) -> None:
    drives = []
    for weather in ("dry", "white", "white,wet"):
        out = tmp_path / weather
        options = ("--driver", "random", "--recipe", recipe, "--maps", "M1", "--workers", 0, "--episodes", 4)
        assert run(*options, "--weather", weather, "--out", out).exit_code == 0
        drives.append([(log.seed, log.steps.tobytes()) for log in results(out)[1]])
    assert drives[0] == drives[1] == drives[2]


def test_the_recipes_sets_are_used(recipe: Path, tmp_path: Path) -> None:
    recipe.write_text(RECIPE + "weather: {training: [wet], evaluation: [white, dry]}\n")
    options = ("--driver", "idle", "--recipe", recipe, "--maps", "M1", "--workers", 0, "--episodes", 1)
    for given, found, name in (
        ((), ["white", "dry"], "M1-high"),
        (("--weather", "evaluation"), ["white", "dry"], "M1-high-white,dry"),
        (("--weather", "training"), ["wet"], "M1-high-wet"),
        (("--weather", "training,dry"), ["wet", "dry"], "M1-high-wet,dry"),
    ):
        assert run(*options, *given).exit_code == 0
        out = tmp_path / "runs" / "eval" / "idle-by-script" / name
        assert results(out)[0]["weather"] == found


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ("--run nowhere", "nowhere is not a run folder"),
        ("--driver autopilt", "--driver: unknown driver 'autopilt'; did you mean 'autopilot'"),
        ("--driver idle --episodes 0", "--episodes: 0 is too few"),
        ("--driver idle --workers -1", "--workers: -1 is negative"),
        ("--driver untrained --recipe by-script.yaml --device gpu", "--device: unknown device 'gpu'"),
        ("--driver untrained", "an untrained policy needs a recipe. Give --recipe RECIPE or --run RUN"),
        ("--recipe by-script.yaml", "--recipe: a recipe alone is not a driver. Give --driver too"),
        ("--driver idle --recipe by-script.yaml --maps M7", "--maps: unknown map 'M7'"),
        (
            "--driver idle --recipe by-script.yaml --density hgih",
            "--density: unknown density 'hgih'; did you mean 'high'",
        ),
        (
            "--driver idle --recipe by-script.yaml --weather dyr",
            "--weather: unknown weather 'dyr'; did you mean 'dry'?",
        ),
        ("--driver idle --recipe by-script.yaml --weather ,", "--weather: no name is given"),
        (
            "--driver idle --weather training",
            "--weather: there is no recipe that has a set for training. Give --recipe or --run, or name the weather",
        ),
        ("--driver idle --recipe by-script.yaml --reference idel", "--reference: unknown reference driver 'idel'; did"),
        ("--driver idle --recipe by-script.yaml --reference ,", "--reference: no name is given"),
        ("--driver idle --recipe by-script.yaml --baseline rnadom", "--baseline: unknown method or run 'rnadom'"),
        ("--from-logs nowhere", "nowhere: there is no such folder of logs"),
        ("--from-logs . --driver idle", "--from-logs: logs have been driven already. Leave out --run and --driver"),
        ("--driver idle --recipe by-script.yaml --gate gate.yaml", "gate.yaml: cannot be read: No such file"),
        ("--driver idle --recipe by-script.yaml --out .", "holds something other than an evaluation"),
        ("--driver idle --recipe by-script.yaml --out by-script.yaml", "is not a folder"),
    ],
)
def test_mistakes(recipe: Path, tmp_path: Path, options: str, message: str) -> None:
    before = sorted(tmp_path.rglob("*"))
    result = run(*options.split())
    assert result.exit_code == 2, result.output
    assert message.format(tmp=tmp_path) in result.stderr
    assert result.stdout == ""
    assert sorted(tmp_path.rglob("*")) == before


def test_a_damaged_checkpoint(recipe: Path, tmp_path: Path) -> None:
    checkpoint = tmp_path / "runs" / "mine" / "checkpoints" / "step_000000010"
    checkpoint.mkdir(parents=True)
    for folder in (checkpoint, checkpoint.parents[1]):
        (folder / "recipe.yaml").write_text(RECIPE)
    (checkpoint.parents[1] / "metrics.jsonl").touch()
    without = run("--maps", "M1", "--checkpoint", "last")
    assert without.exit_code == 2
    assert "has no checkpoint" in without.stderr
    (checkpoint / "progress.json").write_text("{}")
    (checkpoint / "policy.safetensors").write_bytes(b"\x00" * 20)
    for more in ((), ("--overwrite",)):
        result = run("--maps", "M1", "--episodes", 1, "--workers", 1, *more)
        assert result.exit_code == 2, result.output
        assert "policy.safetensors is damaged or truncated" in result.stderr
        assert not (tmp_path / "runs" / "mine" / "eval").exists()

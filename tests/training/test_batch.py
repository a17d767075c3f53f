"""Batches: several recipes and seeds, resumable as a whole, stopped as a whole; runs at a glance."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner, Result

from me3bev_cli.errors import RunError, UserError
from me3bev_cli.main import app
from me3bev_cli.training import batch
from me3bev_cli.training.batch import parse_seeds, prepare, shares
from me3bev_cli.training.checkpoint import find_checkpoint, load_progress
from me3bev_cli.training.listing import describe, find_runs, state_of
from me3bev_cli.training.run import training_in

STAND_IN = """
import json, os, signal, sys, time
from pathlib import Path

run = Path(sys.argv[sys.argv.index("--resume") + 1])
note = run.parent / "notes"
note.mkdir(exist_ok=True)
with open(note / run.name, "a") as file:
    told = {"cores": len(os.sched_getaffinity(0)), "threads": os.environ.get("OMP_NUM_THREADS")}
    file.write(json.dumps(told) + "\\n")
(run / "metrics.jsonl").write_text(json.dumps({"stage": 0, "steps": 96, "reward_per_step": 1.5}) + "\\n")
mode = os.environ.get("MODE_" + run.name.replace("-", "_"), "")
if mode == "fail":
    sys.exit(3)
if mode == "wait":
    def stop(*_):
        (run / "stopped").write_text("")
        sys.exit(130)
    signal.signal(signal.SIGINT, stop)
    (run / "waiting").write_text("")
    time.sleep(60)
(run / "summary.json").write_text("{}")
"""
"""Stands in for `me3bev train --resume RUN`: what a batch does with its runs needs no training."""


@pytest.fixture
def stand_in(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    script = tmp_path / "stand_in.py"
    script.write_text(STAND_IN)
    monkeypatch.setattr(batch, "COMMAND", (sys.executable, str(script)))
    monkeypatch.setattr(batch, "LOOK_EVERY", 0.01)


def train(*arguments: Any) -> Result:
    return CliRunner().invoke(app, ["train", *map(str, arguments)], catch_exceptions=False)


def notes(out: Path) -> dict[str, int]:
    """How often each run was started."""
    return {path.name: len(path.read_text().splitlines()) for path in (out / "notes").iterdir()}


def test_seeds() -> None:
    assert parse_seeds("0,2, 7") == [0, 2, 7]
    assert parse_seeds("1-3,2") == [1, 2, 3]
    for wrong in ("", "a", "3-1", "-1", "1,,2"):
        with pytest.raises(UserError, match="names no seeds"):
            parse_seeds(wrong)


def test_cores_are_shared_out(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 1, 2, 3, 4})
    assert shares(1) == [{0, 1, 2, 3, 4}]
    assert shares(2) == [{0, 1}, {2, 3, 4}]
    assert shares(7) == [{0}, {1}, {2}, {3}, {4}, {0}, {1}]


def test_every_recipe_with_every_seed(stand_in: None, line_recipe: Path, tmp_path: Path) -> None:
    other = tmp_path / "other.yaml"
    other.write_text(line_recipe.read_text().replace("name: line\n", "name: other\n", 1))
    out = tmp_path / "out"
    result = train(line_recipe, other, "--seeds", "0,1", "--out", out, "--parallel", "2", "--json", "-")
    assert result.exit_code == 0
    names = ["line-seed0", "line-seed1", "other-seed0", "other-seed1"]
    assert [Path(row["run"]).name for row in json.loads(result.stdout)["runs"]] == names
    assert all(row["state"] == "finished" for row in json.loads(result.stdout)["runs"])
    assert "line-seed1" in result.stderr
    assert notes(out) == dict.fromkeys(names, 1)
    # The same command has nothing left to do.
    assert train(line_recipe, other, "--seeds", "0,1", "--out", out).exit_code == 0
    assert notes(out) == dict.fromkeys(names, 1)


def test_each_run_has_its_share_of_threads(stand_in: None, line_recipe: Path, tmp_path: Path) -> None:
    before = os.sched_getaffinity(0)
    train(line_recipe, "--seeds", "0-1", "--out", tmp_path / "out", "--parallel", "2")
    told = [json.loads((tmp_path / "out" / "notes" / f"line-seed{k}").read_text()) for k in range(2)]
    expected = [len(cores) for cores in shares(2)]
    assert [one["cores"] for one in told] == expected
    assert [one["threads"] for one in told] == [str(number) for number in expected]
    assert os.sched_getaffinity(0) == before


def test_a_failure_stops_no_other(
    stand_in: None, line_recipe: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "out"
    monkeypatch.setenv("MODE_line_seed0", "fail")
    result = train(line_recipe, "--seeds", "0,1", "--out", out, "--json", tmp_path / "rows.json")
    assert result.exit_code == 1
    assert "1 of 2 runs failed" in result.stderr
    report = json.loads((tmp_path / "rows.json").read_text())
    assert [row["state"] for row in report["runs"]] == ["stopped", "finished"]
    assert report["failed"] == [str(out / "line-seed0")]
    # The folder alone says what is left to do.
    monkeypatch.delenv("MODE_line_seed0")
    assert train("--resume", out).exit_code == 0
    assert notes(out) == {"line-seed0": 2, "line-seed1": 1}


def test_ctrl_c_stops_all(stand_in: None, line_recipe: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    out = tmp_path / "out"
    for name in ("MODE_line_seed0", "MODE_line_seed1"):
        monkeypatch.setenv(name, "wait")

    def press() -> None:
        while not all((out / f"line-seed{k}" / "waiting").exists() for k in range(2)):
            time.sleep(0.05)
        time.sleep(0.3)
        os.kill(os.getpid(), signal.SIGINT)

    monkeypatch.setattr(batch, "TELL_EVERY", 0.0)
    threading.Thread(target=press, daemon=True).start()
    result = train(line_recipe, "--seeds", "0,1,2", "--parallel", "2", "--out", out)
    assert result.exit_code == 130
    assert "the same command goes on" in result.stderr
    assert f"{out / 'line-seed0'}: stage 1/1 ppo, step 96 of 192, reward/step 1.50" in result.stderr
    assert all((out / f"line-seed{k}" / "stopped").exists() for k in range(2))
    assert state_of(out / "line-seed2") == "new"


def test_folders_of_other_recipes_are_left_alone(line_recipe: Path, tmp_path: Path) -> None:
    prepare([str(line_recipe)], "0", [], tmp_path / "out")
    with pytest.raises(RunError, match="line-seed0 is a run of another recipe"):
        prepare([str(line_recipe)], "0", ["stages.0.steps=64"], tmp_path / "out")
    with pytest.raises(UserError, match="two runs would be named line-seed0"):
        prepare([str(line_recipe)] * 2, "0", [], tmp_path / "more")
    assert not (tmp_path / "more").exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "name a recipe"),
        (["RECIPE", "--resume", "x"], "name a recipe"),
        (["RECIPE", "--parallel", "2"], "there is one run only"),
        (["--resume", "x", "--seeds", "1"], "goes on with its own recipe"),
        (["--resume", "nowhere"], "there is no run at nowhere"),
    ],
)
def test_mistakes_are_named(line_recipe: Path, arguments: list[str], message: str) -> None:
    result = train(*[str(line_recipe) if word == "RECIPE" else word for word in arguments])
    assert result.exit_code == 2
    assert message in result.stderr


def test_it_really_trains(line_recipe: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    here = Path(__file__).parent.parent
    start = f"import sys; sys.path.insert(0, {str(here)!r}); import fakes; fakes.install_for_good()"
    command = (sys.executable, "-c", f"{start}; from me3bev_cli.main import main; main()")
    monkeypatch.setattr(batch, "COMMAND", command)
    out = tmp_path / "out"
    result = train(line_recipe, "--seeds", "5", "--set", "stages.0.steps=64", "--out", out)
    assert result.exit_code == 0, result.stderr
    assert load_progress(find_checkpoint(out / "line-seed5")).done
    kept = json.loads((out / "line-seed5" / "versions.json").read_text())
    assert kept["seed"] == 5
    assert {"python", "torch", "me3bev"} <= set(kept["versions"])


def make(run: Path, **files: str) -> Path:
    run.mkdir(parents=True)
    (run / "recipe.yaml").write_text(
        "name: mine\nseed: 4\nstages: [{kind: ppo, steps: 100}, {kind: ppo, steps: 300}]\n"
    )
    (run / "metrics.jsonl").write_text("")
    for name, text in files.items():
        (run / name.replace("_", ".")).write_text(text)
    return run


def test_runs_at_a_glance(tmp_path: Path) -> None:
    rows = [{"stage": 1, "steps": 150 + k, "reward_per_step": float(k)} for k in range(12)]
    log = "".join(json.dumps(row) + "\n" for row in rows) + '{"stage": 1, "st'
    run = make(tmp_path / "a", metrics_jsonl=log)
    best = run / "checkpoints" / "best_000000150"
    best.mkdir(parents=True)
    (best / "evaluation.json").write_text(json.dumps({"steps": 150, "eval_score": 33.5}))
    entry = describe(run)
    assert (entry.recipe, entry.seed, entry.state) == ("mine", 4, "stopped")
    assert (entry.stage, entry.steps, entry.total) == ("2/2 ppo", 161, 400)
    # The mean of 2 to 11.
    assert (entry.reward_per_step, entry.best_score, entry.best_steps) == (6.5, 33.5, 150)
    with training_in(run):
        assert state_of(run) == "running"
        with pytest.raises(RunError, match="is being trained by another process"), training_in(run):
            pass
    assert state_of(run) == "stopped"
    assert state_of(make(tmp_path / "b", summary_json="{}")) == "finished"
    assert state_of(make(tmp_path / "c")) == "new"


def test_a_killed_run_is_not_running(tmp_path: Path) -> None:
    run = make(tmp_path / "a")
    code = (
        "import os, sys; from pathlib import Path; from me3bev_cli.training.run import training_in\n"
        "with training_in(Path(sys.argv[1])): print('held', flush=True); os.read(0, 1)"
    )
    holder = subprocess.Popen(
        [sys.executable, "-c", code, str(run)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert holder.stdout is not None
    assert holder.stdout.readline() == "held\n"
    assert state_of(run) == "running"
    holder.kill()
    holder.wait()
    assert state_of(run) == "new"


def test_runs_lists_batches_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # Short paths: long ones are folded, wherever that is.
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("ME3BEV_RUNS", ".")
    make(tmp_path / "alone")
    make(tmp_path / "batch" / "mine-seed4")
    make(tmp_path / "batch" / ".hidden")
    assert {run.name for run in find_runs(tmp_path)} == {"alone", "mine-seed4"}
    result = CliRunner().invoke(app, ["runs", "--json", "-"], catch_exceptions=False)
    assert {Path(row["run"]).name for row in json.loads(result.stdout)["runs"]} == {"alone", "mine-seed4"}
    assert "mine-seed4" in result.stderr
    assert "0/400" in result.stderr
    empty = CliRunner().invoke(app, ["runs", str(tmp_path / "alone" / "nothing")])
    assert empty.exit_code == 2


HEAVY = ("torch", "numpy", "matplotlib", "stable_baselines3", "gymnasium")


@pytest.mark.parametrize("arguments", [["--help"], ["runs"], ["train", "--help"], ["plot", "--help"]])
def test_what_only_looks_loads_nothing_heavy(arguments: list[str], tmp_path: Path) -> None:
    make(tmp_path / "a")
    code = (
        "import sys\nfrom me3bev_cli.main import app\n"
        f"try:\n    app({arguments!r})\nexcept SystemExit as end:\n    assert not end.code\n"
        f"print([name for name in {HEAVY!r} if name in sys.modules], file=sys.stderr)"
    )
    environment = os.environ | {"ME3BEV_RUNS": str(tmp_path)}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=environment)
    assert done.stderr.splitlines()[-1] == "[]", done.stderr

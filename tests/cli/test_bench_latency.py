"""`me3bev bench-latency` as it is called: what it prints and writes, exit codes, mistakes, Ctrl-C."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from me3bev_cli.bench import latency_session, machine_ceilings
from me3bev_cli.bench.latency_network import STAGES
from me3bev_cli.main import app
from me3bev_cli.pipeline.assemble import build_network
from me3bev_cli.recipe_loading import dump, resolve_recipe
from me3bev_cli.stopping import Stop
from me3bev_cli.training.checkpoint import Progress, save_checkpoint
from me3bev_cli.training.run import make_run

FEW = ("--repeats", "2", "--warmup", "1", "--device", "cpu", "--threads", "1")


@pytest.fixture(autouse=True)
def _in_a_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Small ceilings, and a folder of one's own."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(machine_ceilings.SIDE, "cpu", 32)
    monkeypatch.setitem(machine_ceilings.READ_BYTES, "cpu", 1 << 16)


def run(*arguments: Any) -> Any:
    return CliRunner().invoke(app, ["bench-latency", *map(str, arguments)], catch_exceptions=False)


def test_figures_as_json_csv_and_picture(line_recipe: Path) -> None:
    result = run(line_recipe, *FEW, "--context", "2,8", "--json", "-", "--csv", "l.csv", "--plot", "l.png")
    assert result.exit_code == 0
    data = json.loads(result.stdout)
    assert [(row["context"], row["length"]) for row in data["rows"]] == [
        ("window", 2), ("window", 8), ("stream", 2), ("stream", 8),
    ]  # fmt: skip
    for row in data["rows"]:
        assert set(row["stages"]) == set(STAGES)
        assert min(row[key] for key in ("median_ms", "p95_ms", "p99_ms", "floor_ratio", "peak_memory_bytes")) > 0
    assert data["setup"] | {"threads": 1, "batch": 1, "device": "cpu", "dtype": "float32"} == data["setup"]
    assert data["ceilings"]["multiply_flops_per_s"] > 0
    assert data["ceilings"]["read_bytes_per_s"] > 0
    assert data["stopped"] is False
    assert Path("l.csv").read_text().count("\n") == 5
    assert Path("l.png").read_bytes().startswith(b"\x89PNG")
    for text in ("timed:", "not timed:", "ceilings:", "1 thread, float32, batch 1", "by context", "wrote l.png"):
        assert text in result.stderr


def test_tables_go_to_stdout_and_files_are_written_when_asked(line_recipe: Path) -> None:
    before = set(Path().iterdir())
    result = run(line_recipe, *FEW, "--context", "4", "--batch", "2", "--dtype", "bf16")
    assert result.exit_code == 0
    assert "1 thread, bfloat16, batch 2" in result.stdout
    assert "window 4" in result.stdout
    assert set(Path().iterdir()) == before


def test_every_pair_without_names(line_recipe: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from me3bev_cli.bench.latency_subjects import named

    monkeypatch.setattr(
        latency_session, "every_pair", lambda: (named([str(line_recipe)]), ["temporal plugin 'x': its config needs y"])
    )
    result = run(*FEW, "--context", "4", "--json", "out.json")
    assert result.exit_code == 0
    assert "me3bev: left out: temporal plugin 'x': its config needs y\n" in result.stderr
    report = json.loads(Path("out.json").read_text())
    assert report["left_out"] == ["temporal plugin 'x': its config needs y"]
    assert "no run is named: `pretrained`, the shipped policy, stands beside every pair" in result.stderr
    assert "pretrained" in {row["name"] for row in report["rows"]}


def test_a_budget(line_recipe: Path) -> None:
    assert run(line_recipe, *FEW, "--context", "4", "--budget-ms", "1e6").exit_code == 0
    over = run(line_recipe, *FEW, "--context", "4", "--budget-ms", "1e-6", "--json", "out.json")
    assert over.exit_code == 3
    assert "me3bev: over the budget of 1e-06 ms at the 95th percentile: line window 4 (" in over.stderr
    assert "line stream 4 (" in over.stderr
    assert Path("out.json").exists()


def test_without_contexts_the_budget_is_for_the_recipes_own(line_recipe: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("me3bev_cli.bench.latency_memory.LENGTHS", (2, 4))
    over = run(line_recipe, *FEW, "--budget-ms", "1e-6")
    assert over.exit_code == 3
    assert "line window 4 (" in over.stderr
    assert "window 2 (" not in over.stderr
    assert "stream" not in over.stderr


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["nosuch"], "unknown recipe 'nosuch'"),
        (["quickstart", "--context", "4,x"], "--context: 'x' is no number of frames. Allowed: as 4,16,64; 1 to 65536"),
        (["quickstart", "--context", "0"], "--context: '0' is no number of frames"),
        (["quickstart", "--context", ""], "--context: '' is no number of frames"),
        (["quickstart", "--dtype", "fp8"], "--dtype: unknown dtype 'fp8'. Allowed: bf16, fp32"),
        (["quickstart", "--device", "tpu"], "device 'tpu' is not available here. Allowed: auto, cpu"),
        (["quickstart", "--budget-ms", "-1"], "--budget-ms: -1 ms is no budget"),
        (["quickstart", "--budget-ms", "nan"], "--budget-ms: nan ms is no budget"),
        (["quickstart", "--with-scores"], "--with-scores: no run that is compared has been evaluated"),
        (["--with-scores"], "--with-scores: there is no evaluated run under runs"),
        (["quickstart", "--batch", "0"], "Invalid value for '--batch'"),
    ],
)
def test_mistakes(arguments: list[str], message: str) -> None:
    result = run(*arguments)
    assert result.exit_code == 2
    assert message in " ".join(result.stderr.split())
    assert "Traceback" not in result.output


def test_runs_with_scores(line_recipe: Path) -> None:
    """Every evaluated run, by their weights; the picture and the table are drawn from their results."""
    recipe = resolve_recipe(line_recipe)
    for name, mean in (("good", 80.0), ("bad", 20.0), ("unscored", None)):
        folder = Path("runs") / name
        make_run(folder, dump(recipe))
        save_checkpoint(folder, build_network(recipe, 0).state_dict(), recipe, Progress(total_steps=1), {})
        if mean is not None:
            row = {"map": "F1", "density": "low", "metric": "driving_score", "mean": mean, "low": 1, "high": 99, "n": 5}
            data = {"driver": "policy", "checkpoint": "x", "maps": ["F1"], "episodes": 5, "seed": 0, "rows": [row]}
            (folder / "eval" / "F1-low").mkdir(parents=True)
            (folder / "eval" / "F1-low" / "results.json").write_text(json.dumps(data))
    result = run(*FEW, "--with-scores", "--context", "4", "--json", "out.json")
    assert result.exit_code == 0
    data = json.loads(Path("out.json").read_text())
    assert {row["name"] for row in data["rows"]} == {"good", "bad"}
    found = {score["run"]: score for score in data["scores"]}
    assert found["good"]["front"] is True
    assert (found["good"]["score"], found["bad"]["score"]) == (80, 20)
    assert found["good"]["context"] == "window 4"
    assert "speed and driving score: F1, low; 5 episodes per map, seed 0" in result.stdout
    assert Path("latency-scores.png").read_bytes().startswith(b"\x89PNG")


def test_ctrl_c_prints_what_has_been_measured(line_recipe: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Stopped(Stop):
        """As if Ctrl-C came during the second round."""

        def __init__(self) -> None:
            self.questions = 0

        @property
        def asked(self) -> bool:  # type: ignore[override]
            self.questions += 1
            return self.questions > 3

    monkeypatch.setattr(latency_session, "Stop", Stopped)
    result = run(line_recipe, *FEW, "--context", "4", "--json", "out.json")
    assert result.exit_code == 130
    assert "me3bev: stopped: the figures are those of what had been measured" in result.stderr
    data = json.loads(Path("out.json").read_text())
    assert data["stopped"] is True
    assert [row["calls"] for row in data["rows"]] == [1, 1]
    assert "window 4" in result.stdout


def test_ctrl_c_before_anything_was_measured(line_recipe: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Stopped(Stop):
        """As if Ctrl-C came at once."""

        def __init__(self) -> None:
            self.asked = True

    monkeypatch.setattr(latency_session, "Stop", Stopped)
    result = run(line_recipe, *FEW, "--json", "out.json")
    assert (result.exit_code, result.stdout) == (130, "")
    assert "me3bev: stopped: nothing has been measured yet" in result.stderr
    assert not Path("out.json").exists()

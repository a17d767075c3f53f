"""Fixtures of the report's tests: evaluations on the fake world of `fakes.py`, which take no time."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from typer.testing import CliRunner

from me3bev_cli.main import app
from me3bev_cli.pipeline.assemble import build_network
from me3bev_cli.recipe_loading import dump, resolve_recipe
from me3bev_cli.training.checkpoint import Progress, save_checkpoint
from me3bev_cli.training.run import make_run

sys.path.insert(0, str(Path(__file__).parents[1] / "evaluation" / "support"))

OPTIONS = ("--maps", "F1,F2", "--density", "low,high", "--episodes", "3", "--workers", "0")


@pytest.fixture
def evaluated(line_recipe: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., Path]:
    """Makes a run by name, with a log of its training, and evaluates it beside `random` and `idle`."""
    monkeypatch.chdir(line_recipe.parent)
    monkeypatch.setenv("ME3BEV_RUNS", str(line_recipe.parent / "runs"))

    def make(name: str, *overrides: str, options: tuple[str, ...] = OPTIONS) -> Path:
        run = Path("runs") / name
        recipe = resolve_recipe(line_recipe, overrides)
        make_run(run, dump(recipe))
        lines = [
            {"stage": 0, "kind": "ppo", "steps": 32 * n, "reward_per_step": 0.1 * n, "eval_score": 2.0 * n}
            for n in range(1, 7)
        ]
        (run / "metrics.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))
        save_checkpoint(run, build_network(recipe, recipe.seed).state_dict(), recipe, Progress(total_steps=192), {})
        done = CliRunner().invoke(app, ["eval", "--run", str(run), "--reference", "random,idle", *options])
        assert done.exit_code == 0, done.output
        return run

    return make

"""Runs of tiny policies that have not learned anything, and logs that they fit."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from me3bev_cli.evaluation.drivers import DriverSpec
from me3bev_cli.evaluation.runner import World
from me3bev_cli.pipeline.assemble import build_network
from me3bev_cli.recipe import PluginChoice
from me3bev_cli.recipe_loading import dump, resolve_recipe
from me3bev_cli.recording.collect import Recorder, Take, collect
from me3bev_cli.recording.writer import Options
from me3bev_cli.training.checkpoint import Progress, save_checkpoint
from me3bev_cli.training.run import make_run

MakeRun = Callable[..., Path]
MakeLogs = Callable[..., Path]


@pytest.fixture
def make_run_of(line_recipe: Path, tmp_path: Path) -> MakeRun:
    """Makes a run with one checkpoint, from the line recipe and `--set` texts."""

    def make(*changes: str, name: str = "run") -> Path:
        recipe = resolve_recipe(line_recipe, list(changes))
        run = tmp_path / name
        make_run(run, dump(recipe))
        save_checkpoint(run, build_network(recipe, recipe.seed).state_dict(), recipe, Progress(total_steps=64), {})
        return run

    return make


@pytest.fixture
def make_logs_of(tmp_path: Path) -> MakeLogs:
    """Records episodes of what a run's policy sees."""

    def make(run: Path, folder: str = "logs", episodes: int = 2, width: int | None = None, truth: bool = True) -> Path:
        observation = resolve_recipe(run / "recipe.yaml").observation
        if width is not None:
            observation = observation.model_copy(update={"width": width})
        takes = [Take("F1", "low", number) for number in range(episodes)]
        recorder = Recorder(
            World(PluginChoice(name="line"), observation),
            DriverSpec("autopilot", "autopilot"),
            0,
            tmp_path / folder,
            Options(depth=truth, semantics=truth),
        )
        collect(recorder, takes, workers=0)
        return tmp_path / folder

    return make

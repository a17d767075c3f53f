"""Perception learned from recorded episodes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from me3bev_cli.errors import LogError
from me3bev_cli.evaluation.drivers import DriverSpec
from me3bev_cli.evaluation.runner import World
from me3bev_cli.perception.frames import Frames, FrameSource, Job
from me3bev_cli.perception.truth import DepthBins, seen_in
from me3bev_cli.pipeline.assemble import configured
from me3bev_cli.recipe import PluginChoice
from me3bev_cli.recipe_loading import dump, resolve_recipe
from me3bev_cli.recording.collect import Recorder, Take, collect
from me3bev_cli.recording.writer import Options
from me3bev_cli.stopping import Stop
from me3bev_cli.training.curve import read_metrics
from me3bev_cli.training.display import Display
from me3bev_cli.training.run import make_run
from me3bev_cli.training.trainer import Trainer

BINS = DepthBins((2.0, 8.0, 30.0), (2, 4), (16, 32))


def record(line_recipe: Path, folder: Path, options: Options, **changed: Any) -> list[Path]:
    observation = resolve_recipe(line_recipe).observation.model_copy(update=changed)
    world = World(PluginChoice(name="line"), observation)
    takes = [Take("F1", "low", number) for number in range(3)]
    collect(Recorder(world, DriverSpec("autopilot", "autopilot"), 0, folder, options), takes, workers=0)
    return sorted(folder.glob("*.mcap"))


def read(line_recipe: Path, log: Path, steps: int) -> Frames:
    recipe = resolve_recipe(line_recipe)
    cls, config = configured("simulator", recipe.simulator)
    source = FrameSource(cls(config), recipe.observation, "low", None, every=4, noise=0.0, depth=BINS)
    return source(Job((), steps, "F1", log))


def test_frames_of_a_log_are_those_that_were_recorded(line_recipe: Path, tmp_path: Path) -> None:
    frames = read(line_recipe, record(line_recipe, tmp_path, Options(0, depth=True, semantics=True))[0], 100)
    assert (frames.steps, frames.images.shape) == (12, (3, 2, 3, 16, 32))
    # The line world's depth is 5 m and a metre more each step, in the lower half of the pictures.
    assert frames.depth[:, 0, :, 1, 0].tolist() == [[255, 0], [0, 255], [0, 255]]
    assert not frames.depth[:, :, :, 0].any()
    assert seen_in(frames.maps).any()


def test_logs_without_depth_tell_of_no_sight(line_recipe: Path, tmp_path: Path) -> None:
    frames = read(line_recipe, record(line_recipe, tmp_path, Options(0))[0], 6)
    assert (frames.steps, len(frames)) == (6, 2)
    assert not frames.depth.any()
    assert not seen_in(frames.maps).any()
    assert np.unique(frames.maps).tolist() == [0, 1, 6]


@pytest.mark.parametrize(
    ("changed", "told"),
    [
        ({"width": 64}, "the images are 16 x 64"),
        ({"cameras": ("back", "front")}, "the log has the cameras back, front"),
    ],
)
def test_logs_of_other_eyes_are_refused(line_recipe: Path, tmp_path: Path, changed: dict[str, Any], told: str) -> None:
    with pytest.raises(LogError, match=told):
        read(line_recipe, record(line_recipe, tmp_path, Options(0), **changed)[0], 6)


def test_a_stage_learns_from_logs(line_recipe: Path, overrides: list[str], run: Path, tmp_path: Path) -> None:
    record(line_recipe, tmp_path / "logs", Options(0))
    recipe = resolve_recipe(line_recipe, [*overrides, f"stages.0.logs={tmp_path / 'logs'}", "stages.0.steps=40"])
    make_run(run, dump(recipe))
    Trainer(recipe, run, Display(40, 1), Stop()).train()
    # Two logs of 12 steps each, the third one held out; a stretch takes no more than what is left of the budget.
    rows = read_metrics(run)
    assert [row["steps"] for row in rows] == [24, 36, 40]
    assert "near_road" in rows[-1]
    assert "seen_road" not in rows[-1]

"""Runs on the fake world of `fakes.py`, for tests of what stands around training."""

from __future__ import annotations

import io
from pathlib import Path

from me3bev_cli.recipe_loading import dump, resolve_recipe
from me3bev_cli.stopping import Stop
from me3bev_cli.training.display import Display
from me3bev_cli.training.run import make_run
from me3bev_cli.training.trainer import Trainer


def line_trainer(path: Path, run: Path, *overrides: str) -> Trainer:
    """A trainer for a new run, or for one that goes on, which shows nothing."""
    recipe = resolve_recipe(path, overrides)
    if not run.exists():
        make_run(run, dump(recipe))
    display = Display(sum(s.steps for s in recipe.stages), len(recipe.stages), stream=io.StringIO())
    return Trainer(recipe, run, display, Stop())

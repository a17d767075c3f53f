"""A new run that begins where another one's perception ended: eyes are trained once, for all that drive with them.

Perception moves the spatial part alone, and depends on nothing but the keys that are compared here. So what comes out
is what the new run would have learned by itself, to the last bit on a CPU.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from safetensors import SafetensorError
from safetensors.torch import load_file
from torch import Tensor

from me3bev_cli.errors import CheckpointError, RunError
from me3bev_cli.files import atomic_write_bytes, atomic_write_text
from me3bev_cli.perception.model import HEAD
from me3bev_cli.pipeline.assemble import build_network
from me3bev_cli.pretrained import find_run
from me3bev_cli.recipe import Recipe
from me3bev_cli.recipe_diff import differences, run_recipe, shown
from me3bev_cli.recipe_loading import dump
from me3bev_cli.training.checkpoint import WEIGHTS, Progress, checkpoints, load_progress, save_checkpoint
from me3bev_cli.training.curve import read_metrics
from me3bev_cli.training.journal import METRICS
from me3bev_cli.training.run import make_run, open_run

OPTION = "--perception"
PART = "spatial."
"""Where the spatial part's weights are among the network's."""
COMPARED = ("seed", "simulator", "observation", "weather", "spatial")
"""Blocks of a recipe that perception depends on, beside the stages themselves."""


def check_takeover(recipe: Recipe, source: Path) -> None:
    """Find out before a run is made whether it can begin with another one's perception.

    Raises:
        RunError: it cannot.
    """
    _find(recipe, open_run(find_run(source)))


def begin_run(recipe: Recipe, run: Path, source: Path | None) -> None:
    """Make the folder of a new run; with a source, the first checkpoint that it would have after its perception stages.

    Args:
        source: a run whose first stages are the same; None: the run trains its own perception, if it has any.

    Raises:
        RunError: the other run's recipe differs in what perception depends on, or it has not come so far.
        CheckpointError: its weights are damaged. Nothing is made in either case.
    """
    if source is None:
        make_run(run, dump(recipe))
        return
    source = open_run(find_run(source))
    stages, folder = _find(recipe, source)
    eyes, head = _eyes(folder), (source / HEAD).read_bytes()
    steps = sum(stage.steps for stage in recipe.stages[:stages])
    rows = [row for row in read_metrics(source) if row["steps"] <= steps and row.get("stage", stages) < stages]
    make_run(run, dump(recipe))
    atomic_write_text(run / METRICS, "".join(json.dumps(row) + "\n" for row in rows))
    atomic_write_bytes(run / HEAD, head)
    weights = build_network(recipe, recipe.seed).state_dict() | eyes
    save_checkpoint(run, weights, recipe, Progress(stage=stages, total_steps=steps), {})


def _find(recipe: Recipe, source: Path) -> tuple[int, Path]:
    """How many perception stages the recipe begins with, and the source's checkpoint that holds what they teach."""
    kinds = [stage.kind for stage in recipe.stages]
    stages = next((number for number, kind in enumerate(kinds) if kind != "perception"), len(kinds))
    if not 0 < stages < len(kinds):
        raise RunError(f"'{recipe.name}' has no stages after perception ones at its beginning", where=OPTION)
    theirs = run_recipe(source)
    differing = differences([_compared(recipe.model_dump(mode="json"), stages), _compared(theirs, stages)])
    if differing:
        keys = "; ".join(f"{one.key}: {shown(one.values[0])}, there {shown(one.values[1])}" for one in differing[:4])
        raise RunError(
            f"{source} was trained with another perception: {keys}{' ...' if len(differing) > 4 else ''}",
            where=OPTION,
            hint="Leave the option out to train it anew",
        )
    frozen = ["spatial" in stage.get("freeze", ()) for stage in theirs["stages"]]
    for folder in reversed(checkpoints(source)):
        progress = load_progress(folder)
        begun = progress.stage + (progress.stage_steps > 0)
        if progress.stage >= stages and all(frozen[stages:begun]) and (source / HEAD).is_file():
            return stages, folder
    raise RunError(f"{source} has no checkpoint of the end of its perception", where=OPTION)


def _compared(recipe: Mapping[str, Any], stages: int) -> dict[str, Any]:
    return {key: recipe.get(key) for key in COMPARED} | {"stages": list(recipe.get("stages", ()))[:stages]}


def _eyes(folder: Path) -> dict[str, Tensor]:
    try:
        weights = load_file(folder / WEIGHTS)
    except (SafetensorError, OSError) as error:
        raise CheckpointError(f"{folder / WEIGHTS} is damaged or truncated ({error})") from error
    return {key: value for key, value in weights.items() if key.startswith(PART)}

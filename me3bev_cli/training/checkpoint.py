"""Checkpoints: folders of plain files. Nothing that is read from them is ever unpickled.

step_000012288/
    recipe.yaml           as resolved
    policy.safetensors    the network's parameters and buffers
    trainer.pt            what the stage's runner needs to go on exactly, read with weights_only
    progress.json         stage, steps, episodes
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch
from safetensors import SafetensorError
from safetensors.torch import load_file, save
from torch import Tensor

from me3bev_cli import recipe_loading
from me3bev_cli.api import weights_follow
from me3bev_cli.errors import CheckpointError, RunError
from me3bev_cli.pipeline.assemble import build_network
from me3bev_cli.pipeline.network import Network
from me3bev_cli.training.alarms import disk_error
from me3bev_cli.training.best import BEST, FIGURES, find_best
from me3bev_cli.training.folders import Write, clear_folders, write_folder

if TYPE_CHECKING:
    from me3bev_cli.recipe import Recipe

WEIGHTS, TRAINER, PROGRESS, RECIPE = "policy.safetensors", "trainer.pt", "progress.json", "recipe.yaml"
FOLDER = "checkpoints"


@dataclass
class Progress:
    """How far a run has come."""

    stage: int = 0
    stage_steps: int = 0
    """Environment steps done in this stage."""
    total_steps: int = 0
    """Environment steps done in all stages."""
    episodes: int = 0
    """Index of the first episode not yet begun in this stage."""
    updates: int = 0
    seconds: float = 0.0
    """Time spent training, over all sittings."""
    done: bool = False


def save_checkpoint(
    run: Path, weights: Mapping[str, Tensor], recipe: Recipe, progress: Progress, trainer: dict[str, Any]
) -> Path:
    """Write a checkpoint under a temporary name and rename it; returns its folder.

    Args:
        weights: the network's `state_dict()`.

    Raises:
        DiskError: it cannot be written; nothing is left of it, and older ones stand.
    """
    final = run / FOLDER / f"step_{progress.total_steps:09d}"
    contents = {TRAINER: lambda file: torch.save(trainer, file), **policy_files(weights, recipe, progress)}
    try:
        write_folder(final, contents)
    except OSError as error:
        found = checkpoints(run)
        raise disk_error(final, error, run, found[-1] if found else None) from error
    return final


def save_best(run: Path, network: Network, recipe: Recipe, progress: Progress, figures: Mapping[str, Any]) -> Path:
    """Keep the network as the best one so far, then let go of the one before; returns its folder.

    Args:
        figures: of the evaluation that it was chosen by.

    Raises:
        DiskError: it cannot be written; nothing is left of it, and the one before stands.
    """
    final = run / FOLDER / f"{BEST}_{progress.total_steps:09d}"
    told = {"steps": progress.total_steps, **figures}
    try:
        write_folder(final, policy_files(network.state_dict(), recipe, progress) | {FIGURES: _json(told)})
    except OSError as error:
        raise disk_error(final, error, run, find_best(run)) from error
    for folder in final.parent.glob(f"{BEST}_*"):
        if folder != final:
            shutil.rmtree(folder, ignore_errors=True)
    return final


def policy_files(weights: Mapping[str, Tensor], recipe: Recipe, progress: Progress) -> dict[str, Write]:
    """What a checkpoint is driven with."""
    contiguous = {key: value.contiguous() for key, value in weights.items()}
    return {
        WEIGHTS: lambda file: file.write(save(contiguous)),
        RECIPE: lambda file: file.write(recipe_loading.dump(recipe).encode()),
        PROGRESS: _json(asdict(progress)),
    }


def _json(values: Mapping[str, Any]) -> Write:
    return lambda file: file.write(json.dumps(values, indent=1).encode())


def clear_leftovers(run: Path) -> None:
    """Remove what a process that died left behind while it wrote a checkpoint; to be called by who trains the run."""
    clear_folders(run / FOLDER)


def set_aside(folder: Path) -> Path:
    """Rename a damaged checkpoint, so that nobody takes it for the newest; its new folder."""
    aside = folder.with_name(f"damaged_{folder.name}")
    shutil.rmtree(aside, ignore_errors=True)
    return folder.rename(aside)


def checkpoints(run: Path) -> list[Path]:
    """The run's whole checkpoints, oldest first."""
    return sorted(path for path in (run / FOLDER).glob("step_*") if (path / PROGRESS).exists())


def prune(run: Path, keep: int, every: int | None = None) -> None:
    """Remove all but the newest `keep` checkpoints and, of each `every` environment steps, the first."""
    passed = 0
    for old in checkpoints(run)[:-keep]:
        steps = int(old.name.removeprefix("step_"))
        if every is not None and steps // every > passed:
            passed = steps // every
        else:
            shutil.rmtree(old)


def find_checkpoint(place: Path, which: str = "last") -> Path:
    """A checkpoint folder from a run folder or from the checkpoint's own path.

    Raises:
        RunError: there is no such folder.
        CheckpointError: the run has no checkpoint, or not the one that is named.
    """
    if not place.is_dir():
        raise RunError(f"there is no run at {place}", hint="`me3bev train RECIPE` makes one")
    if (place / WEIGHTS).exists() or (place / PROGRESS).exists():
        return place
    best = find_best(place)
    if best is not None and which in (BEST, best.name):
        return best
    found = checkpoints(place)
    if not found:
        raise CheckpointError(f"the run {place} has no checkpoint yet", hint=f"`me3bev train --resume {place}` goes on")
    if which == "last":
        return found[-1]
    named = [path for path in found if path.name == which]
    if not named:
        names = ["last", *([BEST] if best is not None else []), *(p.name for p in found)]
        hint = "evaluation.every in the recipe makes one" if which == BEST else None
        raise CheckpointError(f"the run {place} has no checkpoint '{which}'", allowed=", ".join(names), hint=hint)
    return named[0]


def load_network(folder: Path, device: torch.device) -> tuple[Network, Recipe]:
    """The network and recipe of a checkpoint folder.

    Raises:
        CheckpointError: a file is missing or truncated, or the weights do not fit the recipe's network.
    """
    if not (folder / RECIPE).exists():
        raise CheckpointError(f"the checkpoint {folder} has no {RECIPE}", hint="choose an older checkpoint")
    recipe = recipe_loading.resolve_recipe(str(folder / RECIPE))
    with weights_follow():
        network = build_network(recipe, recipe.seed)
    load_weights(network, folder)
    return network.to(device), recipe


def load_weights(network: Network, folder: Path) -> None:
    """Fill `network` with the checkpoint's weights.

    Raises:
        CheckpointError: as `load_network`.
    """
    path = folder / WEIGHTS
    if not path.exists():
        raise CheckpointError(f"the checkpoint {folder} has no {WEIGHTS}", hint="choose an older checkpoint")
    try:
        weights = load_file(path)
    except (SafetensorError, OSError) as error:
        raise CheckpointError(f"{path} is damaged or truncated ({error})", hint="choose an older checkpoint") from error
    own = network.state_dict()
    wrong = [key for key, value in own.items() if key not in weights or weights[key].shape != value.shape]
    wrong += [key for key in weights if key not in own]
    if wrong:
        raise CheckpointError(
            f"{path} belongs to another architecture: {len(wrong)} parameters differ, first '{wrong[0]}'",
            hint=f"use it with the recipe beside it, {folder / RECIPE}",
        )
    network.load_state_dict(weights)


def load_progress(folder: Path) -> Progress:
    """How far the run had come at this checkpoint.

    Raises:
        CheckpointError: the file is damaged.
    """
    try:
        return Progress(**json.loads((folder / PROGRESS).read_text()))
    except (OSError, ValueError, TypeError) as error:
        raise CheckpointError(f"{folder / PROGRESS} is damaged ({error})", hint="choose an older checkpoint") from error


def load_trainer(folder: Path) -> dict[str, Any]:
    """Optimiser and random states.

    Raises:
        CheckpointError: the file is missing or damaged.
    """
    try:
        return torch.load(folder / TRAINER, map_location="cpu", weights_only=True)
    except Exception as error:  # torch.load raises many types for a damaged file
        raise CheckpointError(f"{folder / TRAINER} is missing or damaged ({type(error).__name__})") from error

"""Checkpoints: folders of plain files. Nothing that is read from them is ever unpickled.

step_000012288/
    recipe.yaml           as resolved
    policy.safetensors    the network's parameters and buffers
    trainer.pt            optimiser and random states, read with weights_only
    progress.json         stage, steps, episodes
"""

from __future__ import annotations

import json
import shutil
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch
from safetensors import SafetensorError
from safetensors.torch import load_file, save_file

from me3bev_cli import recipe_loading
from me3bev_cli.api import weights_follow
from me3bev_cli.errors import CheckpointError, RunError
from me3bev_cli.pipeline.assemble import build_network
from me3bev_cli.pipeline.network import Network

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


def save_checkpoint(run: Path, network: Network, recipe: Recipe, progress: Progress, trainer: dict[str, Any]) -> Path:
    """Write a checkpoint under a temporary name and rename it; returns its folder."""
    final = run / FOLDER / f"step_{progress.total_steps:09d}"
    temporary = final.with_name(f".{final.name}.part")
    shutil.rmtree(temporary, ignore_errors=True)
    temporary.mkdir(parents=True)
    save_file({key: value.contiguous() for key, value in network.state_dict().items()}, temporary / WEIGHTS)
    torch.save(trainer, temporary / TRAINER)
    (temporary / RECIPE).write_text(recipe_loading.dump(recipe))
    (temporary / PROGRESS).write_text(json.dumps(asdict(progress), indent=1))
    if final.exists():
        shutil.rmtree(final)
    temporary.rename(final)
    return final


def checkpoints(run: Path) -> list[Path]:
    """The run's whole checkpoints, oldest first."""
    return sorted(path for path in (run / FOLDER).glob("step_*") if (path / PROGRESS).exists())


def prune(run: Path, keep: int) -> None:
    """Remove all but the newest `keep` checkpoints."""
    for old in checkpoints(run)[:-keep]:
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
    found = checkpoints(place)
    if not found:
        raise CheckpointError(f"the run {place} has no checkpoint yet", hint=f"`me3bev train --resume {place}` goes on")
    if which == "last":
        return found[-1]
    named = [path for path in found if path.name == which]
    if not named:
        raise CheckpointError(
            f"the run {place} has no checkpoint '{which}'", allowed=", ".join(["last", *(p.name for p in found)])
        )
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

"""Checkpoints: folders of plain files. Nothing that is read from them is ever unpickled.

step_000012288/
    recipe.yaml           as resolved
    policy.safetensors    the network's parameters and buffers
    trainer.pt            what the stage's runner needs to go on exactly, read with weights_only
    progress.json         stage, steps, episodes
"""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

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
from me3bev_cli.training.best import BEST, find_best

if TYPE_CHECKING:
    from me3bev_cli.recipe import Recipe

WEIGHTS, TRAINER, PROGRESS, RECIPE = "policy.safetensors", "trainer.pt", "progress.json", "recipe.yaml"
FOLDER = "checkpoints"
PART, OLD = ".part", ".old"
"""Endings of hidden folders: a checkpoint that is being written, and one that is about to be replaced."""


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
    temporary = final.with_name(f".{final.name}{PART}")
    try:
        shutil.rmtree(temporary, ignore_errors=True)
        temporary.mkdir(parents=True)
        contiguous = {key: value.contiguous() for key, value in weights.items()}
        _write(temporary / WEIGHTS, lambda file: file.write(save(contiguous)))
        _write(temporary / TRAINER, lambda file: torch.save(trainer, file))
        _write(temporary / RECIPE, lambda file: file.write(recipe_loading.dump(recipe).encode()))
        _write(temporary / PROGRESS, lambda file: file.write(json.dumps(asdict(progress), indent=1).encode()))
        _sync(temporary)
        _replace(temporary, final)
    except OSError as error:
        shutil.rmtree(temporary, ignore_errors=True)
        found = checkpoints(run)
        raise disk_error(final, error, run, found[-1] if found else None) from error
    return final


def _write(path: Path, write: Callable[[IO[bytes]], Any]) -> None:
    """Write a file and wait until the disk has it."""
    with open(path, "wb") as file:
        try:
            write(file)
        except RuntimeError as error:
            # torch hides what the file said behind an error of its own.
            if isinstance(error.__context__, OSError):
                raise error.__context__ from None
            raise
        file.flush()
        os.fsync(file.fileno())


def _sync(folder: Path) -> None:
    """Wait until the disk knows the names in a folder, where the system can tell."""
    with suppress(OSError):
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


def _replace(temporary: Path, final: Path) -> None:
    """Give a whole checkpoint its name. One that has it already gives way, but is not gone before the new one is there:
    `clear_leftovers` knows what to do when a process dies in between."""
    old = final.with_name(f".{final.name}{OLD}")
    if final.exists():
        shutil.rmtree(old, ignore_errors=True)
        final.rename(old)
    temporary.rename(final)
    _sync(final.parent)
    shutil.rmtree(old, ignore_errors=True)


def clear_leftovers(run: Path) -> None:
    """Remove what a process that died left behind while it wrote a checkpoint; to be called by who trains the run."""
    for path in (run / FOLDER).glob(f".*{PART}"):
        shutil.rmtree(path, ignore_errors=True)
    for path in (run / FOLDER).glob(f".*{OLD}"):
        name = path.name[1 : -len(OLD)]
        if path.with_name(name).exists():
            shutil.rmtree(path, ignore_errors=True)
        else:
            path.rename(path.with_name(name))


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

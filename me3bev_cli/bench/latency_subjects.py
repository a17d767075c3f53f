"""What `me3bev bench-latency` compares: networks by recipe or run, or every pair of installed plugins at full size."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING

from pydantic import ValidationError

from me3bev_cli import registry
from me3bev_cli.errors import CheckpointError, PluginError, RecipeError
from me3bev_cli.pretrained import find_run
from me3bev_cli.recipe_loading import resolve_recipe
from me3bev_cli.training.checkpoint import RECIPE, WEIGHTS, find_checkpoint
from me3bev_cli.training.run import is_run

if TYPE_CHECKING:
    from me3bev_cli.recipe import Recipe

BASE = "me3bev"
"""The recipe at full size that every pair of plugins is put into."""
KINDS = ("spatial", "temporal", "fusion")


@dataclass(frozen=True)
class Subject:
    """A network to be timed."""

    name: str
    recipe: Recipe
    checkpoint: Path | None = None
    """Where its weights are; None: as the recipe's seed draws them."""
    run: Path | None = None
    """The run folder, if it has one."""


def named(sources: Sequence[str]) -> list[Subject]:
    """Recipes by name or file, and run or checkpoint folders; names that occur twice are numbered.

    Raises:
        UserError: one of them is missing or faulty.
    """
    found = [_of_folder(find_run(source)) if find_run(source).is_dir() else _of_recipe(source) for source in sources]
    counts, seen = Counter(subject.name for subject in found), Counter[str]()
    for index, subject in enumerate(found):
        if counts[subject.name] > 1:
            seen[subject.name] += 1
            found[index] = replace(subject, name=f"{subject.name}-{seen[subject.name]}")
    return found


def _of_recipe(source: str) -> Subject:
    recipe = resolve_recipe(source)
    return Subject(recipe.name, recipe)


def _of_folder(folder: Path) -> Subject:
    checkpoint = find_checkpoint(folder)
    for file in (RECIPE, WEIGHTS):
        if not (checkpoint / file).exists():
            raise CheckpointError(f"the checkpoint {checkpoint} has no {file}", hint="choose an older checkpoint")
    recipe = resolve_recipe(checkpoint / RECIPE)
    if is_run(folder):
        return Subject(folder.resolve().name, recipe, checkpoint, folder)
    owner = checkpoint.resolve().parent.parent
    return Subject(f"{owner.name}-{checkpoint.resolve().name}", recipe, checkpoint, owner if is_run(owner) else None)


def every_pair() -> tuple[list[Subject], list[str]]:
    """Every installed spatial x temporal x fusion plugin in the base recipe, and a line for each that is left out."""
    usable: dict[str, list[str]] = {kind: [] for kind in KINDS}
    skipped: list[str] = []
    for kind in KINDS:
        for name in registry.names(kind):
            problem = _unusable(kind, name)
            if problem:
                skipped.append(f"{kind} plugin '{name}': {problem}")
            else:
                usable[kind].append(name)
    subjects = []
    for names in product(*(usable[kind] for kind in KINDS)):
        title = "-".join(names)
        choices = [f"{kind}.name={name}" for kind, name in zip(KINDS, names, strict=True)]
        try:
            subjects.append(Subject(title, resolve_recipe(BASE, [f"name={title}", *choices])))
        except RecipeError as error:
            skipped.append(f"{title}: {error.faults[0].what}")
    return subjects, skipped


def _unusable(kind: str, name: str) -> str:
    """Why a plugin cannot be built without being told more; empty when it can."""
    try:
        registry.load(kind, name).Config()
    except PluginError as error:
        return error.what
    except ValidationError as error:
        missing = [".".join(map(str, fault["loc"])) for fault in error.errors() if fault["type"] == "missing"]
        return f"its config needs {', '.join(missing)}" if missing else error.errors()[0]["msg"]
    return ""

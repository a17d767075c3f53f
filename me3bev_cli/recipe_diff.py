"""Which keys differ between recipes: files, shipped recipes, or the recipes that runs were trained by."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from me3bev_cli.errors import RunError
from me3bev_cli.recipe_loading import find_recipe, resolve_recipe
from me3bev_cli.recipe_yaml import plain, read_yaml
from me3bev_cli.training.run import runs_root

RECIPE = "recipe.yaml"
ABSENT = object()
"""Stands for the value of a key that a recipe does not have; None is a value."""


@dataclass(frozen=True)
class Difference:
    """One key that is not the same everywhere."""

    key: str
    """As after `--set`: `stages.0.steps`; `stages.ppo[-1].steps` where the recipes' stages are of other kinds."""
    values: tuple[Any, ...]
    """Of each recipe, in their order; `ABSENT` where it lacks the key."""

    def row(self) -> dict[str, Any]:
        """As plain values: an absent one is null, and `there` says where the key exists."""
        return {
            "key": self.key,
            "values": [None if value is ABSENT else value for value in self.values],
            "there": [value is not ABSENT for value in self.values],
        }


def load_plain(source: str) -> dict[str, Any]:
    """A recipe as plain values, from a shipped recipe's name, a file, or a run or checkpoint, by folder or name.

    A run's recipe was resolved when it began: it is read as it stands, whatever a newer version would make of it.

    Raises:
        UserError: there is none, or it is faulty.
    """
    for folder in (Path(source), runs_root() / source):
        if (folder / RECIPE).is_file():
            return run_recipe(folder)
    if Path(source).is_dir():
        raise RunError(f"{source} holds no {RECIPE}", hint="Name a run, a checkpoint, a file or a shipped recipe")
    path = find_recipe(source)
    return resolve_recipe(path).model_dump(mode="json")


def run_recipe(folder: Path) -> dict[str, Any]:
    """The recipe in a run or checkpoint folder.

    Raises:
        UserError: it is missing, not YAML, or no recipe.
    """
    path = folder / RECIPE
    try:
        found = plain(read_yaml(path.read_text(encoding="utf-8"), str(path)))
    except (OSError, UnicodeDecodeError) as error:
        raise RunError(f"cannot be read ({type(error).__name__})", where=str(path)) from error
    if not isinstance(found, dict):
        raise RunError("a recipe is a block of keys", where=str(path))
    return found


def differences(recipes: Sequence[Mapping[str, Any]]) -> list[Difference]:
    """Every key whose value is not the same in all recipes, in the order in which recipes have them.

    Lists of blocks, as `stages`, are compared item by item; lists of plain values as a whole. Where recipes have stages
    of other kinds, each is compared with those of its kind, counted from the last one: `stages.ppo[-2].steps`. Of a
    stage that another recipe lacks there are the steps alone.
    """
    flat = [flatten(recipe) for recipe in _by_kind(recipes)]
    keys = dict.fromkeys(key for one in flat for key in one)
    found = [Difference(key, tuple(one.get(key, ABSENT) for one in flat)) for key in _by_block(keys)]
    return [one for one in found if any(value != one.values[0] for value in one.values[1:])]


def flatten(value: Any, path: str = "") -> dict[str, Any]:
    """Nested blocks as `{dotted key: value}`; an empty block is a value."""
    if isinstance(value, Mapping) and value:
        items = [(str(key), child) for key, child in value.items()]
    elif isinstance(value, list) and any(isinstance(child, Mapping) for child in value):
        items = [(str(place), child) for place, child in enumerate(value)]
    else:
        return {path: value}
    found: dict[str, Any] = {}
    for key, child in items:
        found |= flatten(child, f"{path}.{key}" if path else key)
    return found


def _by_kind(recipes: Sequence[Mapping[str, Any]]) -> Sequence[Mapping[str, Any]]:
    """The recipes with their stages under names that mean the same in each, unless their numbers do."""
    kinds = [[stage.get("kind") for stage in recipe.get("stages") or ()] for recipe in recipes]
    shared = min(map(len, kinds), default=0)
    if all(found[:shared] == kinds[0][:shared] for found in kinds):
        return recipes
    named = [_stages(recipe["stages"], found) for recipe, found in zip(recipes, kinds, strict=True)]
    everywhere = set.intersection(*map(set, named))
    return [
        {**recipe, "stages": {key: stage if key in everywhere else {"steps": stage.get("steps")} for key, stage in own}}
        for recipe, own in zip(recipes, (stages.items() for stages in named), strict=True)
    ]


def _stages(stages: Sequence[Mapping[str, Any]], kinds: Sequence[Any]) -> dict[str, Mapping[str, Any]]:
    return {f"{kind}[-{kinds[place:].count(kind)}]": stages[place] for place, kind in enumerate(kinds)}


def _by_block(keys: Mapping[str, None]) -> list[str]:
    """Keys that only a later recipe has beside the others of their block."""
    blocks: dict[str, list[str]] = {}
    for key in keys:
        blocks.setdefault(key.partition(".")[0], []).append(key)
    return [key for block in blocks.values() for key in block]


def shown(value: Any) -> str:
    """A value for people, as YAML has it."""
    if value is ABSENT:
        return "–"
    if value is None:
        return "null"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, list):
        return f"[{', '.join(map(shown, value))}]"
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{key}: {shown(child)}" for key, child in value.items()) + "}"
    return str(value)

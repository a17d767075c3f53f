"""A recipe by name or file: `extends`, overrides, the schema, the plugins; every fault at once, with file and line."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any

from me3bev_cli.errors import RecipeError, UserError, unknown_name
from me3bev_cli.recipe import PluginChoice, Recipe
from me3bev_cli.recipe_check import BLOCKS, Checker, Chosen
from me3bev_cli.recipe_faults import Fault, validate
from me3bev_cli.recipe_yaml import Mark, Node, mark_of, plain, read_yaml, write_yaml

SUFFIXES = (".yaml", ".yml")


def shipped_recipes() -> dict[str, Path]:
    """Recipes that come with me3bev, by name; those of a family are named with it, as `small/me3bev`."""
    folder = Path(str(files("me3bev_recipes")))
    found = [*sorted(folder.glob("*.yaml")), *sorted(folder.glob("*/*.yaml"))]
    return {path.relative_to(folder).with_suffix("").as_posix(): path for path in found}


def resolve_recipe(source: str | os.PathLike[str], overrides: Sequence[str] = ()) -> Recipe:
    """The whole recipe: what it extends merged in, overrides applied, plugins' defaults filled in, all checked.

    Args:
        source: a shipped recipe's name, or a file.
        overrides: `key=value` each; keys as in `stages.0.steps`, values as in YAML.

    Raises:
        RecipeError: every fault that was found.
    """
    path = find_recipe(os.fspath(source))
    faults: list[UserError] = []
    tree = _read(path, (), faults)
    tree = _overridden(tree, overrides, faults)
    name = tree.value.setdefault("name", Node(path.stem, Mark(_shown(path))))
    if name.value is None:
        tree.value["name"] = Node(path.stem, name.mark)
    return _checked(tree, faults)


def dump(recipe: Recipe) -> str:
    """The recipe as YAML that resolves to itself."""
    return write_yaml(recipe.model_dump(mode="json"))


def find_recipe(source: str, base: Path | None = None, where: str | None = None) -> Path:
    """The file of a recipe named in a message's `where`: a path (relative to `base`) or a shipped name.

    Raises:
        RecipeError: there is none; the shipped ones are listed.
    """
    shipped = shipped_recipes()
    is_path = source.endswith(SUFFIXES) or os.sep in source or "/" in source
    path = (base or Path()) / source
    if is_path and path.is_file():
        return path
    if source in shipped:
        return shipped[source]
    if not is_path or (path.stem in shipped and not path.exists()):
        error = unknown_name("recipe", path.stem if is_path else source, shipped, where=where)
        if is_path:
            error = UserError(f"there is no file '{source}'; did you mean '{path.stem}'?", where=where)
        raise RecipeError([UserError(error.what, where=where, allowed=f"a file, or one of {', '.join(shipped)}")])
    what = f"'{source}' is not a file" if path.exists() else f"there is no file '{source}'"
    raise RecipeError([UserError(what, where=where, allowed=f"a file, or one of {', '.join(shipped)}")])


def _shown(path: Path) -> str:
    """The path as a user would write it: relative when it is below the current folder."""
    absolute, here = path.resolve(), Path.cwd().resolve()
    return str(absolute.relative_to(here)) if absolute.is_relative_to(here) else str(absolute)


def _read(path: Path, chain: tuple[Path, ...], faults: list[UserError]) -> Node:
    """The tree of a file with what it extends merged in; `chain` holds the files that led here.

    A file that is no recipe at all raises RecipeError; what it extends adds to `faults` and is left out.
    """
    try:
        text = path.read_bytes().decode("utf-8")
    except OSError as error:
        raise RecipeError([UserError(f"cannot be read: {error.strerror}", where=_shown(path))]) from None
    except UnicodeDecodeError:
        raise RecipeError([UserError("is not text in UTF-8", where=_shown(path))]) from None
    tree = read_yaml(text, _shown(path))
    if not isinstance(tree.value, dict):
        what = "the file is empty" if tree.value is None else "a recipe is a block of keys"
        raise RecipeError([UserError(what, where=str(tree.mark), hint="`me3bev recipe show quickstart` is an example")])
    extends = tree.value.pop("extends", None)
    if extends is None or extends.value is None:
        return tree
    try:
        base = _read_parent(path, extends, (*chain, path.resolve()), faults)
    except RecipeError as error:
        faults.extend(error.faults)
        return tree
    base.value.pop("name", None)
    return _merge(base, tree)


def _read_parent(path: Path, extends: Node, chain: tuple[Path, ...], faults: list[UserError]) -> Node:
    where = f"{extends.mark}: extends"
    if not isinstance(extends.value, str):
        raise RecipeError([UserError("expected a file or a shipped recipe's name", where=where)])
    parent = find_recipe(extends.value, path.parent, where)
    if parent.resolve() in chain:
        circle = " -> ".join(_shown(file) for file in (*chain[chain.index(parent.resolve()) :], parent))
        raise RecipeError([UserError(f"a circle: {circle}", where=where)])
    return _read(parent, chain, faults)


def _merge(base: Node, over: Node, path: tuple[str, ...] = ()) -> Node:
    """Blocks merge key by key; anything else, a list too, is replaced."""
    if not (isinstance(base.value, dict) and isinstance(over.value, dict)) or _another(base, over, path):
        return over
    merged = dict(base.value)
    if not path and _another_simulator(base, over):
        # Kinds of weather are a simulator's own, as maps are.
        merged.pop("weather", None)
    for key, child in over.value.items():
        merged[key] = _merge(merged[key], child, (*path, key)) if key in merged else child
    return Node(merged, over.mark)


def _another(base: Node, over: Node, path: tuple[str, ...]) -> bool:
    """Whether `over` chooses another plugin or kind: the keys of the one before do not apply to it."""
    key = "name" if path[:1] and path[0] in BLOCKS and len(path) == 1 else "kind"
    if key not in over.value or key not in base.value:
        return False
    return bool(over.value[key].value != base.value[key].value)


def _another_simulator(base: Node, over: Node) -> bool:
    before, after = (tree.value.get("simulator", Node(None, tree.mark)) for tree in (base, over))
    both = isinstance(before.value, dict) and isinstance(after.value, dict)
    return both and _another(before, after, ("simulator",))


def _overridden(tree: Node, overrides: Iterable[str], faults: list[UserError]) -> Node:
    for text in overrides:
        key, equals, value = text.partition("=")
        option = f"--set {text}"
        segments = key.strip().split(".")
        if not equals or not all(segments):
            faults.append(UserError("expected key=value, as in stages.0.steps=5000", where=option))
            continue
        try:
            tree = _set(tree, segments, read_yaml(value, option, lines=False), ())
        except RecipeError as error:
            faults.extend(error.faults)
        except UserError as error:
            faults.append(UserError(error.what, where=option, allowed=error.allowed))
    return tree


def _set(tree: Node, segments: Sequence[str], value: Node, path: tuple[str, ...]) -> Node:
    """The tree with `value` merged in below `segments`."""
    if not segments:
        return _merge(tree, value, path)
    head, *rest = segments
    if isinstance(tree.value, list):
        if not head.isdecimal() or int(head) >= len(tree.value):
            last = len(tree.value) - 1
            raise UserError(
                f"'{'.'.join(path)}' is a list without '{head}'", allowed=f"0 to {last}" if last > 0 else "0"
            )
        items = list(tree.value)
        items[int(head)] = _set(items[int(head)], rest, value, (*path, head))
        return Node(items, tree.mark)
    known = tree.value.get(head) if isinstance(tree.value, dict) else None
    child = _nested(rest, value) if known is None else _set(known, rest, value, (*path, head))
    # Through the merge, so that another plugin's name drops the keys of the one before.
    return _merge(tree, Node({head: child}, tree.mark), path)


def _nested(segments: Sequence[str], value: Node) -> Node:
    for segment in reversed(segments):
        value = Node({segment: value}, value.mark)
    return value


def _checked(tree: Node, before: list[UserError]) -> Recipe:
    """The recipe of a merged tree. Raises RecipeError with every fault: those of reading, then by line."""
    data = plain(tree)
    recipe, found = validate(Recipe, data)
    checker = Checker(data)
    checker.run()
    found += checker.faults
    if before:
        # What could not be read may have held it.
        found = [fault for fault in found if fault.path and not fault.missing]
    if before or found:
        raise RecipeError([*before, *_in_order(found, tree)])
    filled = {kind: _filled(getattr(recipe, kind), chosen) for kind, chosen in checker.chosen.items()}
    open_sets = {key: checker.default_weather for key, names in recipe.weather if names is None}
    return recipe.model_copy(update={**filled, "weather": recipe.weather.model_copy(update=open_sets)})


def _filled(choice: PluginChoice, chosen: Chosen) -> PluginChoice:
    """The block with the plugin's defaults written out, so that a run's recipe stays what it was."""
    declared = {key: getattr(choice, key) for key in type(choice).model_fields}
    return type(choice).model_validate(declared | chosen.config.model_dump(mode="json"))


def _in_order(faults: Iterable[Fault], tree: Node) -> list[UserError]:
    unique = {(fault.path, fault.what): fault for fault in faults}

    def place(fault: Fault) -> tuple[Any, ...]:
        mark = mark_of(tree, fault.path)
        return mark.line is None, mark.source, mark.line or 0

    return [fault.located(tree) for fault in sorted(unique.values(), key=place)]


def headline(path: Path) -> str:
    """The first line of a recipe's header comment: what it is."""
    first = path.read_text(encoding="utf-8").partition("\n")[0]
    return first.removeprefix("#").strip() if first.startswith("#") else ""

"""Which methods an evaluation has, from a command's options: runs, reference drivers, and the worlds of both."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from me3bev_cli.errors import UserError, unknown_name
from me3bev_cli.evaluation.choice import Cells, choose_cells, choose_driver
from me3bev_cli.evaluation.drivers import REFERENCES, DriverSpec
from me3bev_cli.evaluation.player import Method
from me3bev_cli.evaluation.runner import World
from me3bev_cli.pretrained import find_run, run_path
from me3bev_cli.recipe import Recipe


@dataclass(frozen=True)
class Asked:
    """What the options name."""

    runs: Sequence[Path] = ()
    checkpoint: str = "last"
    drivers: Sequence[str] = ()
    """Names of reference drivers, in place of the newest run."""
    references: Sequence[str] = ()
    """The same, beside it."""
    recipe: str | None = None
    device: str = "auto"
    baseline: str | None = None
    """A method's name, or a run."""


@dataclass(frozen=True)
class Chosen:
    """The methods in the order of the tables, where they drive, and which of them the others are compared with."""

    methods: tuple[Method, ...]
    cells: Cells
    recipe: Recipe | None
    """Whose world the reference drivers have."""
    baseline: str | None


def parse_references(text: str | None, where: str = "--reference") -> list[str]:
    """`idle,random` or `all` -> names, each once.

    Raises:
        UserError: one of them is no reference driver, or none is named.
    """
    names: list[str] = []
    for part in (text or "").split(","):
        name = part.strip()
        if name == "all":
            names.extend(REFERENCES)
        elif name in REFERENCES:
            names.append(name)
        elif name:
            raise unknown_name("reference driver", name, (*REFERENCES, "all"), where=where)
    if text is not None and not names:
        raise UserError("no name is given", where=where, allowed=", ".join((*REFERENCES, "all")))
    return list(dict.fromkeys(names))


def choose(asked: Asked, maps: str | None, density: str | None, weather: str | None) -> Chosen:
    """Settle everything that the options name, before anything is driven.

    All methods drive the same maps and densities in the same weather; where an option is not given, the recipe of the
    first one decides. Reference drivers drive in the world of the first run.

    Raises:
        UserError: an option is wrong, or what it names is missing.
    """
    runs = _runs(asked)
    names = list(dict.fromkeys((*asked.drivers, *asked.references)))
    if asked.baseline in REFERENCES:
        names = list(dict.fromkeys((*names, asked.baseline)))
    found = [choose_driver(run, asked.checkpoint, None, asked.recipe, asked.device) for run in runs]
    place = found[0][0].run if found else None
    found += [choose_driver(place, asked.checkpoint, name, asked.recipe, asked.device) for name in names]
    home = found[0][1]
    cells = choose_cells(home, maps, density, weather, "evaluation")
    labels = _labels([spec for spec, _ in found])
    methods = tuple(
        Method(replace(spec, label=label), _world(recipe, cells))
        for (spec, recipe), label in zip(found, labels, strict=True)
    )
    return Chosen(methods, cells, home, _baseline(asked.baseline, methods))


def _runs(asked: Asked) -> list[Path | None]:
    """The runs whose policies drive; None stands for what drives when none is named."""
    runs: list[Path | None] = list(asked.runs)
    if asked.baseline is not None and asked.baseline not in REFERENCES:
        path = run_path(asked.baseline)
        if path is not None and path.resolve() not in [find_run(run).resolve() for run in asked.runs]:
            runs.append(path)
    return runs or ([] if asked.drivers else [None])


def _baseline(asked: str | None, methods: Sequence[Method]) -> str | None:
    """The label of the method that is meant."""
    if asked is None:
        return None
    path = run_path(asked)
    for method in methods:
        run = method.spec.run
        same = path is not None and run is not None and path.resolve() == run.resolve()
        if asked in (method.label, method.spec.name) or same:
            return method.label
    raise unknown_name("method or run", asked, [method.label for method in methods], where="--baseline")


def _world(recipe: Recipe | None, cells: Cells) -> World:
    """A method's own world, with the weather of all.

    Raises:
        MapError: its simulator lacks a map, a density or a kind of weather.
    """
    names = ",".join(cells.maps), ",".join(cells.densities), ",".join(cells.world.weather or ())
    return choose_cells(recipe, names[0], names[1], names[2] or None, "evaluation").world


def _labels(specs: Sequence[DriverSpec]) -> list[str]:
    """A name for each method that no other one has: where runs have the same, their folder's is put before it.

    Raises:
        UserError: a method is named twice.
    """
    counts = Counter(spec.label for spec in specs)
    labels = [spec.label for spec in specs]
    for place, spec in enumerate(specs):
        if spec.run is not None and counts[spec.label] > 1:
            labels[place] = f"{spec.run.resolve().parent.name}-{spec.label}"
    twice = [label for label, count in Counter(labels).items() if count > 1]
    if twice:
        hint = "Rename one of the folders, or leave it out"
        raise UserError(f"'{twice[0]}' is named twice", where="--run", hint=hint)
    return labels

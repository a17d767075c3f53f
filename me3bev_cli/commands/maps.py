"""`me3bev maps`: list a simulator's maps, look at them, measure them, import and remove your own."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, cast

import typer

if TYPE_CHECKING:
    from collections.abc import Iterable

    from me3bev_cli.api import FactRow, MapEntry, MapLibrary

Simulator = Annotated[str, typer.Option(help="Whose maps.", metavar="NAME")]
Json = Annotated[str | None, typer.Option(help="Write it as JSON.", metavar="FILE|-")]
HIGHWAY = "highway"
PARTS = ("map_entries", "import_map", "remove_map", "map_digest", "map_facts", "map_plan")
"""What a simulator must have to be a `MapLibrary`."""

app = typer.Typer(help="List, show, measure and import maps.", no_args_is_help=True)


@app.command(name="list")
def list_(json: Json = None, simulator: Simulator = HIGHWAY) -> None:
    """List the maps that can be driven, imported ones too."""
    from rich.markup import escape
    from rich.table import Table

    from me3bev_cli.output import console, write_json

    entries = _library(simulator).map_entries()
    table = Table(box=None, pad_edge=False)
    for title in ("map", "source", "about"):
        table.add_column(title, overflow="fold")
    for entry in entries:
        table.add_row(entry.name, entry.source, escape(entry.description))
    console(json).print(table)
    if json is not None:
        write_json({"maps": [entry._asdict() for entry in entries]}, json)


@app.command()
def show(
    map_: Annotated[str, typer.Argument(help="Name of a map.", metavar="MAP")],
    out: Annotated[Path | None, typer.Option(help="A .png file. Default: MAP.png.", metavar="FILE")] = None,
    seed: Annotated[int, typer.Option(help="Of the route that is drawn.", min=0)] = 0,
    simulator: Simulator = HIGHWAY,
) -> None:
    """Draw a plan of a map: lanes, limits, lights, crosswalks, a route."""
    from me3bev_cli.errors import UserError

    target = out if out is not None else Path(f"{map_}.png")
    if target.suffix.lower() != ".png":
        raise UserError(f"'{target}' does not end in .png", where="--out", allowed="a .png file")
    library = _library(simulator)
    _write_png(target, library.map_plan(map_, seed))
    typer.echo(f"wrote {target}")


@app.command()
def facts(
    maps: Annotated[str, typer.Argument(help="As T3, T1-T7 or T1,T3.", metavar="MAPS")],
    json: Json = None,
    simulator: Simulator = HIGHWAY,
) -> None:
    """Measure maps: kilometres, junctions, limits, bends, beside what they are modelled on."""
    from me3bev_cli.evaluation.maps import parse_maps
    from me3bev_cli.output import console, write_json

    library = _library(simulator)
    rows = {name: library.map_facts(name) for name in parse_maps(maps, cast(Any, library).maps(), where="MAPS")}
    place = console(json)
    for name, measured in rows.items():
        place.print(name, style="bold", markup=False)
        place.print(_facts_table(measured))
    if json is not None:
        write_json({"maps": {name: [row._asdict() for row in measured] for name, measured in rows.items()}}, json)


@app.command(name="import")
def import_(
    file: Annotated[Path, typer.Argument(help="An OpenDRIVE file, .xodr or .xodr.gz.", metavar="FILE")],
    name: Annotated[str | None, typer.Option(help="What to call it. Default: the file's name.")] = None,
    replace: Annotated[bool, typer.Option("--replace", help="Take the place of an imported map.")] = False,
    simulator: Simulator = HIGHWAY,
) -> None:
    """Keep a map of your own; it can then be named wherever T3 can."""
    entry: MapEntry = _library(simulator).import_map(file, name, replace)
    typer.echo(f"imported {entry.name}: {entry.description}")


@app.command()
def remove(
    name: Annotated[str, typer.Argument(help="Name of an imported map.", metavar="MAP")],
    simulator: Simulator = HIGHWAY,
) -> None:
    """Forget an imported map."""
    _library(simulator).remove_map(name)
    typer.echo(f"removed {name}")


def _library(name: str) -> MapLibrary:
    """The simulator, if it keeps a library of maps.

    Raises:
        PluginError: it is not installed, or has no library.
    """
    from me3bev_cli import registry
    from me3bev_cli.errors import PluginError

    plugin = registry.load("simulator", name)
    if not all(callable(getattr(plugin, part, None)) for part in PARTS):
        able = [other for other in registry.names("simulator") if other != name]
        raise PluginError(
            f"simulator '{name}' keeps no library of maps",
            where="--simulator",
            hint=f"Others that are installed: {', '.join(able)}" if able else None,
        )
    return cast("MapLibrary", plugin(plugin.Config()))


def _facts_table(rows: Iterable[FactRow]) -> Any:
    from rich.table import Table

    table = Table(box=None, pad_edge=False)
    table.add_column("fact")
    for title in ("measured", "reference"):
        table.add_column(title, justify="right")
    for title in ("unit", "tolerance", "within"):
        table.add_column(title)
    words = {True: "yes", False: "no", None: ""}
    for row in rows:
        reference = "" if row.reference is None else f"{row.reference:.4g}"
        table.add_row(
            row.key, f"{row.value:.4g}", reference, row.unit, row.tolerance, words[row.within],
            style="red" if row.within is False else None,
        )  # fmt: skip
    return table


def _write_png(target: Path, picture: Any) -> None:
    """Write an RGB picture (H, W, 3), whole or not at all."""
    import cv2
    import numpy as np

    from me3bev_cli.files import atomic_write_bytes

    _, data = cv2.imencode(".png", np.ascontiguousarray(picture[..., ::-1]))
    atomic_write_bytes(target, data.tobytes())

"""`me3bev recipe`: look at recipes, check them, give editors their schema."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from me3bev_cli.recipe_check import Fit

Source = Annotated[str, typer.Argument(help="A recipe file or the name of a shipped recipe.", metavar="RECIPE")]
Overrides = Annotated[
    list[str] | None, typer.Option("--set", help="Override a key, as in seed=3.", metavar="KEY=VALUE")
]
Json = Annotated[str | None, typer.Option(help="Write it as JSON.", metavar="FILE|-")]

app = typer.Typer(help="Show, check and list recipes.", no_args_is_help=True)


@app.command()
def show(recipe: Source, overrides: Overrides = None, json: Json = None) -> None:
    """Print a recipe as resolved. What it extends is merged, overrides applied, defaults written out."""
    from me3bev_cli.output import console, write_json
    from me3bev_cli.recipe_loading import dump, resolve_recipe

    resolved = resolve_recipe(recipe, overrides or [])
    if json is not None:
        write_json(resolved.model_dump(mode="json"), json)
    if json != "-":
        console().out(dump(resolved), end="")


@app.command()
def validate(
    recipes: Annotated[list[str], typer.Argument(help="Recipe files or names.", metavar="RECIPE...")],
    overrides: Overrides = None,
    json: Json = None,
) -> None:
    """Check recipes, plugins and sizes included; every fault is shown."""
    from me3bev_cli.errors import RecipeError, UserError
    from me3bev_cli.output import console, write_json
    from me3bev_cli.recipe_check import check_recipe
    from me3bev_cli.recipe_loading import resolve_recipe

    rows: list[dict[str, Any]] = []
    faults: list[UserError] = []
    for source in recipes:
        try:
            sizes = check_recipe(resolve_recipe(source, overrides or []))
        except RecipeError as error:
            faults.extend(error.faults)
            rows.append({"recipe": source, "ok": False, "faults": [fault.render() for fault in error.faults]})
        else:
            rows.append({"recipe": source, "ok": True, "faults": []})
            console(json).out(f"{source}: fits; {_sizes(sizes)}")
    if json is not None:
        write_json({"recipes": rows}, json)
    if faults:
        raise RecipeError(faults)


def _sizes(fit: Fit) -> str:
    """As in `bev 8x8 tokens of 64 -> 256, nav 256; fused 256`."""
    parts = []
    for name, spec in fit.tokens.items():
        grid = f" {spec.rows}x{spec.columns} tokens of {spec.width} ->" if name == "bev" else ""
        parts.append(f"{name}{grid} {fit.widths[name]}")
    return f"{', '.join(parts)}; fused {fit.fused}"


@app.command()
def diff(
    first: Annotated[str, typer.Argument(help="A recipe file or name, or a run.", metavar="A")],
    second: Annotated[str, typer.Argument(help="The other one.", metavar="B")],
    json: Json = None,
) -> None:
    """Show which keys of two recipes differ, as resolved. A run stands for the recipe it was trained by."""
    from rich import box
    from rich.markup import escape
    from rich.table import Table

    from me3bev_cli.output import STDOUT, console, write_json
    from me3bev_cli.recipe_diff import differences, load_plain, shown

    found = differences([load_plain(source) for source in (first, second)])
    if json is not None:
        write_json({"recipes": [first, second], "differences": [one.row() for one in found]}, json)
    if json == STDOUT:
        return
    if not found:
        console().print("no key differs")
        return
    table = Table(box=box.SIMPLE, padding=(0, 1, 0, 0), show_edge=False)
    for title in ("key", first, second):
        table.add_column(escape(title), overflow="fold")
    for one in found:
        table.add_row(escape(one.key), *(escape(shown(value)) for value in one.values))
    console().print(table)


@app.command()
def schema(
    out: Annotated[Path | None, typer.Option(help="A file instead of stdout.", metavar="FILE")] = None,
) -> None:
    """Print the JSON Schema of recipes, for editors. It knows the keys of the installed plugins."""
    from me3bev_cli.output import write_json
    from me3bev_cli.recipe_schema import recipe_schema

    write_json(recipe_schema(), str(out) if out is not None else "-")


@app.command(name="list")
def list_(json: Json = None) -> None:
    """List the recipes that come with me3bev."""
    from rich.markup import escape
    from rich.table import Table

    from me3bev_cli.output import console, write_json
    from me3bev_cli.recipe_loading import headline, shipped_recipes

    rows = [{"name": name, "about": headline(path), "file": str(path)} for name, path in shipped_recipes().items()]
    table = Table(box=None, pad_edge=False, show_header=False)
    for row in rows:
        table.add_row(row["name"], escape(row["about"]))
    console(json).print(table)
    if json is not None:
        write_json({"recipes": rows}, json)

"""`me3bev plugins`: what is installed, what is broken and why."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from me3bev_cli.registry import CatalogueRow


def plugins(
    json: Annotated[str | None, typer.Option(help="Write the list.", metavar="FILE|-")] = None,
) -> None:
    """List the installed plugins, broken ones with the reason."""
    from dataclasses import asdict

    from me3bev_cli.output import write_json
    from me3bev_cli.registry import catalogue

    rows = catalogue()
    _print(rows, json)
    if json is not None:
        write_json({"plugins": [{**asdict(row), "status": row.status} for row in rows]}, json)


def _print(rows: list[CatalogueRow], json_target: str | None) -> None:
    from rich.markup import escape
    from rich.table import Table

    from me3bev_cli.output import console

    table = Table(box=None, pad_edge=False)
    for title in ("kind", "name", "from", "status", "keys in a recipe, or what is wrong"):
        table.add_column(title, overflow="fold")
    for row in rows:
        style = "red" if row.reason else None
        table.add_row(
            row.kind, row.name, row.distribution, row.status, escape(row.reason or ", ".join(row.keys)), style=style
        )
    console(json_target).print(table)

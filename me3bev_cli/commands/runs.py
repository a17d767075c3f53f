"""`me3bev runs`: what has been trained, what is being trained."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from me3bev_cli.errors import RunError

if TYPE_CHECKING:
    from rich.table import Table

    from me3bev_cli.training.listing import Entry


def runs(
    folder: Annotated[Path | None, typer.Argument(help="Folder of runs or of batches. Default: runs.")] = None,
    json: Annotated[str | None, typer.Option(help="Write the rows.", metavar="FILE|-")] = None,
) -> None:
    """List runs: state, steps, reward and best evaluation, the newest first."""
    from me3bev_cli.output import console, write_json
    from me3bev_cli.training.listing import describe, find_runs
    from me3bev_cli.training.run import runs_root

    if folder is not None and not folder.is_dir():
        raise RunError(f"there is no folder {folder}")
    found = [describe(run) for run in find_runs(folder or runs_root())]
    place = console(json)
    if found:
        place.print(table(found))
    else:
        place.print(f"there is no run in {folder or runs_root()}; `me3bev train RECIPE` makes one", markup=False)
    if json is not None:
        write_json({"runs": [entry.row() for entry in found]}, json)


def table(entries: Sequence[Entry]) -> Table:
    """Runs as rows for people."""
    from rich.markup import escape
    from rich.table import Table

    grid = Table(box=None, pad_edge=False)
    grid.add_column("run", overflow="fold")
    for name in ("recipe", "state", "stage"):
        grid.add_column(name)
    for name in ("seed", "steps", "reward/step", "best score", "last written"):
        grid.add_column(name, justify="right")
    for entry in entries:
        best = "-" if entry.best_score is None else f"{entry.best_score:.1f} at {entry.best_steps:,}"
        reward = "-" if entry.reward_per_step is None else f"{entry.reward_per_step:.2f}"
        grid.add_row(
            escape(entry.run), entry.recipe, entry.state, entry.stage, str(entry.seed),
            f"{entry.steps:,}/{entry.total:,}", reward, best, ago(entry.age),
        )  # fmt: skip
    return grid


def ago(seconds: float) -> str:
    """A time in the past, in its largest unit."""
    for size, unit in ((86_400, "d"), (3_600, "h"), (60, "min")):
        if seconds >= size:
            return f"{seconds / size:.0f} {unit} ago"
    return f"{seconds:.0f} s ago"

"""`me3bev plot`: the convergence figure."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from me3bev_cli.errors import RunError


def plot(
    runs: Annotated[
        list[Path],
        typer.Argument(help="Runs, or folders of runs; a run's name is enough below runs.", metavar="RUN..."),
    ],
    out: Annotated[Path, typer.Option(help="PNG to write.")] = Path("curves.png"),
    window: Annotated[int, typer.Option(help="Updates in the moving average.", min=1)] = 10,
    json: Annotated[str | None, typer.Option(help="Write curves and figures.", metavar="FILE|-")] = None,
) -> None:
    """Draw reward per step against environment steps; runs that differ in the seed only become one line."""
    chosen = _chosen(runs)
    from me3bev_cli.files import atomic_write_bytes
    from me3bev_cli.output import console, write_json
    from me3bev_cli.training.convergence import document, groups, sentences
    from me3bev_cli.training.convergence_picture import convergence_picture

    found = groups(chosen, window)
    place = console(json)
    drawn = [curve.run for group in found for curve in group.curves]
    for run in chosen:
        if run not in drawn:
            place.print(f"{run} has no reward yet and is left out", markup=False, soft_wrap=True)
    if not found:
        raise RunError("there is nothing to draw: no run has an update with a reward yet")
    atomic_write_bytes(out, convergence_picture(found, window))
    for group in found:
        for line in sentences(group):
            place.print(line, markup=False, soft_wrap=True)
    place.print(f"wrote {out}", markup=False, soft_wrap=True)
    if json is not None:
        write_json(document(found, window), json)


def _chosen(runs: list[Path]) -> list[Path]:
    """The run folders that are meant, each once.

    Raises:
        RunError: one is no run and holds none.
    """
    from me3bev_cli.training.listing import find_runs
    from me3bev_cli.training.run import open_run, runs_root

    found: list[Path] = []
    for path in runs:
        place = path if path.exists() or not (runs_root() / path).is_dir() else runs_root() / path
        found += sorted(find_runs(place)) or [open_run(place)]
    return list(dict.fromkeys(found))

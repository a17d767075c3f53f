"""`me3bev report`: a page of what was measured, to look at and to hand on."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from me3bev_cli.errors import UserError


def report(
    runs: Annotated[
        list[Path] | None,
        typer.Argument(
            help="Runs with evaluations, or their folders. Default: the newest run, else `pretrained`.",
            metavar="RUN...",
        ),
    ] = None,
    out: Annotated[Path, typer.Option(help="Folder to write; an earlier report in it is replaced.")] = Path("report"),
    latency: Annotated[
        list[Path] | None,
        typer.Option(help="Of `me3bev bench-latency --json`, beside a RUN's own latency.json.", metavar="FILE"),
    ] = None,
    clips: Annotated[int, typer.Option(help="Of each kind of failure at most; 0 for none.")] = 2,
    title: Annotated[str | None, typer.Option(help="Of the page.")] = None,
) -> None:
    """Write a page with tables, charts, curves and clips of failures; it needs neither network nor server.

    Failures are filmed by driving logged episodes again. Several runs are compared where their evaluations have the
    same maps, densities, weather, number of episodes and seed.
    """
    if clips < 0:
        raise UserError(f"{clips} is negative", where="--clips")
    from me3bev_cli.output import console
    from me3bev_cli.pretrained import default_run
    from me3bev_cli.reporting.build import build, check_out
    from me3bev_cli.reporting.sources import gather

    check_out(out)
    names = runs or [default_run()]
    sources = gather(names, latency or ())
    built = build(sources, out, title, clips, [str(name) for name in names], _told)
    for sentence in (*built.warnings, *(f"a clip is left out: {reason}" for reason in built.left_out)):
        typer.echo(f"me3bev: {sentence}", err=True)
    size = sum(path.stat().st_size for path in out.rglob("*") if path.is_file())
    place = console()
    place.print(
        f"{len(sources.evaluations)} evaluations, {len(sources.runs)} runs, {built.clips} clips, {size / 1e6:.1f} MB"
    )
    place.print(f"wrote {built.page}", markup=False, soft_wrap=True)


def _told(done: int, total: int) -> None:
    """How far the clips are."""
    if sys.stderr.isatty():
        typer.echo(f"\rclip {done} of {total}{'' if done < total else chr(10)}", nl=False, err=True)

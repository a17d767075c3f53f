"""`me3bev collect`: drive episodes and record them as MCAP files."""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import Annotated

import typer


def collect(
    out: Annotated[Path, typer.Option(help="Folder of the MCAP files.")],
    maps: Annotated[str | None, typer.Option(help="As T1-T7 or T1,T3. Default: every map.")] = None,
    density: Annotated[str | None, typer.Option(help="As low,high. Default: low.")] = None,
    weather: Annotated[
        str | None,
        typer.Option(help="As clear_noon,night or all, training, evaluation. Default: the recipe's training set."),
    ] = None,
    driver: Annotated[str, typer.Option(help="autopilot, idle, random, pretrained, or a run.")] = "autopilot",
    recipe: Annotated[str | None, typer.Option(help="Observation and world. Default: highway as it comes.")] = None,
    episodes: Annotated[int, typer.Option(help="For each map and density.", min=1)] = 5,
    workers: Annotated[int, typer.Option(help="Processes; 0: this one.", min=0)] = 0,
    seed: Annotated[int, typer.Option(help="Of routes and traffic.", min=0)] = 0,
    quality: Annotated[int | None, typer.Option(help="Of JPEG images. Default: 92.", min=1, max=100)] = None,
    png: Annotated[bool, typer.Option("--png", help="Lossless PNG images instead of JPEG.")] = False,
    depth: Annotated[bool, typer.Option("--depth", help="Every camera's depth, too.")] = False,
    semantics: Annotated[bool, typer.Option("--semantics", help="The class of every camera's pixels, too.")] = False,
    json: Annotated[str | None, typer.Option(help="Write what was recorded.", metavar="FILE|-")] = None,
) -> None:
    """Drive episodes and record them as MCAP files, one for each, which viewers open.

    The same command goes on where it was stopped; the files are the same for any number of workers.
    """
    import cv2

    from me3bev_cli.errors import UserError
    from me3bev_cli.evaluation.choice import choose_cells, choose_driver, reference_or_run
    from me3bev_cli.output import write_json
    from me3bev_cli.recording.collect import Recorder, Take
    from me3bev_cli.recording.collect import collect as record_all
    from me3bev_cli.recording.writer import Options
    from me3bev_cli.training.display import clock

    if png and quality is not None:
        raise UserError("PNG images have no quality", where="--png", hint="Give --png or --quality")
    cv2.setNumThreads(1)  # Images of this size are encoded sooner than threads are woken.
    name, run = reference_or_run(driver)
    spec, loaded = choose_driver(run, "last", name, recipe, "auto")
    cells = choose_cells(loaded, maps, density, weather, "training")
    options = Options(0 if png else 92 if quality is None else quality, depth, semantics)
    recorder = Recorder(cells.world, spec, seed, out, options)
    takes = [Take(m, d, i) for d in cells.densities for m in cells.maps for i in range(episodes)]
    start, done, total_steps = time.monotonic(), 0, 0

    def shown(take: Take, steps: int) -> None:
        nonlocal done, total_steps
        done, total_steps = done + 1, total_steps + steps
        seconds = time.monotonic() - start
        left = clock(seconds / done * (len(takes) - done))
        print(f"{take.path(out)}  {steps} steps  {total_steps / seconds:.0f} steps/s  left {left}", file=sys.stderr)

    written = record_all(recorder, takes, workers, shown)
    files = [take.path(out) for take in takes]
    size = sum(path.stat().st_size for path in files)
    print(f"{written} episodes written, {len(files)} in {out}, {size / 1e6:.1f} MB", file=sys.stderr)
    if json is not None:
        write_json({"files": [str(path) for path in files], "written": written, "bytes": size}, json)

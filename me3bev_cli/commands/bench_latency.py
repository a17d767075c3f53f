"""`me3bev bench-latency`: time from raw observation to action, for each recipe and stage."""

from __future__ import annotations

import sys
from typing import Annotated, Any

import typer


def bench_latency(
    recipes: Annotated[
        list[str] | None, typer.Argument(help="Recipes to compare. Default: every shipped full-size recipe.")
    ] = None,
    batch: Annotated[int, typer.Option(help="Observations per call.", min=1)] = 1,
    repeats: Annotated[int, typer.Option(help="Timed calls of each recipe.", min=1)] = 50,
    warmup: Annotated[int, typer.Option(help="Calls before the timing begins.", min=1)] = 5,
    threads: Annotated[int | None, typer.Option(help="CPU threads. Default: all cores.", min=1)] = None,
    device: Annotated[str, typer.Option(help="auto, cpu or cuda.")] = "auto",
    json: Annotated[str | None, typer.Option(help="Write the figures.", metavar="FILE|-")] = None,
) -> None:
    """Time each recipe's policy from raw observation to action."""
    import torch

    from me3bev_cli.bench.latency import measure
    from me3bev_cli.output import write_json
    from me3bev_cli.pipeline.assemble import pick_device
    from me3bev_cli.recipe_loading import resolve_recipe, shipped_recipes

    # me3bev_weather has the network of me3bev.
    names = recipes or [name for name in shipped_recipes() if name not in ("me3bev_weather", "quickstart", "small")]
    loaded = [resolve_recipe(name) for name in names]
    if threads is not None:
        torch.set_num_threads(threads)
    place = pick_device(device)
    setup = {
        "timed": "uint8 images and features in host memory -> clipped action in host memory, with the policy's memory",
        "not_timed": "simulator, building the network, warm-up calls",
        "device": torch.cuda.get_device_name(place) if place.type == "cuda" else "cpu",
        "threads": torch.get_num_threads(),
        "dtype": "float32",
        "batch": batch,
        "repeats": repeats,
        "torch": torch.__version__,
    }
    rows = measure(loaded, place, batch=batch, warmup=warmup, repeats=repeats, progress=_show)
    _print(setup, rows, json)
    if json is not None:
        write_json({"setup": setup, "rows": rows}, json)


def _show(done: int, total: int) -> None:
    """A counter on stderr, in a terminal only."""
    if sys.stderr.isatty():
        sys.stderr.write(f"\rround {done}/{total}" + ("\r\x1b[2K" if done == total else ""))
        sys.stderr.flush()


def _print(setup: dict[str, Any], rows: list[dict[str, Any]], json: str | None) -> None:
    from rich import box
    from rich.table import Table

    from me3bev_cli.output import console

    place = console(json)
    place.print(f"timed: {setup['timed']}\nnot timed: {setup['not_timed']}")
    place.print(
        f"{setup['device']}, {setup['threads']} threads, {setup['dtype']}, batch {setup['batch']}, "
        f"{setup['repeats']} calls each, taking turns; torch {setup['torch']}"
    )
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, caption="milliseconds; stages are medians", padding=(0, 1, 0, 0))
    table.add_column("recipe", no_wrap=True)
    for name in ("params", "median", "p95", "p99", "fps", *(stage.split("_")[0] for stage in rows[0]["stages"])):
        table.add_column(name, justify="right", no_wrap=True)
    for row in rows:
        table.add_row(
            row["name"],
            f"{row['parameters'] / 1e6:.1f}M",
            *(f"{row[key]:.1f}" for key in ("median_ms", "p95_ms", "p99_ms", "frames_per_s")),
            *(f"{value:.1f}" for value in row["stages"].values()),
        )
    place.print(table)

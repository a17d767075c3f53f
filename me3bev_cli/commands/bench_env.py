"""`me3bev bench-env`: what a step of the simulator costs, beside stock highway-env and beside the floor."""

from __future__ import annotations

import sys
from typing import Annotated, Any

import typer


def bench_env(
    map: Annotated[str, typer.Option(help="Map to drive on.", metavar="MAP")] = "T3",
    density: Annotated[str, typer.Option(help="Traffic density.")] = "high",
    simulator: Annotated[str, typer.Option(help="Simulator plugin.")] = "highway",
    seconds: Annotated[
        float, typer.Option(help="Seconds of stepping in all, shared by what is compared.", min=0.01)
    ] = 60,
    rounds: Annotated[int, typer.Option(help="Turns that each of them takes.", min=1)] = 10,
    workers: Annotated[
        int, typer.Option(help="Environments in workers, as many, to compare with one in one; 1: leave out.", min=1)
    ] = 2,
    json: Annotated[str | None, typer.Option(help="Write the figures.", metavar="FILE|-")] = None,
) -> None:
    """Time the simulator: steps per second, resets, memory.

    Timed are calls of `step`, with the images and features that it returns, in a process with one thread. The
    autopilot that chooses the actions is not, nor are resets, which are reported by themselves. Everything takes
    turns with stock highway-env (100 vehicles at 10 Hz, no images).
    """
    from me3bev_cli.bench.environment import chosen_world, measure
    from me3bev_cli.bench.machine import machine
    from me3bev_cli.output import write_json
    from me3bev_cli.training.run import versions

    world = chosen_world(simulator, map, density)
    here = machine()
    setup = {
        "simulator": simulator,
        "map": map,
        "density": density,
        "cameras": len(world.observation.cameras),
        "height": world.observation.height,
        "width": world.observation.width,
        "seconds": seconds,
        "rounds": rounds,
    }
    figures = measure(world, seconds=seconds, rounds=rounds, workers=workers, progress=_show)
    report = figures | {"setup": setup, "machine": here, "versions": versions()}
    _print(report, json)
    if json is not None:
        write_json(report, json)


def _show(done: int, total: int) -> None:
    """A counter on stderr, in a terminal only."""
    if sys.stderr.isatty():
        sys.stderr.write(f"\rround {done}/{total}" + ("\r\x1b[2K" if done == total else ""))
        sys.stderr.flush()


def _print(report: dict[str, Any], json: str | None) -> None:
    from rich import box
    from rich.table import Table

    from me3bev_cli.output import console

    place = console(json)
    setup, here = report["setup"], report["machine"]
    place.print(
        f"{setup['map']}, {setup['density']} density, {setup['cameras']} images of {setup['height']} x "
        f"{setup['width']}; one thread of {here['processor']}, {here['cores']} cores, load {here['load']}"
    )
    place.print(
        f"medians of {setup['rounds']} rounds in turns; timed: step(), without resets and the choice of actions"
    )
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, padding=(0, 2, 0, 0))
    table.add_column("", no_wrap=True)
    for name in ("measured", "quartiles", "target"):
        table.add_column(name, justify="right", no_wrap=True)
    for label, key, form, target in _ROWS:
        if report[key] is not None:
            spread = report["spread"].get(key)
            quartiles = f"{spread[0]:{form}} .. {spread[1]:{form}}" if spread else ""
            wanted = f"{target} {report['targets'][key]:g}" if target else ""
            table.add_row(label, f"{report[key]:{form}}", quartiles, wanted)
    place.print(table)
    _print_scaling(place, report)
    floor = report["floor"]
    place.print(
        f"floor: a step writes {floor['bytes_written']:,} bytes; filling them takes {floor['write_us']:.0f} us, "
        f"copying as many {floor['copy_us']:.0f} us:\n"
        f"       the step's {floor['step_us']:.0f} us are {floor['times_write']:.0f} and "
        f"{floor['times_copy']:.0f} times that; its tables hold {floor['table_bytes']:,} bytes,\n"
        f"       of which it reads a part: all of them take {floor['read_tables_us']:.0f} us"
    )


_ROWS = (
    ("whole environment, steps/s", "full_steps_per_s", ".0f", ""),
    ("without cameras, steps/s", "no_camera_steps_per_s", ".0f", ""),
    ("stock highway-env, steps/s", "stock_highway_env_steps_per_s", ".1f", ""),
    ("whole / stock", "full_ratio", ".1f", "at least"),
    ("without cameras / stock", "no_camera_ratio", ".0f", "at least"),
    ("reset, ms", "reset_ms", ".1f", "below"),
    ("reset, 95th percentile, ms", "reset_p95_ms", ".1f", ""),
    ("memory of a process with one environment, MB", "rss_mb", ".0f", "below"),
    ("of that, numpy, gymnasium and numba, MB", "libraries_rss_mb", ".0f", ""),
    ("two environments in two workers / one in one", "two_workers_ratio", ".2f", "at least"),
)
"""Label, key, format, and how the target is meant."""


def _print_scaling(place: Any, report: dict[str, Any]) -> None:
    """A line for each way to measure."""
    if not report["scaling"]:
        return
    for key, label in (("full_ms", "whole"), ("no_camera_ms", "without cameras")):
        costs = ", ".join(f"{row['actors']}: {row[key]:.3f}" for row in report["scaling"])
        place.print(f"ms per step by actors, {label}: {costs}; grows as n^{report['growth'][key]:.2f}")

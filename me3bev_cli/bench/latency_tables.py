"""What `me3bev bench-latency` tells people: conditions, ceilings, tables."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from me3bev_cli.bench.latency_network import STAGES
from me3bev_cli.bench.latency_rows import Row
from me3bev_cli.bench.latency_scores import Point

if TYPE_CHECKING:
    from rich.table import Table

TIMED = "uint8 images and features in host memory -> clipped action in host memory, with the policy's memory"
NOT_TIMED = "simulator, building the network, warm-up"
SHARED = "contexts of a network share each frame's sensor and encoder; a stage is everything up to its result"
KINDS = ("window", "stream", "none")
VISIBLE_FLOOR_MS = 1e-3
"""A ratio to less than this says nothing."""


def preface(report: dict[str, Any]) -> list[str]:
    """What is timed, on what, and how fast that is at most."""
    setup, here, top = report["setup"], report["machine"], report["ceilings"]
    threads = f"{setup['threads']} thread{'s' if setup['threads'] > 1 else ''}"
    how = f"{here['processor']}, {here['cores']} cores, load {here['load']}"
    graphs = f", graphs {'where they apply' if setup['graphs'] else 'off'}" if setup["graphs"] is not None else ""
    side, megabytes = top["matrix_side"], top["read_bytes"] / 2**20
    return [
        f"timed:     {setup['timed']}",
        f"not timed: {setup['not_timed']}",
        f"device:    {setup['device']}{graphs}; {how}",
        f"           {threads}, {setup['dtype']}, batch {setup['batch']}; torch {report['versions']['torch']}",
        f"calls:     up to {setup['repeats']} per context in {setup['seconds']:g} s, after {setup['warmup']}; networks "
        f"take turns frame by frame;",
        f"           {setup['shared']}",
        f"ceilings:  {number(top['multiply_flops_per_s'] / 1e9)} GFLOP/s ({side} x {side} matrices), "
        f"{number(top['read_bytes_per_s'] / 1e9)} GB/s read ({megabytes:.0f} MiB); medians of {top['samples']}, "
        "in the same turns",
    ]


def of_people(rows: Sequence[Row]) -> list[Row]:
    """A row per network: its own context (of a stream the longest), else the first that was timed."""
    chosen: dict[str, Row] = {}
    for row in rows:
        if row["name"] not in chosen or row["own"]:
            chosen[row["name"]] = row
    return list(chosen.values())


def tables(rows: Sequence[Row]) -> list[tuple[str, Table]]:
    """Headlines and tables: the whole, the stages, the contexts."""
    shown = of_people(rows)
    found = [
        ("whole, milliseconds; x floor: the median over the sum of the stages' floors", _whole(shown)),
        (
            "stages, median milliseconds (x floor = max of FLOPs / GFLOP/s and bytes of parameters and inputs / GB/s)",
            _stages(shown),
        ),
    ]
    if len(rows) > len(shown):
        found.append(("by context in frames, median milliseconds of the whole", _contexts(rows)))
    return found


def _table(first: str, columns: Sequence[str]) -> Table:
    from rich import box
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, padding=(0, 1, 0, 0), show_edge=False)
    table.add_column(first, no_wrap=True)
    for name in columns:
        table.add_column(name, justify="right", no_wrap=True)
    return table


def _whole(rows: Sequence[Row]) -> Table:
    titles = ("context", "params", "GFLOP", "MiB", "median", "p95", "p99", "frames/s", "x floor", "calls")
    table = _table("network", titles)
    for row in rows:
        table.add_row(
            row["name"],
            context(row),
            f"{row['parameters'] / 1e6:.1f}M",
            f"{row['flops'] / 1e9:.2f}",
            f"{row['peak_memory_bytes'] / 2**20:.0f}",
            *(number(row[key]) for key in ("median_ms", "p95_ms", "p99_ms", "frames_per_s", "floor_ratio")),
            str(row["calls"]),
        )
    return table


def _stages(rows: Sequence[Row]) -> Table:
    table = _table("network", STAGES)
    for row in rows:
        cells = []
        for stage in STAGES:
            detail = row["stage_details"][stage]
            seen = detail["floor_ms"] >= VISIBLE_FLOOR_MS
            cells.append(f"{detail['median_ms']:.2f}" + (f" ({number(detail['floor_ratio'])})" if seen else ""))
        table.add_row(row["name"], *cells)
    return table


def _contexts(rows: Sequence[Row]) -> Table:
    keys = sorted({(row["context"], row["length"]) for row in rows}, key=lambda key: (KINDS.index(key[0]), key[1]))
    table = _table("network", [f"{kind}\n{length}" for kind, length in keys])
    by_name: dict[str, dict[tuple[str, int], Row]] = {}
    for row in rows:
        by_name.setdefault(row["name"], {})[row["context"], row["length"]] = row
    for name, found in by_name.items():
        table.add_row(name, *(number(found[key]["median_ms"]) if key in found else "-" for key in keys))
    return table


def score_tables(points: Sequence[Point]) -> list[tuple[str, Table]]:
    """A table of speed and driving score per cell, fastest first."""
    found = []
    for cell in dict.fromkeys(point.score.cell for point in points):
        table = _table("run", ("context", "checkpoint", "median", "p95", "driving score", "front"))
        for point in sorted((p for p in points if p.score.cell == cell), key=lambda p: p.median_ms):
            score = point.score
            ends = "" if score.low is None or score.high is None else f" ({score.low:.1f}..{score.high:.1f})"
            table.add_row(
                score.run,
                point.context,
                score.checkpoint,
                number(point.median_ms),
                number(point.p95_ms),
                f"{score.mean:.1f}{ends}",
                "*" if point.front else "",
            )
        found.append((f"speed and driving score: {cell}; * no other is both faster and better", table))
    return found


def context(row: Row) -> str:
    """As `window 4`."""
    return f"{row['context']} {row['length']}" if row["context"] != "none" else "none"


def number(value: float) -> str:
    """Three figures, no exponent."""
    return f"{value:.{max(0, 2 - len(str(int(abs(value)))) + 1)}f}"

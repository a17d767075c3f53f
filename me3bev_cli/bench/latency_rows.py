"""From samples to rows: quantiles, rates, ratios to the machine's floor; rows as CSV; what is over a budget."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from me3bev_cli.bench.latency import Measured
from me3bev_cli.bench.latency_network import STAGES, Variant
from me3bev_cli.bench.machine_ceilings import Ceilings

Row = dict[str, Any]

WHOLE = (
    "name", "spatial", "temporal", "fusion", "context", "length", "own", "calls", "median_ms", "p95_ms", "p99_ms",
    "frames_per_s", "parameters", "flops", "peak_memory_bytes", "floor_ms", "floor_ratio",
)  # fmt: skip
"""What a row says of the whole, in the order of the CSV's columns."""
PER_STAGE = ("median_ms", "p95_ms", "p99_ms", "frames_per_s", "parameters", "flops", "peak_memory_bytes", "floor_ms",
             "floor_ratio")  # fmt: skip


def rows(measured: Measured) -> list[Row]:
    """A row per network and context that was timed."""
    return [_row(variant, measured.ceilings) for variant in measured.variants]


def _row(variant: Variant, ceilings: Ceilings) -> Row:
    recipe, context = variant.bench.subject.recipe, variant.context
    batch = variant.bench.conditions.batch
    samples = np.array(variant.samples)
    details = {}
    for stage, times in zip(STAGES, samples.T, strict=True):
        cost = variant.costs[stage]
        floor = ceilings.floor_ms(cost.flops, cost.read_bytes)
        costs = {"parameters": cost.parameters, "flops": cost.flops, "peak_memory_bytes": cost.peak_bytes}
        details[stage] = _times(times, batch, floor) | costs
    floor = sum(detail["floor_ms"] for detail in details.values())
    chosen = {kind: getattr(recipe, kind) for kind in ("spatial", "temporal", "fusion")}
    return {
        "name": variant.bench.subject.name,
        **{kind: choice.name if choice is not None else None for kind, choice in chosen.items()},
        "context": context.kind,
        "length": context.length,
        "own": context.own,
        "calls": len(samples),
        **_times(samples.sum(1), batch, floor),
        "parameters": variant.parameters(),
        "flops": sum(cost.flops for cost in variant.costs.values()),
        "peak_memory_bytes": variant.peak_bytes(),
        "stages": {stage: detail["median_ms"] for stage, detail in details.items()},
        "stage_details": details,
    }


def _times(times: NDArray[np.float64], batch: int, floor: float) -> dict[str, float]:
    median, p95, p99 = (float(q) for q in np.percentile(times, [50, 95, 99]))
    return {
        "median_ms": median,
        "p95_ms": p95,
        "p99_ms": p99,
        "frames_per_s": 1000 * batch / median,
        "floor_ms": floor,
        "floor_ratio": median / floor,
    }


def over_budget(found: Sequence[Row], budget_ms: float, every: bool) -> list[Row]:
    """Rows whose 95th percentile exceeds the budget: of all of them, or of each network's own context."""
    return [row for row in found if row["p95_ms"] > budget_ms and (every or row["own"])]


def csv_text(found: Sequence[Row]) -> str:
    """The rows as CSV: the whole, then each stage's figures as STAGE_FIGURE."""
    buffer = io.StringIO()
    fields = [*WHOLE, *(f"{stage}_{figure}" for stage in STAGES for figure in PER_STAGE)]
    writer = csv.DictWriter(buffer, fields, lineterminator="\n")
    writer.writeheader()
    for row in found:
        stages = {f"{stage}_{key}": value for stage, of in row["stage_details"].items() for key, value in of.items()}
        writer.writerow({key: row[key] for key in WHOLE} | stages)
    return buffer.getvalue()

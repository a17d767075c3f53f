"""What of a comparison is kept beside the recipes: small files that say what was found and by which commands."""

from __future__ import annotations

import json
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from me3bev_cli.evaluation.folder import CSV, JSON, MARKDOWN
from me3bev_cli.evaluation.summary import AVERAGE
from me3bev_cli.output import write_json
from me3bev_cli.training.curve import read_metrics
from me3bev_cli.training.listing import find_runs, finished

BY_MAP = ("collision_rate", "driving_score", "route_completion")
"""Metrics whose figures are kept for each map, too."""
DIGITS = 4
POINTS = 60
"""Of a curve."""
EVALUATED = {"eval_score": "driving_score", "eval_collision_rate": "collision_rate", "eval_completion": "completion"}


def write_results(out: Path, results: Path, commands: Mapping[str, str]) -> list[Path]:
    """Write comparison.json, and copies of tables and pictures; returns the files.

    Args:
        out: where `bench.comparison` keeps runs and evaluations; what is not there yet is left out.
        results: the folder to write into; `out` itself keeps its copies where they are.
        commands: name of a part -> what was typed.
    """
    results.mkdir(parents=True, exist_ok=True)
    document: dict[str, Any] = {"commands": dict(commands)}
    for key, folder in (("imitation_start", "eval"), ("from_scratch", "eval-scratch")):
        if (out / folder / JSON).is_file():
            document[key] = table(json.loads((out / folder / JSON).read_text(encoding="utf-8")))
    for key, name in (("convergence", "convergence.json"), ("convergence_from_scratch", "convergence-scratch.json")):
        if (out / name).is_file():
            document[key] = curves(json.loads((out / name).read_text(encoding="utf-8")))
    if (out / "latency.json").is_file():
        document["latency"] = latency(json.loads((out / "latency.json").read_text(encoding="utf-8")))
    document["training"] = [training(run) for run in sorted(find_runs(out)) if finished(run)]
    written = [results / "comparison.json"]
    write_json(document, str(written[0]))
    copies = {
        out / "convergence.png": "convergence.png",
        out / "convergence-scratch.png": "convergence-scratch.png",
        out / "eval" / CSV: "table.csv",
        out / "eval" / MARKDOWN: "table.md",
        out / "eval-scratch" / CSV: "scratch.csv",
    }
    for source, name in copies.items():
        if source.is_file() and source != results / name:
            shutil.copyfile(source, results / name)
            written.append(results / name)
    return written


def table(data: Mapping[str, Any]) -> dict[str, Any]:
    """An evaluation's averages with intervals, some figures of each map, and the paired differences."""
    keys = ("me3bev", "versions", "maps", "densities", "episodes", "seed", "interval")
    found: dict[str, Any] = {key: data[key] for key in keys if key in data}
    found["methods"] = [{key: m[key] for key in ("method", "recipe", "checkpoint")} for m in data.get("methods", ())]
    found["averages"] = [_row(row) for row in data["rows"] if row["map"] == AVERAGE]
    found["by_map"] = [_row(row) for row in data["rows"] if row["map"] != AVERAGE and row["metric"] in BY_MAP]
    if "comparisons" in data:
        names = ("method", "density", "metric", "difference", "low", "high", "improvement", "n", "verdict")
        compared = [c for c in data["comparisons"] if c["map"] == AVERAGE]
        found["baseline"] = data["baseline"]
        found["paired_differences"] = [{name: _rounded(c[name]) for name in names} for c in compared]
    if "published" in data:
        rows = [_row(row) for row in data["published"]["rows"] if row["map"] == AVERAGE]
        found["published"] = {"note": data["published"]["note"], "averages": rows}
    return found


def _row(row: Mapping[str, Any]) -> dict[str, Any]:
    return {key: _rounded(value) for key, value in row.items()}


def _rounded(value: Any) -> Any:
    return round(value, DIGITS) if isinstance(value, float) else value


def curves(data: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Convergence by recipe: figures, and the curve thinned out."""
    found = []
    for group in data["groups"]:
        stride = max(1, len(group["steps"]) // POINTS)
        lines = {key: [_rounded(value) for value in group[key][::stride]] for key in ("steps", "mean", "low", "high")}
        keys = ("label", "plateau", "threshold", "reaches_90_percent_at", "still_rising")
        runs = [{**run, "run": Path(run["run"]).name} for run in group["runs"]]
        found.append({key: _rounded(group[key]) for key in keys} | {"runs": runs} | lines)
    return found


def latency(data: Mapping[str, Any]) -> dict[str, Any]:
    """The networks' own contexts, as `me3bev bench-latency` timed them."""
    keys = ("name", "spatial", "temporal", "fusion", "context", "length", "median_ms", "p95_ms", "parameters")
    rows = [{key: _rounded(row[key]) for key in keys} for row in data["rows"] if row["own"]]
    return {"setup": data["setup"], "machine": data["machine"], "rows": rows}


def training(run: Path) -> dict[str, Any]:
    """What a run cost, and how it drove on the way."""
    summary = json.loads((run / "summary.json").read_text(encoding="utf-8"))
    evaluated = [row for row in read_metrics(run) if "eval_score" in row]
    return {
        "run": run.name,
        **{
            key: _rounded(summary[key])
            for key in ("recipe", "seed", "steps", "seconds", "parameters")
            if key in summary
        },
        "evaluations": [
            {"steps": row["steps"], **{name: _rounded(row[key]) for key, name in EVALUATED.items()}}
            for row in evaluated
        ],
    }

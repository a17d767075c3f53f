"""Two figures of each method against each other: comfort and efficiency, latency and driving score."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from me3bev_cli.reporting.bars import Picture
from me3bev_cli.reporting.chart import Chart, tick_values
from me3bev_cli.reporting.figures import whole
from me3bev_cli.reporting.suites import Suite
from me3bev_cli.reporting.tables import Cell, Column, Table


def comfort_chart(suite: Suite, density: str) -> Picture | None:
    """Efficiency against comfort, with both intervals; None where no method has both."""
    found = []
    for number, method in enumerate(suite.methods):
        pair = [suite.row(method.label, density, name) for name in ("efficiency", "comfort")]
        if all(row is not None and not math.isnan(row.mean) for row in pair):
            found.append((number, method.label, pair))
    if not found:
        return None
    ends = [v for _, _, (x, _) in found if x is not None for v in (x.mean, x.high) if not math.isnan(v)]
    chart = Chart((0.0, _above(ends)), (0.0, 1.0), f"Comfort against efficiency, {density} density")
    chart.axes("efficiency (ego's speed over traffic's)", "comfort (share of segments)")
    for number, label, (x, y) in found:
        assert x is not None
        assert y is not None
        if not math.isnan(x.low):
            chart.whisker_across(y.mean, x.low, x.high)
        if not math.isnan(y.low):
            chart.whisker(x.mean, y.low, y.high)
        chart.dot(x.mean, y.mean, number, f"{label}: efficiency {whole(x)}, comfort {whole(y)}")
    return Picture(f"Comfort against efficiency, {density} density; bars: 95 % intervals", chart.svg())


def _above(values: Sequence[float]) -> float:
    """A round end of an axis from 0."""
    top = max([*values, 1e-9])
    steps = tick_values(0.0, 1.08 * top)
    return max(1.08 * top, steps[-1] + 0.2 * (steps[1] - steps[0]) if len(steps) > 1 else 0.0)


@dataclass
class Pareto:
    """Latency against driving score."""

    pictures: list[Picture] = field(default_factory=list)
    tables: list[Table] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    data: list[dict[str, Any]] = field(default_factory=list)


def pareto(suites: Sequence[Suite], benches: Sequence[tuple[Path, dict[str, Any]]]) -> Pareto:
    """Every bench beside the scores of the same runs: from the suites, by the name of run or recipe; else its own."""
    found = Pareto()
    for path, bench in benches:
        points = [p for suite in suites for density in suite.densities for p in _points(suite, density, bench["rows"])]
        points = points or _own(bench)
        if not points:
            names = ", ".join(dict.fromkeys(str(row["name"]) for row in bench["rows"]))
            found.notes.append(f"{path} has the speed of {names}, none of which is a method of this report.")
            continue
        setup = bench["setup"]
        count = setup.get("threads")
        threads = f", {count} thread{'s' if count > 1 else ''}" if count else ""
        found.notes.append(
            f"{path}: raw observation to action on {setup['device']}{threads}, {setup['dtype']}, "
            f"batch {setup['batch']}."
        )
        for cell in dict.fromkeys(p["cell"] for p in points):
            _front(found, cell, [p for p in points if p["cell"] == cell])
    return found


def _points(suite: Suite, density: str, rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    points = []
    for number, method in enumerate(suite.methods):
        score = suite.row(method.label, density, "driving_score")
        run = method.about.get("run")
        names = {Path(run).resolve().name, method.name} if run else set()
        timed = [row for row in rows if row["name"] in names]
        own = next((row for row in timed if row.get("own")), timed[0] if timed else None)
        if score is None or math.isnan(score.mean) or own is None:
            continue
        context = f"{own.get('context', '')} {own.get('length', '')}".strip()
        speed = {"context": context, "median_ms": float(own["median_ms"]), "p95_ms": float(own["p95_ms"])}
        ends = {"score": score.mean, "low": _number(score.low), "high": _number(score.high)}
        cell = f"{suite.places}, {density} density"
        points.append({"run": method.label, "series": number, "cell": cell, **speed, **ends})
    return points


def _own(bench: Mapping[str, Any]) -> list[dict[str, Any]]:
    """The scores that `bench-latency --with-scores` found itself."""
    keys = ("run", "cell", "context", "median_ms", "p95_ms", "score", "low", "high")
    rows = [row for row in bench.get("scores") or () if all(key in row for key in keys)]
    names = list(dict.fromkeys(row["run"] for row in rows))
    return [{"series": names.index(row["run"]), **{key: row[key] for key in keys}} for row in rows]


def _number(value: float) -> float | None:
    return None if math.isnan(value) else value


def _front(found: Pareto, cell: str, points: list[dict[str, Any]]) -> None:
    """Draw one cell; a point is on the front when no other is as fast and as good and better in one of the two."""
    for point in points:
        mine = (-point["median_ms"], point["score"])
        others = [(-p["median_ms"], p["score"]) for p in points]
        point["front"] = not any(o[0] >= mine[0] and o[1] >= mine[1] and o != mine for o in others)
    chart = Chart((0.0, _above([p["p95_ms"] for p in points])), (0.0, 100.0), f"Driving score against latency, {cell}")
    chart.axes("median latency, ms (bar to the 95th percentile)", "driving score")
    chart.line(sorted((p["median_ms"], p["score"]) for p in points if p["front"]), "line front")
    for p in points:
        chart.whisker_across(p["score"], p["median_ms"], p["p95_ms"])
        if p["low"] is not None:
            chart.whisker(p["median_ms"], p["low"], p["high"])
        said = f"{p['run']}, {p['context']}: {p['median_ms']:.1f} ms, driving score {p['score']:.1f}"
        chart.dot(p["median_ms"], p["score"], p["series"], said, hollow=not p["front"])
    found.pictures.append(Picture(f"{cell}; filled: none is faster and better", chart.svg()))
    columns = [Column("run", numeric=False), Column("context", numeric=False), Column("median, ms ↓"),
               Column("95th percentile, ms ↓"), Column("driving score ↑"), Column("front", numeric=False)]  # fmt: skip
    lines = []
    for p in points:
        ends = "" if p["low"] is None else f"{p['low']:.1f} to {p['high']:.1f}"
        front = "yes" if p["front"] else "no"
        lines.append([
            Cell(p["run"], p["run"], series=p["series"]), Cell(p["context"], p["context"]),
            Cell(f"{p['median_ms']:.2f}", p["median_ms"]), Cell(f"{p['p95_ms']:.2f}", p["p95_ms"]),
            Cell(f"{p['score']:.1f}", p["score"], ends), Cell(front, front),
        ])  # fmt: skip
    found.tables.append(Table(f"Latency and driving score, {cell}", columns, lines))
    found.data += points

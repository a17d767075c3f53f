"""`me3bev report` from its sources to its folder.

OUT/
    index.html     the page
    clips/         what it plays
    report.json    every figure of it
"""

from __future__ import annotations

import json
import shlex
import shutil
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from me3bev_cli import __version__
from me3bev_cli.errors import UserError
from me3bev_cli.evaluation.definitions import METRICS
from me3bev_cli.evaluation.published import NOTE
from me3bev_cli.files import atomic_write_text
from me3bev_cli.output import write_json
from me3bev_cli.recipe_diff import Difference, differences, run_recipe, shown
from me3bev_cli.reporting import bars, tables
from me3bev_cli.reporting.curves import curves
from me3bev_cli.reporting.gallery import Failures, tell_failures
from me3bev_cli.reporting.page import render
from me3bev_cli.reporting.pairing import pair
from me3bev_cli.reporting.reproduce import Step, evaluated, timed, trained
from me3bev_cli.reporting.scatter import comfort_chart, pareto
from me3bev_cli.reporting.sources import Sources
from me3bev_cli.reporting.suites import Suite, suites
from me3bev_cli.reporting.summary import beside, cards, leading

PAGE, DATA, CLIPS, STAGE = "index.html", "report.json", "clips", ".report.part"
NAMED = 4
"""So many methods are named in a title."""
KIND = "me3bev report"
"""In the data file: whose folder it is."""


@dataclass(frozen=True)
class Built:
    """What was written."""

    page: Path
    clips: int
    left_out: Sequence[str]
    """Why clips are missing, a sentence each."""
    warnings: Sequence[str]


def check_out(out: Path) -> None:
    """Raises UserError when the folder holds something other than a report."""
    if out.exists() and not out.is_dir():
        raise UserError(f"{out} is not a folder", where="--out")
    held = [path.name for path in out.iterdir() if path.name != STAGE] if out.is_dir() else []
    if held and not _is_report(out):
        raise UserError(f"{out} exists and holds something other than a report", where="--out", hint="Choose another")


def _is_report(out: Path) -> bool:
    try:
        return bool(json.loads((out / DATA).read_text(encoding="utf-8"))["kind"] == KIND)
    except (OSError, ValueError, KeyError, TypeError):
        return False


def build(
    sources: Sources, out: Path, title: str | None, clips: int, names: Sequence[str], told: Callable[[int, int], None]
) -> Built:
    """Write the report; an earlier one in the folder is replaced when the new one is whole.

    Args:
        clips: of each kind of failure at most.
        names: what was named on the command line.
        told: called with the number of clips that are done, and of all.

    Raises:
        UserError: the folder holds something else, or cannot be written.
    """
    check_out(out)
    found = suites(sources.evaluations)
    for suite in found:
        pair(suite)
    stage = out / STAGE
    try:
        shutil.rmtree(stage, ignore_errors=True)
        (stage / CLIPS).mkdir(parents=True)
        failed = tell_failures(found, clips, stage, told)
        document, page = _contents(sources, found, failed, title, names, out)
        shutil.rmtree(out / CLIPS, ignore_errors=True)
        if any((stage / CLIPS).iterdir()):
            (stage / CLIPS).rename(out / CLIPS)
        write_json(document, str(out / DATA))
        atomic_write_text(out / PAGE, page)
    except OSError as error:
        raise UserError(f"cannot be written: {error.strerror}", where=str(out)) from error
    finally:
        shutil.rmtree(stage, ignore_errors=True)
    reasons = [one["reason"] for one in failed.data if one["reason"]]
    made = sum(1 for one in failed.data if one["clip"])
    return Built(out / PAGE, made, list(dict.fromkeys(reasons)), failed.warnings)


def _contents(
    sources: Sources, found: Sequence[Suite], failed: Failures, title: str | None, names: Sequence[str], out: Path
) -> tuple[dict[str, Any], str]:
    """The data and the page."""
    methods = list(dict.fromkeys(method.label for suite in found for method in leading(suite)))
    given = title
    title = title or f"Evaluation of {', '.join(methods) if len(methods) <= NAMED else f'{len(methods)} methods'}"
    learned, speed = curves(sources.runs), pareto(found, sources.latency)
    runs, keys, faulty = _recipes(sources.runs)
    words = [
        *("--latency " + shlex.quote(str(path)) for path, _ in sources.latency),
        *(["--title", shlex.quote(given)] if given else []),
    ]
    steps: list[Step] = [
        *map(trained, sources.runs), *map(evaluated, sources.evaluations), *(timed(*one) for one in sources.latency),
    ]  # fmt: skip
    warnings = [*failed.warnings, *faulty, *_lost(sources)]
    context = {
        "title": title,
        "subtitle": _subtitle(found),
        "version": __version__,
        "suites": [_suite(suite) for suite in found],
        "baselines": list(dict.fromkeys(suite.baseline for suite in found if suite.baseline)),
        "published_note": NOTE,
        "curves": learned,
        "pareto": speed,
        "failures": failed.kinds,
        "failures_note": failed.note,
        "diff": _diff(runs, keys) if len(runs) > 1 else None,
        "steps": steps,
        "warnings": warnings,
        "command": " ".join(["me3bev report", *map(shlex.quote, names), *words, "--out", shlex.quote(str(out))]),
        "metrics": METRICS.values(),
        "data": DATA,
    }
    context["sections"] = _sections(context)
    document = {
        "kind": KIND,
        "me3bev": __version__,
        "title": title,
        "suites": [_plain(suite) for suite in found],
        "convergence": learned.data,
        "latency": speed.data,
        "failures": failed.data,
        "recipes": {"runs": runs, "differences": [key.row() for key in keys]},
        "warnings": warnings,
    }
    return document, render(context)


def _subtitle(found: Sequence[Suite]) -> str:
    suite = found[0]
    more = f", and {len(found) - 1} more" if len(found) > 1 else ""
    return f"{suite.title}{f'; {suite.about}' if suite.about else ''}{more}"


def _suite(suite: Suite) -> dict[str, Any]:
    """What the template shows of a suite."""
    place = "average over the maps" if suite.whole not in suite.maps else suite.whole
    pictures = [comfort_chart(suite, density) for density in suite.densities]
    return {
        "title": suite.title,
        "about": suite.about,
        "legend": [(method.label, number) for number, method in enumerate(suite.methods)],
        "crowded": bars.crowded(suite),
        "cards": cards(suite),
        "beside": beside(suite),
        "head": tables.method_table(suite, tables.HEAD, f"Driving, {place}"),
        "safety": tables.method_table(suite, tables.SAFETY, f"Collisions and rules, {place}"),
        "drive": tables.method_table(suite, tables.DRIVE, f"Comfort and efficiency, {place}"),
        "published": tables.published_table(suite),
        "comfort": [picture for picture in pictures if picture is not None],
        "blocks": [_block(suite, density) for density in suite.densities],
    }


def _block(suite: Suite, density: str) -> dict[str, Any]:
    title = f"{suite.places}, {density} density"
    shown = [name for name in bars.SHOWN if any(row.metric == name for row in suite.rows)]
    return {
        "title": title,
        "legend": bars.drawn(suite),
        "bars": bars.bar_charts(suite, density),
        "table": tables.map_table(suite, density, shown),
    }


def _plain(suite: Suite) -> dict[str, Any]:
    return {
        "maps": suite.maps,
        "densities": suite.densities,
        "weather": suite.weather,
        "episodes": suite.episodes,
        "seed": suite.seed,
        "folders": [str(evaluation.folder) for evaluation in suite.evaluations],
        "methods": [{**method.about, "method": method.label} for method in suite.methods],
        "rows": [asdict(row) for row in suite.rows],
        "comparisons": suite.comparisons,
        "published": [asdict(row) for row in suite.published],
    }


def _recipes(runs: Sequence[Path]) -> tuple[list[str], list[Difference], list[str]]:
    """Names of the runs, the keys in which their recipes differ, and a sentence for each that cannot be read."""
    names, recipes, faulty = [], [], []
    for run in runs:
        try:
            recipes.append(run_recipe(run))
            names.append(run.name if run.name not in names else str(run))
        except UserError as error:
            faulty.append(f"the recipe of {run.name} is left out: {error}.")
    return names, differences(recipes), faulty


def _diff(names: Sequence[str], keys: Sequence[Difference]) -> dict[str, Any]:
    return {"names": names, "lines": [(one.key, [shown(value) for value in one.values]) for one in keys]}


def _lost(sources: Sources) -> list[str]:
    """What evaluations say they have lost."""
    return [
        f"{evaluation.folder}: {sentence}."
        for evaluation in sources.evaluations
        for sentence in evaluation.document.get("lost") or ()
    ]


def _sections(context: dict[str, Any]) -> list[tuple[str, str]]:
    """(id, name) of the sections that the page has."""
    there = {
        "convergence": bool(context["curves"].pictures or context["curves"].left_out),
        "latency": bool(context["pareto"].pictures or context["pareto"].notes),
        "recipes": context["diff"] is not None,
    }
    names = {
        "summary": "Summary", "methods": "Methods", "maps": "Maps", "comfort": "Comfort and efficiency",
        "convergence": "Convergence", "latency": "Latency", "failures": "Failures", "recipes": "Recipes",
        "reproduce": "Reproduce",
    }  # fmt: skip
    return [(id, name) for id, name in names.items() if there.get(id, True)]

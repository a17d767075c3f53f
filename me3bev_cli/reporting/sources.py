"""What a report is made of: runs and their evaluations, read and checked before anything is written."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from me3bev_cli.errors import RunError, UserError
from me3bev_cli.evaluation.folder import EPISODES, JSON, MANIFEST
from me3bev_cli.evaluation.summary import Row
from me3bev_cli.pretrained import find_run, named, results_home, run_path
from me3bev_cli.training.run import is_run, newest_run, runs_root

EVALUATIONS = "eval"
"""Where a run keeps its evaluations."""
LATENCY = "latency.json"
"""What `me3bev bench-latency --json` wrote, in a run or beside an evaluation."""


@dataclass(frozen=True, eq=False)
class Evaluation:
    """One folder of results."""

    folder: Path
    document: Mapping[str, Any]
    """What `results.json` holds."""
    rows: Sequence[Row]
    published: Sequence[Row]

    @property
    def methods(self) -> list[dict[str, Any]]:
        """What is known of each method; an older evaluation has one, of which it says less."""
        found = self.document.get("methods")
        if found:
            return [dict(method) for method in found]
        keys = ("method", "driver", "run", "checkpoint", "recipe")
        return [{key: self.document.get(key) for key in keys}]

    @property
    def logs(self) -> Path | None:
        """The folder of its logs, if they tell how to drive them again."""
        logs = self.folder / EPISODES
        return logs if logs.is_dir() and (self.folder / MANIFEST).is_file() else None


@dataclass(frozen=True, eq=False)
class Sources:
    """Everything that was named, each thing once."""

    runs: Sequence[Path]
    evaluations: Sequence[Evaluation]
    latency: Sequence[tuple[Path, dict[str, Any]]] = field(default=())


def gather(names: Sequence[Path], latency: Sequence[Path] = ()) -> Sources:
    """The runs and evaluations that are named; a run stands for all of its evaluations.

    Args:
        names: run folders, their names, or folders of evaluations.
        latency: files of `me3bev bench-latency --json`, beside those that are found.

    Raises:
        UserError: one is neither, has not been evaluated, or holds damaged results.
    """
    runs: list[Path] = []
    evaluations: dict[Path, Evaluation] = {}
    files = list(latency)
    for name in names:
        place = _place(name)
        found = [place] if (place / JSON).is_file() else _below(place)
        for folder in found:
            evaluation = read_evaluation(folder)
            evaluations.setdefault(folder.resolve(), evaluation)
            runs += [] if is_run(place) else _runs_of(evaluation)
        runs += [place] if is_run(place) else []
        files += [folder / LATENCY for folder in (place, *found) if (folder / LATENCY).is_file()]
    unique = {run.resolve(): run for run in reversed(runs)}
    benches = {file.resolve(): file for file in files}
    timed = [(file, _latency(file)) for file in benches.values()]
    return Sources(list(reversed(unique.values())), list(evaluations.values()), timed)


def _place(name: Path) -> Path:
    """The folder that is meant.

    Raises:
        RunError: there is none.
    """
    place = run_path(str(name))
    if place is not None:
        return place
    newest = newest_run()
    hint = f"The newest run is {newest}" if newest else "`me3bev train RECIPE` makes one"
    raise RunError(f"{name} is neither a run nor an evaluation", hint=hint)


def _below(place: Path) -> list[Path]:
    """A run's evaluations, or those in a folder of evaluations.

    Raises:
        RunError: there is none; the message has the command that makes one.
    """
    root = results_home(place) / EVALUATIONS if is_run(place) else place
    found = sorted(path.parent for path in root.rglob(JSON)) if root.is_dir() else []
    if found:
        return found
    begun = next((path.parent for path in sorted(root.rglob(MANIFEST))), None) if root.is_dir() else None
    if begun is not None:
        hint = f"The same command goes on, or `me3bev eval --from-logs {begun}` takes what there is"
        raise RunError(f"the evaluation in {begun} is not finished", hint=hint)
    if is_run(place):
        raise RunError(
            f"{named(place)} has not been evaluated yet",
            hint=f"`me3bev eval --run {named(place)} --reference all` does it",
        )
    hint = "Name a run, or the folder that `me3bev eval` wrote"
    raise RunError(f"{place} holds neither a run nor an evaluation", hint=hint)


def read_evaluation(folder: Path) -> Evaluation:
    """The results in a folder.

    Raises:
        UserError: they are damaged.
    """
    path = folder / JSON
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
        rows = [_row(row) for row in data["rows"]]
        published = [_row(row) for row in (data.get("published") or {}).get("rows", ())]
        if not rows:
            raise ValueError("no rows")
        for key in ("maps", "densities"):
            list(data[key])
        methods = [method["method"] for method in data.get("methods") or [data]]
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        again = f"`me3bev eval --from-logs {folder}` computes them again" if (folder / EPISODES).is_dir() else None
        what = f"is no file of results, or a damaged one ({type(error).__name__}: {error})"
        raise UserError(what, where=str(path), hint=again or "Evaluate again with --overwrite") from error
    strange = {row.method for row in rows} - set(methods)
    if strange:
        raise UserError(f"has rows of '{min(strange)}', which is none of its methods", where=str(path))
    return Evaluation(folder, data, rows, published)


def _row(row: Mapping[str, Any]) -> Row:
    mean, low, high = (math.nan if row[key] is None else float(row[key]) for key in ("mean", "low", "high"))
    return Row(row["method"], row["map"], row["density"], row["metric"], mean, low, high, int(row["n"]))


def _runs_of(evaluation: Evaluation) -> list[Path]:
    """The runs whose policies an evaluation is of, those that are still there: where it says, or among the runs."""
    told = [Path(method["run"]) for method in evaluation.methods if method.get("run")]
    places = ([find_run(run), runs_root() / run.name] for run in told)
    return [found[0] for found in ([place for place in pair if is_run(place)] for pair in places) if found]


def _latency(path: Path) -> dict[str, Any]:
    """What a bench wrote.

    Raises:
        UserError: it is missing, damaged or something else.
    """
    try:
        data: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        for row in data["rows"]:
            float(row["median_ms"]), float(row["p95_ms"]), str(row["name"]), row["stages"]
        setup = data["setup"]
        setup["device"], setup["dtype"], setup["batch"]
    except (OSError, ValueError, KeyError, TypeError) as error:
        what = f"is not what `me3bev bench-latency --json` writes ({type(error).__name__}: {error})"
        raise UserError(what, where=str(path)) from error
    return data

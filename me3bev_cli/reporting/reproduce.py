"""How each number comes about again: commands, versions, seeds."""

from __future__ import annotations

import json
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from me3bev_cli.errors import UserError
from me3bev_cli.evaluation.maps import shorten
from me3bev_cli.recipe_diff import RECIPE, run_recipe
from me3bev_cli.reporting.sources import Evaluation


@dataclass(frozen=True)
class Step:
    """One thing that was done, and the command that does it again."""

    title: str
    command: str
    facts: Sequence[tuple[str, str]]
    """What else decided the numbers: names and values."""


def trained(run: Path) -> Step:
    """How a run was trained."""
    facts = []
    seed = _seed(run)
    if seed:
        facts.append(("seed", seed))
    noted = _read(run / "versions.json")
    facts += _versions(noted.get("versions", noted))
    machine = noted.get("machine")
    if isinstance(machine, Mapping):
        facts.append(("machine", ", ".join(f"{key} {value}" for key, value in machine.items() if value is not None)))
    return Step(f"Training of {run.name}", f"me3bev train {shlex.quote(str(run / RECIPE))}", facts)


def evaluated(evaluation: Evaluation) -> Step:
    """How an evaluation was driven."""
    data = evaluation.document
    if data.get("from_logs"):
        command = " ".join(f"--from-logs {shlex.quote(str(path))}" for path in data["from_logs"])
        command = f"me3bev eval {command} --out {shlex.quote(str(evaluation.folder))}"
    else:
        command = _drive(evaluation)
    facts = [("figures", str(data.get("interval", ""))), *_versions(data.get("versions", {}))]
    facts += _identities(evaluation)
    return Step(f"Evaluation in {evaluation.folder}", command, [fact for fact in facts if fact[1]])


def _identities(evaluation: Evaluation) -> list[tuple[str, str]]:
    """Digests of what decided the episodes: the simulator's code, and each policy's weights."""
    identities = {str(method["method"]): method.get("identity") or {} for method in evaluation.methods}
    found = [
        (name, f"{one.get('checkpoint', '')}, weights {one['weights']}")
        for name, one in identities.items()
        if one.get("weights")
    ]
    codes = dict.fromkeys(str(one["simulator_code"]) for one in identities.values() if one.get("simulator_code"))
    return [*found, *([("simulator code", ", ".join(codes))] if codes else [])]


def _drive(evaluation: Evaluation) -> str:
    data = evaluation.document
    words = ["me3bev", "eval"]
    runs = [method for method in evaluation.methods if method.get("run")]
    for method in runs:
        words += ["--run", str(method["run"])]
    checkpoints = list(dict.fromkeys(str(method["checkpoint"]) for method in runs if method.get("checkpoint")))
    if len(checkpoints) == 1:
        words += ["--checkpoint", checkpoints[0]]
    drivers = [str(method["driver"]) for method in evaluation.methods if not method.get("run") and method.get("driver")]
    if runs and drivers:
        words += ["--reference", ",".join(drivers)]
    else:
        for driver in drivers:
            words += ["--driver", driver]
    recipes = [str(method["recipe"]) for method in evaluation.methods if method.get("recipe")]
    if not runs and recipes:
        words += ["--recipe", recipes[0]]
    words += ["--maps", shorten(data["maps"]), "--density", ",".join(data["densities"])]
    if data.get("weather"):
        words += ["--weather", ",".join(data["weather"])]
    words += ["--episodes", str(data.get("episodes")), "--seed", str(data.get("seed"))]
    if data.get("baseline"):
        words += ["--baseline", str(data["baseline"])]
    if data.get("published"):
        words += ["--paper"]
    return shlex.join([*words, "--out", str(evaluation.folder)])


def timed(path: Path, bench: Mapping[str, Any]) -> Step:
    """How latencies were measured."""
    setup = bench["setup"]
    names = list(dict.fromkeys(str(row["name"]) for row in bench["rows"]))
    words = ["me3bev", "bench-latency", *names, "--dtype", str(setup["dtype"]), "--batch", str(setup["batch"])]
    words = [word if word != "float32" else "fp32" for word in words]
    words = [word if word != "bfloat16" else "bf16" for word in words]
    if setup.get("threads"):
        words += ["--threads", str(setup["threads"])]
    facts = _versions(bench.get("versions", {}))
    machine = bench.get("machine")
    if isinstance(machine, Mapping):
        facts.append(("machine", ", ".join(f"{key} {value}" for key, value in machine.items() if value is not None)))
    return Step(f"Latency in {path}", shlex.join([*words, "--json", str(path)]), facts)


def _versions(found: Any) -> list[tuple[str, str]]:
    if not isinstance(found, Mapping) or not found:
        return []
    return [("versions", ", ".join(f"{name} {value}" for name, value in found.items()))]


def _seed(run: Path) -> str:
    """The seed that all others of a training come from."""
    try:
        return str(run_recipe(run).get("seed", ""))
    except UserError:
        return ""


def _read(path: Path) -> dict[str, Any]:
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return found if isinstance(found, dict) else {}

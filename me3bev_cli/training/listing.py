"""Runs at a glance, from their folders alone. No torch and no numpy here."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

import yaml

from me3bev_cli.training.best import SCORE, read_best
from me3bev_cli.training.run import is_run, is_training

State = Literal["new", "running", "stopped", "finished"]

TAIL = 65_536
"""Bytes at the end of a log that are read."""
UPDATES = 10
"""Of which the reward is the mean."""


@dataclass(frozen=True)
class Entry:
    """One run."""

    run: str
    recipe: str
    seed: int
    state: State
    steps: int
    total: int
    """Environment steps of all stages."""
    stage: str
    """As 1/2 ppo."""
    reward_per_step: float | None
    """Mean of the last updates that have one."""
    best_score: float | None
    """Driving score of the best evaluation."""
    best_steps: int | None
    """Where it was."""
    age: float
    """Seconds since the log was last written."""

    def row(self) -> dict[str, Any]:
        """As plain values."""
        return asdict(self)


def find_runs(root: Path) -> list[Path]:
    """Run folders in a folder and in its folders, the newest first; the folder itself if it is one."""
    if is_run(root):
        return [root]
    return sorted(_below(root, 2), key=lambda run: (run / "metrics.jsonl").stat().st_mtime_ns, reverse=True)


def _below(folder: Path, depth: int) -> Iterator[Path]:
    for entry in os.scandir(folder) if folder.is_dir() else ():
        path = folder / entry.name
        if not entry.is_dir() or entry.name.startswith("."):
            continue
        if is_run(path):
            yield path
        elif depth > 1:
            yield from _below(path, depth - 1)


def describe(run: Path) -> Entry:
    """What a run folder tells."""
    recipe = _recipe(run)
    stages = recipe.get("stages") or [{}]
    rows = last_rows(run)
    last = rows[-1] if rows else {}
    rewards = [row["reward_per_step"] for row in rows if row.get("reward_per_step") is not None][-UPDATES:]
    best = read_best(run) or {}
    number = min(int(last.get("stage", 0)), len(stages) - 1)
    steps = _steps(run, last)
    return Entry(
        run=str(run),
        recipe=str(recipe.get("name", "?")),
        seed=int(recipe.get("seed", 0)),
        state=state_of(run, steps),
        steps=steps,
        total=sum(int(stage.get("steps", 0)) for stage in stages),
        stage=f"{number + 1}/{len(stages)} {stages[number].get('kind', '')}".strip(),
        reward_per_step=sum(rewards) / len(rewards) if rewards else None,
        best_score=best.get(SCORE),
        best_steps=best.get("steps"),
        age=max(0.0, time.time() - (run / "metrics.jsonl").stat().st_mtime),
    )


def state_of(run: Path, steps: int | None = None) -> State:
    """Whether a run has been begun, goes on, is finished."""
    if is_training(run):
        return "running"
    if finished(run):
        return "finished"
    steps = _steps(run, (last_rows(run) or [{}])[-1]) if steps is None else steps
    return "stopped" if steps else "new"


def finished(run: Path) -> bool:
    """Whether every stage is done: the summary is written at the very end."""
    return (run / "summary.json").exists()


def last_rows(run: Path) -> list[dict[str, Any]]:
    """The rows at the end of a run's log."""
    with open(run / "metrics.jsonl", "rb") as file:
        size = file.seek(0, os.SEEK_END)
        file.seek(max(0, size - TAIL))
        lines = file.read().decode("utf-8", "replace").splitlines()
    rows = []
    for line in lines[1:] if size > TAIL else lines:
        try:
            rows.append(json.loads(line))
        except json.JSONDecodeError:
            continue
    return rows


def _steps(run: Path, last: dict[str, Any]) -> int:
    """The steps of the newest row, or of a checkpoint that is further, as after a stop between two updates."""
    saved = [int(path.name[5:]) for path in (run / "checkpoints").glob("step_*") if path.name[5:].isdigit()]
    return max([int(last.get("steps", 0)), *saved])


def _recipe(run: Path) -> dict[str, Any]:
    try:
        loaded = yaml.load((run / "recipe.yaml").read_text(), getattr(yaml, "CSafeLoader", yaml.SafeLoader))
    except (OSError, yaml.YAMLError):
        return {}
    return loaded if isinstance(loaded, dict) else {}

"""The convergence curve: average reward per step against environment steps (the paper's Figure 3)."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from me3bev_cli.training.best import SCORE

WINDOW = 10
"""Updates in the moving average."""


def read_metrics(run: Path) -> list[dict[str, Any]]:
    """The run's log, one entry per update; a line cut short by a crash is left out."""
    rows = []
    for line in (run / "metrics.jsonl").read_text().splitlines():
        try:
            rows.append(json.loads(line))
        except json.JSONDecodeError:
            continue
    return rows


def reward_rows(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """The updates that tell of the policy's own reward: those of `ppo` stages, or where there are none, any that do."""
    told = [row for row in rows if row.get("reward_per_step") is not None]
    return [row for row in told if row.get("kind", "ppo") == "ppo"] or told


def draw_curve(run: Path, out: Path) -> None:
    """Draw reward per step, raw and as a moving average, to a PNG.

    Raises:
        ValueError: the run has no update yet.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    rows = reward_rows(read_metrics(run))
    if not rows:
        raise ValueError("nothing to draw: the run has no update yet")
    steps = [row["steps"] for row in rows]
    rewards = [row["reward_per_step"] for row in rows]
    means = [sum(rewards[max(0, i - WINDOW + 1) : i + 1]) / min(i + 1, WINDOW) for i in range(len(rewards))]
    figure = Figure(figsize=(6, 3.6), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    axes.plot(steps, rewards, color="#9db8d9", linewidth=1, label="each update")
    axes.plot(steps, means, color="#1f4e8c", linewidth=2, label=f"mean of {WINDOW} updates")
    axes.set_xlabel("environment steps")
    axes.set_ylabel("reward per step")
    axes.set_title(run.name)
    axes.grid(alpha=0.3)
    axes.legend(frameon=False)
    judged = [row for row in read_metrics(run) if row.get(SCORE) is not None]
    if judged:
        scores = axes.twinx()
        at, values = [row["steps"] for row in judged], [row[SCORE] for row in judged]
        scores.plot(at, values, "o-", color="#c4541a", linewidth=1, markersize=4)
        scores.set_ylabel("driving score (evaluation)", color="#c4541a")
        scores.set_ylim(0, 100)
    temporary = out.with_name(f".{out.name}.part")
    figure.savefig(temporary, dpi=120, format="png")
    temporary.rename(out)

"""The best policy of a run: a checkpoint folder of its own beside the numbered ones, never pruned.

checkpoints/best_000012288/
    recipe.yaml, policy.safetensors, progress.json    as in any checkpoint
    evaluation.json                                   the figures that it was chosen by

It is for driving; training goes on from the numbered ones, which hold the optimiser. To read figures needs no torch.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

BEST = "best"
"""What stands for it where a checkpoint is named."""
FIGURES = "evaluation.json"
SCORE = "eval_score"
"""The figure that it is chosen by: the mean driving score."""


def find_best(run: Path) -> Path | None:
    """The folder of the best checkpoint, or None."""
    return max(_candidates(run), key=lambda found: found[1][SCORE], default=(None, {}))[0]


def read_best(run: Path) -> dict[str, Any] | None:
    """`steps` and the figures of the best evaluation; None when there is none."""
    return max((figures for _, figures in _candidates(run)), key=lambda figures: figures[SCORE], default=None)


def best_line(run: Path) -> str | None:
    """The best evaluation in words; None when there is none."""
    best = read_best(run)
    return f"best evaluation: driving score {best[SCORE]:.1f} at step {best['steps']:,}" if best else None


def _candidates(run: Path) -> list[tuple[Path, dict[str, Any]]]:
    """Usually one; two where a process died between keeping the new one and removing the old."""
    found = []
    for folder in sorted((run / "checkpoints").glob(f"{BEST}_*")):
        try:
            found.append((folder, json.loads((folder / FIGURES).read_text())))
        except (OSError, ValueError):
            continue
    return found

"""The best policy of a run: a checkpoint folder of its own beside the numbered ones, never pruned.

checkpoints/best_000012288/
    recipe.yaml, policy.safetensors, progress.json    as in any checkpoint
    evaluation.json                                   the figures that it was chosen by

It is for driving; training goes on from the numbered ones, which hold the optimiser. To read figures needs no torch.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from me3bev_cli.pipeline.network import Network
    from me3bev_cli.recipe import Recipe
    from me3bev_cli.training.checkpoint import Progress

BEST = "best"
"""What stands for it where a checkpoint is named."""
FIGURES = "evaluation.json"
SCORE = "eval_score"
"""The figure that it is chosen by: the mean driving score."""


def save_best(run: Path, network: Network, recipe: Recipe, progress: Progress, figures: Mapping[str, Any]) -> Path:
    """Keep the network as the best one so far, then let go of the one before."""
    from safetensors.torch import save_file

    from me3bev_cli.recipe_loading import dump
    from me3bev_cli.training.checkpoint import FOLDER, PROGRESS, RECIPE, WEIGHTS

    final = run / FOLDER / f"{BEST}_{progress.total_steps:09d}"
    temporary = final.with_name(f".{final.name}.part")
    shutil.rmtree(temporary, ignore_errors=True)
    temporary.mkdir(parents=True)
    save_file({key: value.contiguous() for key, value in network.state_dict().items()}, temporary / WEIGHTS)
    (temporary / RECIPE).write_text(dump(recipe))
    (temporary / PROGRESS).write_text(json.dumps(asdict(progress), indent=1))
    (temporary / FIGURES).write_text(json.dumps({"steps": progress.total_steps, **figures}, indent=1))
    shutil.rmtree(final, ignore_errors=True)
    temporary.rename(final)
    for folder in final.parent.glob(f"*{BEST}_*"):
        if folder != final:
            shutil.rmtree(folder, ignore_errors=True)
    return final


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

"""Scores a trained grid on maps that it may never have seen."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import torch

from me3bev_cli.decoding.scores import MASKS, Tally
from me3bev_cli.perception.drawing import Drawer
from me3bev_cli.perception.frames import FrameSource, Job
from me3bev_cli.perception.model import load_model
from me3bev_cli.perception.scoring import tally
from me3bev_cli.pipeline.assemble import configured, pick_device
from me3bev_cli.training.checkpoint import find_checkpoint, load_network

EVERY = 16
"""Of so many steps one frame is scored: more places for as many frames."""


def score_grid(
    run: Path,
    maps: Sequence[str],
    density: str,
    weather: Sequence[str] | None = None,
    *,
    frames: int = 200,
    seed: int = 0,
    workers: int = 1,
    checkpoint: str = "last",
    device: str = "auto",
    shown: Callable[[str, Tally], None] | None = None,
) -> list[dict[str, object]]:
    """IoU of the bird's-eye grid of a run by map, mask and class, from the autopilot's drives; and over all maps.

    Args:
        weather: each episode draws one of them; None: the simulator's default one.
        frames: of each map.
        seed: of the episodes.
        workers: processes that draw.
        checkpoint: its spatial part is scored, under the head that the run's perception stage left.
        shown: called with each map and its counts.

    Returns:
        Rows `source` (grid), `mask`, `map` (or `mean`, the mean over the maps), `class`, `iou`.

    Raises:
        CheckpointError: the run has no head, or a file is damaged.
    """
    network, recipe = load_network(find_checkpoint(run, checkpoint), pick_device(device))
    model = load_model(network, run)
    cls, config = configured("simulator", recipe.simulator)
    kinds = None if weather is None else tuple(weather)
    source = FrameSource(cls(config), recipe.observation, density, kinds, EVERY, noise=0.0, depth=None)
    drawer = Drawer(source, workers)
    rows: list[dict[str, object]] = []
    try:
        for place in maps:
            drawer.begin(_jobs(place, density, frames, seed))
            with torch.inference_mode():
                counted = tally(model, drawer.take(lambda: None))
            rows += counted.rows("grid", map=place)
            if shown is not None:
                shown(place, counted)
    finally:
        drawer.close()
    return rows + mean_rows(rows)


def _jobs(place: str, density: str, frames: int, seed: int) -> list[Job]:
    """As many stretches as make the frames, eight frames each."""
    count = -(-frames // 8)
    return [Job((seed, "perception score", place, density, k), 8 * EVERY, place) for k in range(count)]


def mean_rows(rows: Sequence[dict[str, Any]]) -> list[dict[str, object]]:
    """For each mask and class the mean of the maps' IoU, where it is defined."""
    found: dict[tuple[str, str], list[float]] = {}
    for row in rows:
        if not math.isnan(row["iou"]):
            found.setdefault((row["mask"], row["class"]), []).append(row["iou"])
    order = sorted(found, key=lambda key: MASKS.index(key[0]))
    return [
        {"source": "grid", "mask": mask, "map": "mean", "class": name, "iou": sum(values) / len(values)}
        for (mask, name) in order
        for values in [found[(mask, name)]]
    ]

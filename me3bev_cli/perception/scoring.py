"""Intersection over union of what a perception model makes of frames."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import torch

from me3bev_cli.decoding.scores import Tally
from me3bev_cli.perception.frames import Frames
from me3bev_cli.perception.model import PerceptionModel
from me3bev_cli.perception.truth import classes_of, seen_in
from me3bev_cli.pipeline.transfer import to_device

BATCH = 8
SHOWN = ("road", "lane_marking", "vehicle", "pedestrian")
"""The classes whose scores are logged: those that a driver acts on."""


def tally(
    model: PerceptionModel,
    drawn: Iterable[Frames],
    autocast: torch.dtype | None = None,
    going: Callable[[], None] | None = None,
    tokens: bool = False,
) -> Tally:
    """Count the model's maps of frames against the truth.

    Args:
        going: called now and then; what it raises ends the counting.
        tokens: score the maps that are made of the tokens alone, not those of the grid.
    """
    device = next(model.parameters()).device
    counted = Tally()
    model.eval()
    for frames in drawn:
        # Logs hold no depth, from which sight is told.
        told = bool(seen_in(frames.maps).any())
        for low in range(0, len(frames), BATCH):
            if going is not None:
                going()
            maps = frames.maps[low : low + BATCH]
            decoded = model.classes(to_device(frames.images[low : low + BATCH], device), autocast, tokens)
            counted.add(classes_of(maps), decoded, seen_in(maps) if told else None)
    model.train()
    return counted


def shown_scores(counted: Tally, source: str = "") -> dict[str, float]:
    """`near_road`, `seen_vehicle` and so on, `source` before them: what the log of a run holds."""
    masks = [mask for mask in ("near", "seen") if counted.counts[mask].any()]
    return {f"{source}{mask}_{name}": counted.iou(mask)[name] for mask in masks for name in SHOWN}

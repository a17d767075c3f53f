"""Intersection over union of decoded maps, by mask."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from me3bev_cli.api import BEV_CLASSES

NEAR = slice(50, 150)
"""The central 50 x 50 m of a 100 x 100 m map."""
MASKS = ("all", "seen", "near")
"""All cells; those in some camera's clear sight; the central 50 x 50 m."""

Classes = NDArray[np.uint8]


def confusion(truth: Classes, decoded: Classes, mask: NDArray[np.bool_] | None = None) -> NDArray[np.int64]:
    """Counts (8, 8): rows are true classes, columns decoded ones; of the cells in `mask`."""
    count = len(BEV_CLASSES)
    if mask is not None:
        truth, decoded = truth[mask], decoded[mask]
    pairs = truth.ravel() * np.uint8(count) + decoded.ravel()
    return np.bincount(pairs, minlength=count * count).reshape(count, count)


def iou(counts: NDArray[np.int64]) -> NDArray[np.float64]:
    """Intersection over union per class (8,); NaN for a class that neither has."""
    hit = np.diag(counts).astype(float)
    union = counts.sum(0) + counts.sum(1) - hit
    return np.divide(hit, union, out=np.full(len(hit), np.nan), where=union > 0)


class Tally:
    """Counts maps as they come, N at a time, under every mask."""

    def __init__(self) -> None:
        self.frames = 0
        self.counts = {mask: np.zeros((len(BEV_CLASSES), len(BEV_CLASSES)), np.int64) for mask in MASKS}

    def add(self, truth: Classes, decoded: Classes, seen: NDArray[np.bool_] | None = None) -> None:
        """Enter maps (N, 200, 200); without `seen`, which cells are in sight, that mask stays without cells."""
        self.frames += len(truth)
        self.counts["all"] += confusion(truth, decoded)
        self.counts["near"] += confusion(truth[:, NEAR, NEAR], decoded[:, NEAR, NEAR])
        if seen is not None:
            self.counts["seen"] += confusion(truth, decoded, seen)

    def merge(self, other: Tally) -> None:
        """Enter what another one has counted."""
        self.frames += other.frames
        for mask, counts in other.counts.items():
            self.counts[mask] += counts

    def iou(self, mask: str) -> dict[str, float]:
        """Intersection over union of each class under a mask; NaN for what is not there."""
        return {name: float(value) for name, value in zip(BEV_CLASSES, iou(self.counts[mask]), strict=True)}

    def rows(self, source: str, **place: str) -> list[dict[str, object]]:
        """A row per mask that has cells, and class, with its IoU."""
        return [
            {"source": source, "mask": mask, **place, "class": name, "iou": value}
            for mask in MASKS
            if self.counts[mask].any()
            for name, value in self.iou(mask).items()
        ]

"""Intersection over union of decoded maps."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from me3bev_cli.api import BEV_CLASSES

NEAR = slice(50, 150)
"""The central 50 x 50 m of a 100 x 100 m map."""


def confusion(truth: NDArray[np.uint8], decoded: NDArray[np.uint8]) -> NDArray[np.int64]:
    """Counts (8, 8): rows are true classes, columns decoded ones."""
    count = len(BEV_CLASSES)
    pairs = truth.astype(np.int64).ravel() * count + decoded.ravel()
    return np.bincount(pairs, minlength=count * count).reshape(count, count)


def iou(counts: NDArray[np.int64]) -> NDArray[np.float64]:
    """Intersection over union per class (8,); NaN for a class that neither has."""
    hit = np.diag(counts).astype(float)
    union = counts.sum(0) + counts.sum(1) - hit
    return np.divide(hit, union, out=np.full(len(hit), np.nan), where=union > 0)


def score_rows(truth: NDArray[np.uint8], decoded: NDArray[np.uint8], source: str) -> list[dict[str, object]]:
    """A row per mask (`all` cells, `near`: the central 50 x 50 m) and class, with its IoU."""
    rows: list[dict[str, object]] = []
    for mask, cut in (("all", slice(None)), ("near", NEAR)):
        values = iou(confusion(truth[:, cut, cut], decoded[:, cut, cut]))
        for name, value in zip(BEV_CLASSES, values, strict=True):
            rows.append({"source": source, "mask": mask, "class": name, "iou": float(value)})
    return rows


def most_frequent(truth: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """The trivial baseline: the most frequent class of each cell (200, 200) over N maps."""
    counts = np.stack([(truth == index).sum(0) for index in range(len(BEV_CLASSES))])
    return counts.argmax(0).astype(np.uint8)

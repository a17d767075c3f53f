"""Confusion of decoded maps by mask, all masks in one pass."""

from __future__ import annotations

from typing import cast

import numpy as np
from numpy.typing import NDArray

from me3bev_cli.api import BEV_CLASSES
from me3bev_cli.decoding.scores import MASKS, NEAR, iou

Classes = NDArray[np.uint8]

CELLS, CELL = 200, 0.5
RINGS = {"0-15": (0.0, 15.0), "15-30": (15.0, 30.0), "30-50": (30.0, 50.0)}
"""Metres from the ego to a cell's centre."""
ALL_MASKS = (*MASKS, *RINGS)
K = len(BEV_CLASSES)


def _regions() -> NDArray[np.uint8]:
    """(200, 200): twice the ring's number (3: beyond), and one more where it is near."""
    middle = (np.arange(CELLS) + 0.5 - CELLS / 2) * CELL
    distance = np.hypot(middle[:, None], middle[None])
    region = 2 * np.searchsorted([high for _, high in RINGS.values()], distance, side="right").astype(np.uint8)
    region[NEAR, NEAR] += 1
    return cast(Classes, region)


_REGION = _regions()
_REGIONS = 2 * (len(RINGS) + 1)


class Counts:
    """Cells by where they are, whether they are seen, true class and decoded class.

    Args:
        table: (8 regions, 2 unseen/seen, 8 true, 8 decoded); None: empty.
        told: frames of which it is known what was seen.
    """

    def __init__(self, table: NDArray[np.int64] | None = None, frames: int = 0, told: int = 0) -> None:
        self.table = np.zeros((_REGIONS, 2, K, K), np.int64) if table is None else table
        self.frames, self.told = frames, told

    def add(self, truth: Classes, decoded: Classes, seen: NDArray[np.bool_] | None) -> None:
        """Enter one map (200, 200)."""
        own = _REGION if seen is None else _REGION.astype(np.int64) * 2 + seen
        if seen is None:
            own = own.astype(np.int64) * 2
        index = (own * K + truth) * K + decoded
        self.table += np.bincount(index.ravel(), minlength=self.table.size).reshape(self.table.shape)
        self.frames += 1
        self.told += seen is not None

    def __add__(self, other: Counts) -> Counts:
        return Counts(self.table + other.table, self.frames + other.frames, self.told + other.told)

    def confusion(self, mask: str) -> NDArray[np.int64]:
        """(8, 8), rows are true classes, columns decoded ones."""
        if mask == "all":
            chosen = self.table
        elif mask == "near":
            chosen = self.table[1::2]
        elif mask == "seen":
            chosen = self.table[:, 1:]
        else:
            ring = list(RINGS).index(mask)
            chosen = self.table[2 * ring : 2 * ring + 2]
        return cast("NDArray[np.int64]", chosen.sum((0, 1)))

    def masks(self) -> list[str]:
        """Those that can be told: `seen` of the frames of which it is known."""
        return [mask for mask in ALL_MASKS if mask != "seen" or self.told]

    def iou(self, mask: str) -> NDArray[np.float64]:
        """(8,); NaN for a class that neither truth nor decoded map has."""
        return iou(self.confusion(mask))

    def mean(self, mask: str = "all") -> float:
        """Over the classes that are there."""
        values = self.iou(mask)
        return float(np.nanmean(values)) if np.isfinite(values).any() else float("nan")

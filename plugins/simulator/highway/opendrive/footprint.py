"""What ground is taken, as a raster of the town's plan."""

from __future__ import annotations

from collections.abc import Iterable

import cv2
import numpy as np
from numpy.typing import NDArray

from me3bev_plugins.simulator.highway.town import Floats, Lane

CELL = 0.5
"""Metres of one cell at most."""
MOST_CELLS = 36_000_000
"""A town too large for this many cells is drawn with larger ones."""
MARGIN = 60.0
"""Metres kept around the lanes."""
_FURTHEST = 1e9
_SHIFT = 4
"""Binary places of a cell that OpenCV draws with."""


class Footprint:
    """Cells that are taken. Everything outside the raster counts as taken."""

    def __init__(self, low: Floats, high: Floats) -> None:
        self.low = low - MARGIN
        span = high - low + 2 * MARGIN
        self.cell = max(CELL, float(np.sqrt(span[0] * span[1] / MOST_CELLS)))
        columns, rows = (int(n) for n in np.ceil(span / self.cell) + 1)
        self.taken: NDArray[np.uint8] = np.zeros((rows, columns), np.uint8)

    def _pixels(self, points: Floats) -> NDArray[np.int32]:
        places = ((points[:, :2] - self.low) / self.cell - 0.5) * 2**_SHIFT
        return np.asarray(np.round(np.clip(places, -_FURTHEST, _FURTHEST)), np.int32)

    def add_polygons(self, polygons: Iterable[Floats]) -> None:
        """Take convex polygons (P, 2)."""
        for polygon in polygons:
            cv2.fillConvexPoly(self.taken, self._pixels(polygon), 1, cv2.LINE_8, _SHIFT)

    def add_line(self, points: Floats, width: float) -> None:
        """Take a strip of the given width along points (P, 2), ends included."""
        thickness = max(1, int(np.ceil(width / self.cell)))
        cv2.polylines(self.taken, [self._pixels(points)[:, None]], False, 1, thickness, cv2.LINE_8, _SHIFT)

    def add_lanes(self, lanes: Iterable[Lane]) -> None:
        """Take whole lanes."""
        for lane in lanes:
            self.add_line(lane.points, lane.width)

    def is_free(self, points: Floats) -> NDArray[np.bool_]:
        """Whether the cell under each point (..., 2) is free."""
        column, row = np.moveaxis(np.floor((points - self.low) / self.cell).astype(np.int64), -1, 0)
        rows, columns = self.taken.shape
        inside = (column >= 0) & (row >= 0) & (column < columns) & (row < rows)
        free = self.taken[np.clip(row, 0, rows - 1), np.clip(column, 0, columns - 1)] == 0
        return np.asarray(inside & free, np.bool_)

    def islands(self, area: float) -> NDArray[np.bool_]:
        """Cells of free patches under an area in square metres: medians, the middles of roundabouts."""
        _, labels, stats, _ = cv2.connectedComponentsWithStats(1 - self.taken, connectivity=4)
        small = stats[:, cv2.CC_STAT_AREA] * self.cell**2 < area
        small[0] = False  # What is taken.
        return np.asarray(small[labels], np.bool_)

    def clearance(self) -> NDArray[np.float32]:
        """Metres from each cell to the nearest taken one."""
        distance = cv2.distanceTransform(1 - self.taken, cv2.DIST_L2, 3)
        return np.asarray(distance, np.float32) * np.float32(self.cell)

    def sample(self, field: NDArray[np.float32], points: Floats) -> Floats:
        """Values (P,) of a field made by `clearance`; 0 outside the raster."""
        column, row = np.floor((points - self.low) / self.cell).astype(np.int64).T
        rows, columns = field.shape
        inside = (column >= 0) & (row >= 0) & (column < columns) & (row < rows)
        values = field[np.clip(row, 0, rows - 1), np.clip(column, 0, columns - 1)]
        return np.where(inside, values, 0.0).astype(np.float64)


def rectangle(centre: Floats, size: tuple[float, float], heading: float) -> Floats:
    """(4, 2) corners of a box, counter-clockwise."""
    cos, sin = np.cos(heading), np.sin(heading)
    half = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * np.array(size) / 2
    return centre + half @ np.array([[cos, sin], [-sin, cos]])

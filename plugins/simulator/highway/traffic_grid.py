"""Samples of all lanes in square cells, to find what lies around a point."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from me3bev_plugins.simulator.highway.town import Floats, Ints

CELL = 6.0
"""Side of a cell, metres: everything within that of a point is in the 3 x 3 cells around it."""


class Grid(NamedTuple):
    """Cells row by row; samples of cell c are `order[start[c]:start[c + 1]]`."""

    start: Ints
    order: Ints
    origin: Floats
    """(2,) lower corner."""
    shape: Ints
    """(2,) rows, columns."""


def build_grid(points: NDArray) -> Grid:
    """Put records with `x` and `y` into cells."""
    xy = np.stack([points["x"], points["y"]], 1)
    origin = xy.min(0) - CELL
    columns, rows = (np.floor((xy.max(0) - origin) / CELL).astype(int) + 2).tolist()
    cell = np.floor((xy - origin) / CELL).astype(np.int64) @ np.array([1, columns])
    order = np.argsort(cell, kind="stable").astype(np.int32)
    start = np.searchsorted(cell[order], np.arange(rows * columns + 1)).astype(np.int32)
    return Grid(start, order, origin, np.array([rows, columns], np.int32))


@njit(cache=True)
def cell_range(grid: Grid, x: float, y: float) -> tuple[int, int, int, int]:
    """(first row, end row, first column, end column) of the cells around a point."""
    row, column = int(np.floor((y - grid.origin[1]) / CELL)), int(np.floor((x - grid.origin[0]) / CELL))
    return max(0, row - 1), min(grid.shape[0], row + 2), max(0, column - 1), min(grid.shape[1], column + 2)

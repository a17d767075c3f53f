"""Samples of all lanes in square cells, to find what lies around a point."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from me3bev_plugins.simulator.highway.compiled import kernel
from me3bev_plugins.simulator.highway.town import Floats, Ints
from me3bev_plugins.simulator.highway.traffic_records import Records

CELL = 6.0
"""Side of a cell, metres."""


class Grid(NamedTuple):
    """Cells row by row; samples of cell c are `order[start[c]:start[c + 1]]`."""

    start: Ints
    order: Ints
    origin: Floats
    """(2,) lower corner."""
    shape: Ints
    """(2,) rows, columns."""


def build_grid(points: Records) -> Grid:
    """Put records with `x` and `y` into cells."""
    xy = np.stack([points["x"], points["y"]], 1)
    origin = xy.min(0) - CELL
    columns, rows = (np.floor((xy.max(0) - origin) / CELL).astype(int) + 2).tolist()
    cell = np.floor((xy - origin) / CELL).astype(np.int64) @ np.array([1, columns])
    order = np.argsort(cell, kind="stable").astype(np.int32)
    start = np.searchsorted(cell[order], np.arange(rows * columns + 1)).astype(np.int32)
    return Grid(start, order, origin, np.array([rows, columns], np.int32))


@kernel
def cell_range(grid: Grid, x: float, y: float, reach: float) -> tuple[int, int, int, int]:
    """(first row, end row, first column, end column) of the cells within `reach` metres of a point."""
    row0, row1 = (y - reach - grid.origin[1]) / CELL, (y + reach - grid.origin[1]) / CELL
    column0, column1 = (x - reach - grid.origin[0]) / CELL, (x + reach - grid.origin[0]) / CELL
    return (
        max(0, int(np.floor(row0))),
        min(grid.shape[0], int(np.floor(row1)) + 1),
        max(0, int(np.floor(column0))),
        min(grid.shape[1], int(np.floor(column1)) + 1),
    )

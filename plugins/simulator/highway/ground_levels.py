"""Where roads cross above one another, and what of them belongs to the lower or the upper level.

The ground is drawn flat, so a bridge and the road beneath it cannot both be drawn. Around such a crossing
each road counts as lower or upper by its height; the ego sees the ones of its own level.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from me3bev_plugins.simulator.highway.town import Town

Floats = NDArray[np.float64]

SQUARE = 2.0
"""Side of the grid's squares, metres."""
CLEARANCE = 3.0
"""Lanes that overlap with more than this between them are levels of their own, metres."""
SPREAD = 5
"""Squares around a crossing that belong to it."""


class Levels(NamedTuple):
    """The crossings of a town."""

    middle: Floats
    """(rows, columns) height half-way between the levels of the crossing here; NaN where there is none."""
    origin: tuple[float, float]
    sites: Floats
    """(N, 3) x, y and that height, of every square where lanes overlap."""


def find_levels(town: Town) -> Levels:
    """Looks for lanes above one another."""
    xyz = town.arrays.xyz
    low = xyz[:, :2].min(0) - 8 * SQUARE
    column, row = ((xyz[:, :2] - low) / SQUARE).astype(np.int64).T
    shape = (int(row.max()) + 8, int(column.max()) + 8)
    bottom, top = np.full(shape, np.inf), np.full(shape, -np.inf)
    np.minimum.at(bottom, (row, column), xyz[:, 2])
    np.maximum.at(top, (row, column), xyz[:, 2])
    bottom, top = _spread(bottom, np.minimum, 1), _spread(top, np.maximum, 1)
    crossing = top - bottom > CLEARANCE
    middle = np.where(crossing, 0.5 * (np.where(crossing, top, 0.0) + np.where(crossing, bottom, 0.0)), np.nan)
    rows, columns = np.nonzero(crossing)
    sites = np.stack([low[0] + (columns + 0.5) * SQUARE, low[1] + (rows + 0.5) * SQUARE, middle[rows, columns]], axis=1)
    return Levels(middle=_spread(middle, np.fmax, SPREAD), origin=(float(low[0]), float(low[1])), sites=sites)


def _spread(grid: Floats, join: np.ufunc, steps: int) -> Floats:
    """Every square joined with its neighbours, `steps` times."""
    for _ in range(steps):
        for axis in (0, 1):
            grid = join(join(grid, np.roll(grid, 1, axis)), np.roll(grid, -1, axis))
    return grid


def level_count(levels: Levels) -> int:
    """How many ground levels a town has: 1 or 2."""
    return 2 if len(levels.sites) else 1


def sides(town: Town, levels: Levels, at: Floats, heights: Floats | None) -> NDArray[np.int8]:
    """Which level things at (N, 2) belong to: 0 or 1 at a crossing, -1 (both) elsewhere.

    Args:
        heights: (N,); None for things that have none of their own: they take the nearest lane's.
    """
    side = np.full(len(at), -1, np.int8)
    column, row = ((at - np.array(levels.origin)) // SQUARE).astype(np.int64).T
    rows, columns = levels.middle.shape
    middle = np.full(len(at), np.nan)
    inside = (row >= 0) & (column >= 0) & (row < rows) & (column < columns)
    middle[inside] = levels.middle[row[inside], column[inside]]
    xyz = town.arrays.xyz
    for i in np.flatnonzero(~np.isnan(middle)):
        nearest = np.argmin((xyz[:, 0] - at[i, 0]) ** 2 + (xyz[:, 1] - at[i, 1]) ** 2)
        side[i] = (xyz[nearest, 2] if heights is None else heights[i]) > middle[i]
    return side


@njit(cache=True, error_model="numpy")
def level_of(levels: Levels, x: float, y: float, z: float) -> int:
    """The ground level to draw for an ego here: above or below the middle of the nearest crossing."""
    level, nearest = 0, np.inf
    for i in range(len(levels.sites)):
        distance = (levels.sites[i, 0] - x) ** 2 + (levels.sites[i, 1] - y) ** 2
        if distance < nearest:
            nearest = distance
            level = 1 if z > levels.sites[i, 2] else 0
    return level


@njit(cache=True, error_model="numpy")
def hidden(levels: Levels, level: int, x: float, y: float, z: float) -> bool:
    """Whether something at this height is at a crossing and on the other level."""
    column, row = int((x - levels.origin[0]) // SQUARE), int((y - levels.origin[1]) // SQUARE)
    if row < 0 or column < 0 or row >= levels.middle.shape[0] or column >= levels.middle.shape[1]:
        return False
    middle = levels.middle[row, column]
    return (level == 0 and z > middle) or (level == 1 and z <= middle)

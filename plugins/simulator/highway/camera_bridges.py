"""The level that the ego is not on, as scenery: decks and piers seen from below, parapets seen from above.

All of it is of class `other`: a deck must not hide the road under it in the map from above.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from me3bev_plugins.simulator.highway.ground import Ground
from me3bev_plugins.simulator.highway.ground_levels import SQUARE, Levels
from me3bev_plugins.simulator.highway.ground_tiles import Paint, lookup
from me3bev_plugins.simulator.highway.town import Lane, Town

Floats = NDArray[np.float64]

PIECE = 6.0
"""Decks are drawn in pieces of up to so many metres."""
SLAB, PARAPET, PIER = 1.0, 0.95, 0.9
"""Thickness of a deck, height of its parapets above it, width of its piers, metres."""
_CONCRETE, _RAIL = (150.0, 148.0, 143.0), (172.0, 171.0, 167.0)
_OPEN = (Paint.GRASS, Paint.PATH)


class Part(NamedTuple):
    """A box: its middle on the ground, heading, size, underside, colour, and the level that sees it."""

    at: tuple[float, float]
    heading: float
    size: tuple[float, float, float]
    base: float
    colour: tuple[float, float, float]
    side: int


def bridge_parts(town: Town, ground: Ground) -> Iterator[Part]:
    """All decks, parapets and piers of a town."""
    if not len(ground.levels.sites):
        return
    decks = [(lane, _heights(ground.levels, lane)) for lane in town.lanes]
    decks = [(lane, drop) for lane, drop in decks if (drop > 0).any()]
    taken = np.concatenate([lane.points[drop > 0, :2] for lane, drop in decks])
    reach = np.concatenate([np.full((drop > 0).sum(), 0.5 * lane.width + 0.6) for lane, drop in decks])
    for lane, drop in decks:
        for k, (first, last) in enumerate(_pieces(lane, drop)):
            yield from _piece(lane, float(drop[first : last + 1].min()), first, last, (taken, reach))
            middle = lane.points[(first + last) // 2, :2]
            if k % 3 == 1 and lane.left is None and _open(ground, middle):
                at = (float(middle[0]), float(middle[1]))
                tall = float(drop[first : last + 1].min()) - SLAB
                yield Part(at, float(lane.heading[first]), (PIER, PIER, tall), 0.0, _CONCRETE, 0)


def _heights(levels: Levels, lane: Lane) -> Floats:
    """(P,) how far each point of a lane is above the road below it; 0 where it is on no bridge."""
    column, row = ((lane.points[:, :2] - np.array(levels.origin)) // SQUARE).astype(np.int64).T
    rows, columns = levels.middle.shape
    inside = (row >= 0) & (column >= 0) & (row < rows) & (column < columns)
    middle = np.where(inside, levels.middle[row.clip(0, rows - 1), column.clip(0, columns - 1)], np.nan)
    above = lane.points[:, 2] - middle
    return np.where(above > 0, 2.0 * above, 0.0)


def _pieces(lane: Lane, drop: Floats) -> Iterator[tuple[int, int]]:
    """First and last point of each piece."""
    on = np.flatnonzero(drop > 0)
    for run in np.split(on, np.flatnonzero(np.diff(on) > 1) + 1):
        cuts = max(1, int(np.ceil((lane.s[run[-1]] - lane.s[run[0]]) / PIECE)))
        ends = np.linspace(run[0], run[-1], cuts + 1).round().astype(int)
        yield from ((int(a), int(b)) for a, b in pairwise(ends) if b > a)


def _piece(lane: Lane, drop: float, first: int, last: int, taken: tuple[Floats, Floats]) -> Iterator[Part]:
    """The deck between two points of a lane, and parapets where no other deck is beside it."""
    a, b = lane.points[first, :2], lane.points[last, :2]
    middle, along = 0.5 * (a + b), b - a
    length, heading = float(np.hypot(*along)) + 0.3, float(np.arctan2(along[1], along[0]))
    left = np.array([-np.sin(heading), np.cos(heading)])
    at = (float(middle[0]), float(middle[1]))
    yield Part(at, heading, (length, lane.width + 0.3, SLAB), drop - SLAB, _CONCRETE, 0)
    for sign in (-1.0, 1.0):
        edge = middle + sign * (0.5 * lane.width + 0.75) * left
        if (np.hypot(*(taken[0] - edge).T) < taken[1]).any():
            continue
        place = (float(edge[0]), float(edge[1]))
        yield Part(place, heading, (length, 0.4, SLAB + PARAPET + 0.3), drop - SLAB - 0.3, _RAIL, 0)
        yield Part(place, heading, (length, 0.3, PARAPET), 0.0, _RAIL, 1)


def _open(ground: Ground, at: Floats) -> bool:
    """Whether a pier may stand here: nothing but grass around on the lower level."""
    tiles = ground.tiles
    around = at + 1.2 * np.array([(0, 0), (1, 0), (-1, 0), (0, 1), (0, -1)])
    cells = ((around - np.array(tiles.origin)) // tiles.cell).astype(int)
    return all(Paint(int(lookup(tiles.table[0], tiles.data, row, column))) in _OPEN for column, row in cells)

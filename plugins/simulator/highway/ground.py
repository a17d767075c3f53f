"""The ground of a town: painted once per process, shared by all cameras and maps of it."""

from __future__ import annotations

import weakref
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from me3bev_plugins.simulator.highway.ground_grain import plain_tiles
from me3bev_plugins.simulator.highway.ground_levels import Levels, find_levels, level_count, sides
from me3bev_plugins.simulator.highway.ground_paint import Painted, base_polygons, lane_polygons, line_polygons
from me3bev_plugins.simulator.highway.ground_tiles import (
    MIX,
    MIX_AS,
    PLAIN_TILES,
    RECORD,
    TILE,
    Paint,
    Tiles,
    close_gaps,
    fill_polygons,
    fill_tiles,
    index_tiles,
    lay_kerbs,
)
from me3bev_plugins.simulator.highway.town import Town

CELL = 0.0625
"""Metres per cell."""
MARGIN = 25.0
"""Metres of raster beyond the lanes; everything further out is grass."""
BAND = 16
"""Rows of tiles that are painted at a time."""
GUTTER = 0.6
"""Strips of grass up to this wide between asphalt and sidewalk are asphalt, metres."""
KERB = 0.18
"""Width of a kerb, metres."""
_HALO = TILE
"""Extra rows painted around a band, so that kerbs do not depend on where bands end."""

Bytes = NDArray[np.uint8]
_NO_SIDES = np.zeros(0, np.int8)


class Ground(NamedTuple):
    """A town's ground."""

    tiles: Tiles
    levels: Levels


class _Polygons(NamedTuple):
    """Polygons in painting order, in cells."""

    points: NDArray[np.float64]
    starts: NDArray[np.int64]
    codes: Bytes
    side: NDArray[np.int8]
    """(N,) the level each belongs to, -1 for both."""
    low: NDArray[np.float64]
    """(N,) lowest row of each."""
    high: NDArray[np.float64]


_cache: weakref.WeakKeyDictionary[Town, Ground] = weakref.WeakKeyDictionary()


def ground_of(town: Town) -> Ground:
    """The town's ground; painted at the first call, then shared."""
    ground = _cache.get(town)
    if ground is None:
        ground = _cache[town] = build_ground(town)
    return ground


def build_ground(town: Town) -> Ground:
    """Paints a town band by band, so that the full raster never exists."""
    x_low, y_low, x_high, y_high = town.bounds
    origin = (x_low - MARGIN, y_low - MARGIN)
    span = TILE * CELL
    rows, columns = int((y_high + MARGIN - origin[1]) / span) + 1, int((x_high + MARGIN - origin[0]) / span) + 1
    levels = find_levels(town)
    floor = _gather([*base_polygons(town), *lane_polygons(town)], town, levels, origin)
    lines = _gather(line_polygons(town), town, levels, origin)
    table = np.zeros((level_count(levels), rows, columns), np.int32)
    plain = plain_tiles()
    chunks = [plain]
    wanted = np.ones((rows, columns), bool)
    count = PLAIN_TILES
    for level in range(len(table)):
        if level > 0:
            table[level], wanted = table[0], _differing(floor, (rows, columns)) | _differing(lines, (rows, columns))
        for first in range(0, rows, BAND):
            index, here = table[level, first : first + BAND], wanted[first : first + BAND]
            if not here.any():
                continue
            raster = _paint_band(floor, lines, level, first * TILE, len(index) * TILE, columns * TILE)
            end = index_tiles(raster, index, here, count)
            data = np.zeros((end - count) * RECORD, np.uint8)
            fill_tiles(raster, index, count, data, plain, MIX, MIX_AS)
            chunks.append(data)
            count = end
    return Ground(Tiles(table=table, data=np.concatenate(chunks), origin=origin, cell=CELL), levels)


def _differing(polygons: _Polygons, shape: tuple[int, int]) -> NDArray[np.bool_]:
    """The tiles (rows, columns) that do not look the same on both levels."""
    differ = np.zeros(shape, bool)
    for n in np.flatnonzero(polygons.side >= 0):
        corners = polygons.points[polygons.starts[n] : polygons.starts[n + 1]]
        (left, bottom), (right, top) = (corners.min(0) // TILE).astype(int), (corners.max(0) // TILE).astype(int)
        differ[max(0, bottom - 1) : top + 2, max(0, left - 1) : right + 2] = True
    return differ


def _paint_band(floor: _Polygons, lines: _Polygons, level: int, first: int, rows: int, columns: int) -> Bytes:
    """The cells (rows, columns) from row `first` on."""
    raster = np.zeros((rows + 2 * _HALO, columns), np.uint8)
    _fill(raster, floor, level, first - _HALO)
    close_gaps(raster, int(Paint.GRASS), int(Paint.ASPHALT), int(Paint.SIDEWALK), round(GUTTER / CELL))
    lay_kerbs(raster, int(Paint.ASPHALT), int(Paint.SIDEWALK), int(Paint.KERB), round(KERB / CELL))
    _fill(raster, lines, level, first - _HALO)
    return np.ascontiguousarray(raster[_HALO:-_HALO])


def _fill(raster: Bytes, polygons: _Polygons, level: int, first: int) -> None:
    shown = (polygons.side < 0) | (polygons.side == level)
    inside = np.flatnonzero(shown & (polygons.high >= first) & (polygons.low <= first + len(raster)))
    fill_polygons(raster, polygons.points, polygons.starts, polygons.codes, inside, first)


def _gather(painted: Iterable[Painted], town: Town, levels: Levels, origin: tuple[float, float]) -> _Polygons:
    """All polygons, in cells from the raster's corner."""
    points, sizes, codes, side = [np.zeros((0, 2))], [np.zeros(0, np.int64)], [np.zeros(0, np.uint8)], [_NO_SIDES]
    for quads, code, heights in painted:
        points.append(quads.reshape(-1, 2))
        sizes.append(np.full(len(quads), quads.shape[1], np.int64))
        codes.append(np.full(len(quads), code, np.uint8))
        two = level_count(levels) > 1
        side.append(sides(town, levels, quads.mean(axis=1), heights) if two else np.full(len(quads), -1, np.int8))
    starts = np.concatenate([[0], np.cumsum(np.concatenate(sizes))]).astype(np.int64)
    cells = np.ascontiguousarray((np.concatenate(points) - np.array(origin)) / CELL)
    some = len(cells) > 0
    return _Polygons(
        points=cells,
        starts=starts,
        codes=np.concatenate(codes),
        side=np.concatenate(side),
        low=np.minimum.reduceat(cells[:, 1], starts[:-1]) if some else np.zeros(0),
        high=np.maximum.reduceat(cells[:, 1], starts[:-1]) if some else np.zeros(0),
    )

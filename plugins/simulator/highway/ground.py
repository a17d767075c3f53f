"""The ground of a town: painted once per process, shared by all cameras and maps of it."""

from __future__ import annotations

import weakref
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from me3bev_plugins.simulator.highway.ground_paint import Painted, base_polygons, lane_polygons, line_polygons
from me3bev_plugins.simulator.highway.ground_tiles import (
    BASES,
    MIX,
    MIX_AS,
    RECORD,
    TILE,
    Paint,
    Tiles,
    fill_polygons,
    fill_tiles,
    index_tiles,
    lay_kerbs,
)
from me3bev_plugins.simulator.highway.town import Town

CELL = 0.1
"""Metres per cell."""
MARGIN = 25.0
"""Metres of raster beyond the lanes; everything further out is grass."""

_cache: weakref.WeakKeyDictionary[Town, Tiles] = weakref.WeakKeyDictionary()


def ground_of(town: Town) -> Tiles:
    """The town's ground; painted at the first call, then shared."""
    tiles = _cache.get(town)
    if tiles is None:
        tiles = _cache[town] = build_ground(town)
    return tiles


def build_ground(town: Town) -> Tiles:
    """Paints a town. The full raster exists only while this runs."""
    lanes = list(town.lanes)
    x_low, y_low, x_high, y_high = town.bounds
    origin = (x_low - MARGIN, y_low - MARGIN)
    span = TILE * CELL
    shape = (int((y_high + MARGIN - origin[1]) / span) + 1, int((x_high + MARGIN - origin[0]) / span) + 1)
    raster = np.zeros((shape[0] * TILE, shape[1] * TILE), np.uint8)
    _paint(raster, origin, [*base_polygons(town), *lane_polygons(lanes)])
    lay_kerbs(raster, int(Paint.ASPHALT), int(Paint.SIDEWALK), int(Paint.KERB), 2)
    _paint(raster, origin, line_polygons(town, lanes))
    index = np.zeros((1, *shape), np.int32)
    count = index_tiles(raster, index[0], BASES)
    data = np.zeros(count * RECORD, np.uint8)
    data[: BASES * RECORD] = np.repeat(np.arange(BASES, dtype=np.uint8), RECORD)
    fill_tiles(raster, index[0], BASES, data, MIX, MIX_AS)
    return Tiles(table=index, data=data, origin=origin, cell=CELL)


def _paint(raster: NDArray[np.uint8], origin: tuple[float, float], painted: Iterable[Painted]) -> None:
    points, sizes, codes = [np.zeros((0, 2))], [np.zeros(0, np.int64)], [np.zeros(0, np.uint8)]
    for quads, code in painted:
        points.append(quads.reshape(-1, 2))
        sizes.append(np.full(len(quads), quads.shape[1], np.int64))
        codes.append(np.full(len(quads), code, np.uint8))
    starts = np.concatenate([[0], np.cumsum(np.concatenate(sizes))]).astype(np.int64)
    cells = (np.concatenate(points) - np.array(origin)) / CELL
    fill_polygons(raster, cells, starts, np.concatenate(codes))

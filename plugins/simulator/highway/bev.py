"""The scene from above: the semantic map that is the perception's truth."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from me3bev_cli.api import BEV_CLASSES
from me3bev_plugins.simulator.highway.camera_things import BUILDING, PEDESTRIAN, VEHICLE, Gathering
from me3bev_plugins.simulator.highway.compiled import kernel
from me3bev_plugins.simulator.highway.ground_tiles import (
    BASES,
    MIX_PARTS,
    PAINTED,
    PATTERN,
    PLAIN_TILES,
    RECORD,
    Paint,
    Tiles,
    lookup,
    lookup_mip,
)
from me3bev_plugins.simulator.highway.ground_tiles import SEMANTIC as GROUND_SEMANTIC
from me3bev_plugins.simulator.highway.raster import COS, LENGTH, SEMANTIC, SIN, WIDTH, Things, X, Y
from me3bev_plugins.simulator.highway.scene import Scene

Bytes = NDArray[np.uint8]
Floats = NDArray[np.float64]

_ENOUGH = 10
"""Paint that makes a cell marking or crosswalk, of 72 (nine samples in eighths)."""
_BLOCK = 4
"""Cells in a block that is looked over for paint at once: most have none."""
_MARKING, _CROSSWALK = BEV_CLASSES.index("lane_marking"), BEV_CLASSES.index("crosswalk")


def bev_semantics(scene: Scene, cells: int = 200, cell: float = 0.5) -> Bytes:
    """The classes (cells, cells) around the ego, as `BEV_CLASSES`; the ego itself is not drawn.

    Row 0 is farthest ahead, column 0 farthest left; the ego stands in the middle. A cell takes the class at
    its centre; it is lane marking (or crosswalk) already when paint covers a seventh of it, since lines are narrower
    than cells. It is building, vehicle or pedestrian when its centre is inside one's box; the
    cell under a pedestrian's centre always is pedestrian.

    Args:
        cells: side of the map.
        cell: metres.
    """
    near = Gathering(scene.town)
    pose, count, level = near.collect(scene, 0.75 * cells * cell)
    out = np.empty((cells, cells), np.uint8)
    _sample_ground(near.ground.tiles, level, pose, cell, out)
    for semantic in (BUILDING, VEHICLE, PEDESTRIAN):
        _paint_boxes(near.things, count, semantic, semantic == PEDESTRIAN, cell, out)
    return out


def _paint_shares(paints: tuple[Paint, ...]) -> NDArray[np.int64]:
    """(CODES,) eighths of a cell that are one of `paints`."""
    first, second, eighths = MIX_PARTS.T
    chosen = [int(paint) for paint in paints]
    return np.where(np.isin(first, chosen), 8 - eighths, 0) + np.where(np.isin(second, chosen), eighths, 0)


_LINES = _paint_shares((Paint.WHITE, Paint.YELLOW))
_CROSSINGS = _paint_shares((Paint.ZEBRA, Paint.ZEBRA_GAP))
_PAINT = (_LINES + _CROSSINGS)[:BASES] > 0
"""(BASES,) whether a class is paint."""
_PLAIN, _ALIKE = np.uint64(PLAIN_TILES), np.uint64(PATTERN * PATTERN)
"""Tiles of one class have the first numbers, so many of each class."""


@kernel
def _sample_ground(tiles: Tiles, town_level: int, pose: Floats, cell: float, out: Bytes) -> None:
    """Ground classes; paint is measured on nine samples that are together as wide as the cell."""
    cells = out.shape[0]
    index, data = tiles.table[town_level], tiles.data
    level = 0
    while level < 5 and tiles.cell * 2 ** (level + 1) <= 0.5 * cell:
        level += 1
    scale = 1.0 / tiles.cell
    x_step, y_step = pose[2] * cell / 3 * scale, pose[3] * cell / 3 * scale
    around = abs(x_step) + abs(y_step)
    # One cell more than the block's half-diagonal and its samples: a block without paint has no cell with any.
    reach = 1.5 * (_BLOCK - 1) * around + around + 1.0
    for top in range(0, cells, _BLOCK):
        for left in range(0, cells, _BLOCK):
            x, y = (0.5 * (cells - _BLOCK) - top) * cell, (0.5 * (cells - _BLOCK) - left) * cell
            east = (pose[0] + pose[2] * x - pose[3] * y - tiles.origin[0]) * scale
            north = (pose[1] + pose[3] * x + pose[2] * y - tiles.origin[1]) * scale
            painted = _painted_around(index, data, north, east, reach)
            for row in range(top, min(top + _BLOCK, cells)):
                x = (0.5 * cells - row - 0.5) * cell
                for column in range(left, min(left + _BLOCK, cells)):
                    y = (0.5 * cells - column - 0.5) * cell
                    east = (pose[0] + pose[2] * x - pose[3] * y - tiles.origin[0]) * scale
                    north = (pose[1] + pose[3] * x + pose[2] * y - tiles.origin[1]) * scale
                    if painted and _painted_around(index, data, north, east, around):
                        out[row, column] = _painted_class(index, data, north, east, x_step, y_step, level)
                    else:
                        at = _base(index, data, int(np.floor(north)), int(np.floor(east)))
                        out[row, column] = GROUND_SEMANTIC[at]


@kernel
def _painted_class(
    index: NDArray[np.int32], data: Bytes, north: float, east: float, x_step: float, y_step: float, level: int
) -> int:
    """The class of a cell that may have paint on it, by nine samples."""
    lines, crossings = 0, 0
    for i in range(-1, 2):
        for j in range(-1, 2):
            e, n = east + i * x_step - j * y_step, north + i * y_step + j * x_step
            code = _code(index, data, int(np.floor(n)), int(np.floor(e)), level)
            lines += _LINES[code]
            crossings += _CROSSINGS[code]
    if crossings >= _ENOUGH:
        return _CROSSWALK
    if lines >= _ENOUGH:
        return _MARKING
    return int(GROUND_SEMANTIC[_base(index, data, int(np.floor(north)), int(np.floor(east)))])


@kernel
def _base(index: NDArray[np.int32], data: Bytes, row: int, column: int) -> np.uint64:
    """As `lookup`. Of a tile of one class the number tells which: that spares a read from far away in memory."""
    ty, tx = row >> 5, column >> 5
    if 0 <= ty < index.shape[0] and 0 <= tx < index.shape[1]:
        record = np.uint64(index[ty, tx])
        if record < _PLAIN:
            return np.uint64(record // _ALIKE)
    return np.uint64(lookup(index, data, row, column))


@kernel
def _code(index: NDArray[np.int32], data: Bytes, row: int, column: int, level: int) -> np.uint64:
    """As `lookup_mip`, with the same short cut."""
    ty, tx = row >> 5, column >> 5
    if 0 <= ty < index.shape[0] and 0 <= tx < index.shape[1]:
        record = np.uint64(index[ty, tx])
        if record < _PLAIN:
            return np.uint64(record // _ALIKE)
    return np.uint64(lookup_mip(index, data, row, column, level))


@kernel
def _painted_around(index: NDArray[np.int32], data: Bytes, north: float, east: float, reach: float) -> bool:
    """Whether any tile within `reach` cells of a place has lines or crossings in it."""
    low, high = int(np.floor(north - reach)) >> 5, int(np.floor(north + reach)) >> 5
    left, right = int(np.floor(east - reach)) >> 5, int(np.floor(east + reach)) >> 5
    for ty in range(max(0, low), min(index.shape[0] - 1, high) + 1):
        for tx in range(max(0, left), min(index.shape[1] - 1, right) + 1):
            record = np.uint64(index[ty, tx])
            if record < _PLAIN:
                if _PAINT[record // _ALIKE]:
                    return True
            elif data[np.int64(record) * RECORD + PAINTED]:
                return True
    return False


@kernel
def _paint_boxes(things: Things, count: int, semantic: int, always: bool, cell: float, out: Bytes) -> None:
    """Paints the cells whose centres are inside boxes of one class; `always` also those under their middles."""
    cells = out.shape[0]
    half = 0.5 * cells
    for i in range(count):
        if things.label[i, SEMANTIC] != semantic:
            continue
        n = things.number[i]
        rx = 0.5 * (abs(n[COS]) * n[LENGTH] + abs(n[SIN]) * n[WIDTH])
        ry = 0.5 * (abs(n[SIN]) * n[LENGTH] + abs(n[COS]) * n[WIDTH])
        top, bottom = max(0, int(half - (n[X] + rx) / cell)), min(cells, int(half - (n[X] - rx) / cell) + 1)
        left, right = max(0, int(half - (n[Y] + ry) / cell)), min(cells, int(half - (n[Y] - ry) / cell) + 1)
        for row in range(top, bottom):
            for column in range(left, right):
                dx, dy = (half - row - 0.5) * cell - n[X], (half - column - 0.5) * cell - n[Y]
                along, across = n[COS] * dx + n[SIN] * dy, n[COS] * dy - n[SIN] * dx
                if abs(along) <= 0.5 * n[LENGTH] and abs(across) <= 0.5 * n[WIDTH]:
                    out[row, column] = semantic
        if always:
            row, column = int(np.floor(half - n[X] / cell)), int(np.floor(half - n[Y] / cell))
            if 0 <= row < cells and 0 <= column < cells:
                out[row, column] = semantic

"""The scene from above: the semantic map that is the perception's truth."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from me3bev_cli.api import BEV_CLASSES
from me3bev_plugins.simulator.highway.camera_things import BUILDING, PEDESTRIAN, VEHICLE, Gathering
from me3bev_plugins.simulator.highway.compiled import kernel
from me3bev_plugins.simulator.highway.ground_tiles import MIX_PARTS, PAINTED, RECORD, Paint, Tiles, lookup, lookup_mip
from me3bev_plugins.simulator.highway.ground_tiles import SEMANTIC as GROUND_SEMANTIC
from me3bev_plugins.simulator.highway.raster import COS, LENGTH, SEMANTIC, SIN, WIDTH, Things, X, Y
from me3bev_plugins.simulator.highway.scene import Scene

Bytes = NDArray[np.uint8]
Floats = NDArray[np.float64]

_ENOUGH = 10
"""Paint that makes a cell marking or crosswalk, of 72 (nine samples in eighths)."""
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
    for row in range(cells):
        x = (0.5 * cells - row - 0.5) * cell
        for column in range(cells):
            y = (0.5 * cells - column - 0.5) * cell
            east = (pose[0] + pose[2] * x - pose[3] * y - tiles.origin[0]) * scale
            north = (pose[1] + pose[3] * x + pose[2] * y - tiles.origin[1]) * scale
            lines, crossings = 0, 0
            if _painted_around(index, data, north, east, abs(x_step) + abs(y_step)):
                for i in range(-1, 2):
                    for j in range(-1, 2):
                        e, n = east + i * x_step - j * y_step, north + i * y_step + j * x_step
                        code = np.uint64(lookup_mip(index, data, int(np.floor(n)), int(np.floor(e)), level))
                        lines += _LINES[code]
                        crossings += _CROSSINGS[code]
            if crossings >= _ENOUGH:
                out[row, column] = _CROSSWALK
            elif lines >= _ENOUGH:
                out[row, column] = _MARKING
            else:
                at = lookup(index, data, int(np.floor(north)), int(np.floor(east)))
                out[row, column] = GROUND_SEMANTIC[np.uint64(at)]


@kernel
def _painted_around(index: NDArray[np.int32], data: Bytes, north: float, east: float, reach: float) -> bool:
    """Whether any tile within `reach` cells of a place has lines or crossings in it."""
    low, high = int(np.floor(north - reach)) >> 5, int(np.floor(north + reach)) >> 5
    left, right = int(np.floor(east - reach)) >> 5, int(np.floor(east + reach)) >> 5
    for ty in range(max(0, low), min(index.shape[0] - 1, high) + 1):
        for tx in range(max(0, left), min(index.shape[1] - 1, right) + 1):
            if data[np.int64(index[ty, tx]) * RECORD + PAINTED]:
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

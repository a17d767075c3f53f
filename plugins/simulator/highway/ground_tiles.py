"""The ground as tiles: painting polygons into a class raster, packing it with mip levels, and looking it up.

A raster cell holds a code: a base class (`Paint` below) with one of eight shades or, in the coarser mip levels, a
mix of two classes in eighths. Tiles of 32 x 32 cells keep all their mip levels together; tiles of one class are
stored once for each place in the pattern of shades, so a large town costs what its roads cost.
"""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

Bytes = NDArray[np.uint8]
Floats = NDArray[np.float64]

TILE = 32
LEVELS = 6
"""Mip level m halves the cells m times: 32 x 32 cells down to one."""
OFFSETS = np.array([0, 1024, 1280, 1344, 1360, 1364], np.int64)
"""Where each level begins within a tile's record."""
RECORD = 1368
PAINTED = 1365
"""Byte of a tile's record that says whether lines or crossings are in it."""
SHADES = 8
"""Brightness steps of the ground's grain."""
PATTERN = 4
"""The grain repeats after this many tiles."""


class Paint(IntEnum):
    """Base classes of the ground raster."""

    GRASS = 0
    ASPHALT = 1
    SIDEWALK = 2
    WHITE = 3
    YELLOW = 4
    ZEBRA = 5
    """White of crosswalk stripes and stop lines."""
    ZEBRA_GAP = 6
    """Asphalt between a crosswalk's stripes."""
    PATH = 7
    """Unpaved roadside."""
    KERB = 8


BASES = len(Paint)
SEMANTIC = np.array([0, 1, 4, 2, 2, 3, 3, 0, 4], np.uint8)
"""Paint -> index into `me3bev_cli.api.BEV_CLASSES`."""
_MIXED = (Paint.GRASS, Paint.ASPHALT, Paint.SIDEWALK, Paint.WHITE, Paint.YELLOW, Paint.ZEBRA, Paint.ZEBRA_GAP)
MIX_AS = np.array([0, 1, 2, 3, 4, 5, 6, 0, 2], np.int64)
"""Which mixable class stands for each base class in a mix."""


def _mix_codes() -> tuple[Bytes, NDArray[np.int64]]:
    """(first, second, eighths of second) -> code, and code -> those three (-1 eighths for a base class)."""
    table = np.zeros((BASES, BASES, 9), np.uint8)
    parts = [(base, base, 0) for base in range(BASES)]
    for i, first in enumerate(_MIXED):
        for second in _MIXED[i + 1 :]:
            for eighths in range(1, 8):
                table[first, second, eighths] = table[second, first, 8 - eighths] = len(parts)
                parts.append((int(first), int(second), eighths))
    for base in range(BASES):
        table[base, :, 0] = base
        table[:, base, 8] = base
        table[base, base, :] = base
    return table, np.array(parts, np.int64)


_FIRST_PAINT, _LAST_PAINT = int(Paint.WHITE), int(Paint.ZEBRA)
_ZEBRA_GAP = int(Paint.ZEBRA_GAP)
MIX, MIX_PARTS = _mix_codes()
CODES = len(MIX_PARTS)
"""Classes and mixes; what cells hold is a class times SHADES plus a shade, or MIX_FIRST plus a mix."""
MIX_FIRST = BASES * SHADES
PLAIN_TILES = BASES * PATTERN * PATTERN
"""Records of tiles of one class."""
_SHIFT = np.int64(MIX_FIRST - BASES)


class Tiles(NamedTuple):
    """A town's ground. Cell (row, column) covers `origin + cell * (column, row)` onwards, rows to the north."""

    table: NDArray[np.int32]
    """(levels of the town, rows of tiles, columns of tiles) -> record."""
    data: Bytes
    """(records * RECORD,)"""
    origin: tuple[float, float]
    cell: float
    """Metres."""


@njit(cache=True, error_model="numpy")
def fill_polygons(
    raster: Bytes,
    points: Floats,
    starts: NDArray[np.int64],
    codes: Bytes,
    chosen: NDArray[np.int64],
    first_row: int,
) -> None:
    """Paints polygons in order; a cell is inside when its centre is (even-odd rule).

    Args:
        raster: (rows, columns), changed in place.
        points: (P, 2) column, row, in cells.
        starts: (N + 1,) into `points`.
        codes: (N,)
        chosen: which of the N to paint.
        first_row: the row at which the raster begins.
    """
    rows, columns = raster.shape
    crossing = np.empty(np.max(np.diff(starts)) if len(starts) > 1 else 1)
    for n in chosen:
        first, end = starts[n], starts[n + 1]
        low, high = np.inf, -np.inf
        for i in range(first, end):
            low, high = min(low, points[i, 1]), max(high, points[i, 1])
        low, high = low - first_row, high - first_row
        for row in range(max(0, int(np.ceil(low - 0.5))), min(rows, int(np.ceil(high - 0.5)))):
            y = row + first_row + 0.5
            count = 0
            j = end - 1
            for i in range(first, end):
                if (points[i, 1] <= y) != (points[j, 1] <= y):
                    share = (y - points[i, 1]) / (points[j, 1] - points[i, 1])
                    x = points[i, 0] + share * (points[j, 0] - points[i, 0])
                    k = count
                    while k > 0 and crossing[k - 1] > x:
                        crossing[k] = crossing[k - 1]
                        k -= 1
                    crossing[k] = x
                    count += 1
                j = i
            for k in range(0, count - 1, 2):
                left = max(0, int(np.ceil(crossing[k] - 0.5)))
                right = min(columns, int(np.ceil(crossing[k + 1] - 0.5)))
                raster[row, left:right] = codes[n]


@njit(cache=True, error_model="numpy")
def close_gaps(raster: Bytes, gap: int, one: int, two: int, limit: int) -> None:
    """Turns runs of at most `limit` cells of `gap` between `one` and `two`, along rows or columns, into `one`."""
    rows, columns = raster.shape
    for row in range(rows):
        last, at = gap, 0
        for column in range(columns):
            code = raster[row, column]
            if code == gap:
                continue
            if 0 < column - at - 1 <= limit and ((code == one and last == two) or (code == two and last == one)):
                raster[row, at + 1 : column] = one
            last, at = code, column
    above, since = np.full(columns, gap, np.uint8), np.zeros(columns, np.int64)
    for row in range(rows):
        for column in range(columns):
            code = raster[row, column]
            if code == gap:
                continue
            last, at = above[column], since[column]
            if 0 < row - at - 1 <= limit and ((code == one and last == two) or (code == two and last == one)):
                for k in range(at + 1, row):
                    raster[k, column] = one
            above[column], since[column] = code, row


@njit(cache=True, error_model="numpy")
def lay_kerbs(raster: Bytes, asphalt: int, sidewalk: int, kerb: int, reach: int) -> None:
    """Turns sidewalk cells within `reach` cells of asphalt into kerb."""
    rows, columns = raster.shape
    for row in range(reach, rows - reach):
        for column in range(reach, columns - reach):
            if raster[row, column] != sidewalk:
                continue
            for step in range(1, reach + 1):
                if (
                    raster[row - step, column] == asphalt
                    or raster[row + step, column] == asphalt
                    or raster[row, column - step] == asphalt
                    or raster[row, column + step] == asphalt
                ):
                    raster[row, column] = kerb
                    break


@njit(cache=True, error_model="numpy")
def index_tiles(raster: Bytes, index: NDArray[np.int32], wanted: NDArray[np.bool_], count: int) -> int:
    """Numbers the wanted tiles that need a record of their own from `count` on; returns the new count.

    The raster begins at a multiple of PATTERN tiles.
    """
    for ty in range(index.shape[0]):
        for tx in range(index.shape[1]):
            if not wanted[ty, tx]:
                continue
            code = raster[ty * TILE, tx * TILE]
            uniform = True
            for row in range(ty * TILE, (ty + 1) * TILE):
                for column in range(tx * TILE, (tx + 1) * TILE):
                    uniform &= raster[row, column] == code
                if not uniform:
                    break
            if uniform:
                index[ty, tx] = (np.int64(code) * PATTERN + (ty & 3)) * PATTERN + (tx & 3)
            else:
                index[ty, tx] = count
                count += 1
    return count


@njit(cache=True, error_model="numpy")
def fill_tiles(
    raster: Bytes,
    index: NDArray[np.int32],
    first: int,
    data: Bytes,
    plain: Bytes,
    mix: Bytes,
    mix_as: NDArray[np.int64],
) -> None:
    """Writes the records numbered `first` and above, the first at the beginning of `data`: cells and mip levels.

    Args:
        plain: `plain_tiles()`, which hold the shades.
    """
    bases = mix.shape[0]
    counts = np.zeros((TILE, TILE, bases), np.int32)
    for ty in range(index.shape[0]):
        for tx in range(index.shape[1]):
            if index[ty, tx] < first:
                continue
            at = (index[ty, tx] - first) * RECORD
            shades = ((ty & 3) * PATTERN + (tx & 3)) * RECORD
            counts[:] = 0
            for y in range(TILE):
                for x in range(TILE):
                    code = raster[ty * TILE + y, tx * TILE + x]
                    data[at + y * TILE + x] = code * SHADES + plain[shades + y * TILE + x]
                    counts[y, x, mix_as[code]] = 1
                    if _FIRST_PAINT <= code <= _ZEBRA_GAP:
                        data[at + PAINTED] = 1
            size = TILE
            for level in range(1, LEVELS):
                size //= 2
                for y in range(size):
                    for x in range(size):
                        for k in range(bases):
                            counts[y, x, k] = (
                                counts[2 * y, 2 * x, k]
                                + counts[2 * y, 2 * x + 1, k]
                                + counts[2 * y + 1, 2 * x, k]
                                + counts[2 * y + 1, 2 * x + 1, k]
                            )
                        cell = OFFSETS[level] + y * size + x
                        code = _mixed(counts[y, x], mix)
                        data[at + cell] = code * SHADES + plain[shades + cell] if code < bases else code + _SHIFT


@njit(cache=True, error_model="numpy")
def _mixed(counts: NDArray[np.int32], mix: Bytes) -> np.uint8:
    """The code of the commonest class and the next one in their proportion; paint goes before other ground."""
    best = 0
    for k in range(1, len(counts)):
        if counts[k] > counts[best]:
            best = k
    second = best
    for k in range(len(counts)):
        weight = counts[k] * (8 if _FIRST_PAINT <= k <= _LAST_PAINT else 1)
        other = counts[second] * (8 if _FIRST_PAINT <= second <= _LAST_PAINT else 1)
        if k != best and (second == best or weight > other) and counts[k] > 0:
            second = k
    if second == best:
        return np.uint8(best)
    total = counts.sum()
    eighths = (16 * counts[second] + total) // (2 * total)
    return np.uint8(mix[best, second, eighths])


@njit(cache=True, inline="always", error_model="numpy")
def lookup(index: NDArray[np.int32], data: Bytes, row: int, column: int) -> np.uint8:
    """The base class of a cell; grass outside the raster. `index` is one level's (rows, columns)."""
    ty, tx = row >> 5, column >> 5
    if ty < 0 or tx < 0 or ty >= index.shape[0] or tx >= index.shape[1]:
        return np.uint8(0)
    return np.uint8(data[index[ty, tx] * RECORD + ((row & 31) << 5) + (column & 31)] >> 3)


@njit(cache=True, inline="always", error_model="numpy")
def lookup_mip(index: NDArray[np.int32], data: Bytes, row: int, column: int, level: int) -> np.uint8:
    """The class or mix (0..CODES - 1) of the mip cell that holds a cell; grass outside the raster."""
    ty, tx = row >> 5, column >> 5
    if ty < 0 or tx < 0 or ty >= index.shape[0] or tx >= index.shape[1]:
        return np.uint8(0)
    at = (((row & 31) >> level) << (5 - level)) + ((column & 31) >> level)
    code = data[index[ty, tx] * RECORD + OFFSETS[level] + at]
    return np.uint8(code >> 3 if code < MIX_FIRST else code - _SHIFT)

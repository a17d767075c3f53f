"""From the visibility buffer to the picture: sky, painted ground, faces, walls with windows."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from me3bev_plugins.simulator.highway.compiled import kernel
from me3bev_plugins.simulator.highway.ground_tiles import BASES, OFFSETS, PATTERN, RECORD, SHADES, Tiles
from me3bev_plugins.simulator.highway.raster_backdrop import Backdrop, code_colours
from me3bev_plugins.simulator.highway.raster_buffers import SHADED, Canvas, Floats, Lenses, Singles
from me3bev_plugins.simulator.highway.raster_dress import BEAM_REACH, WALL
from me3bev_plugins.simulator.highway.raster_walls import strip_of, wall_run

__all__ = ["BASES", "SHADES", "code_colours", "ground_row", "paint"]

Bytes = NDArray[np.uint8]


@kernel
def paint(
    camera: int,
    lenses: Lenses,
    drop: Backdrop,
    tiles: Tiles,
    town_level: int,
    pose: Floats,
    light: Floats,
    low_sun: bool,
    canvas: Canvas,
    out: Bytes,
) -> None:
    """Colours one camera's picture.

    Args:
        town_level: which of the town's ground levels.
        pose: (4,) the ego's x, y, cosine and sine of heading in the world.
        light: as `raster_dress` says.
        low_sun: whether the sky glows by `canvas.warmth`.
        out: (3, H, W), written.
    """
    height, width = canvas.inverse.shape
    R, pin = lenses.rotation[camera], lenses.pinhole[camera]
    ground, index = canvas.row, tiles.table[town_level]
    eye = np.float32(lenses.position[camera, 2])
    canvas.strips[0] = 0
    for row in range(height):
        level = drop.level[camera, row]
        y = (row + 0.5 - pin[3]) / pin[1]
        rise = np.float32(R[1, 2] * y + R[2, 2])
        if level >= 0:
            ground_row(camera, lenses, drop.depth[camera, row], y, pose, tiles.origin, tiles.cell, ground)
        faces, first = canvas.face[row], 0
        while first < width:
            face, end = faces[first], first + 1
            while end + 16 <= width:
                other = np.int32(0)
                for k in range(16):
                    other |= faces[end + k] ^ face
                if other != 0:
                    break
                end += 16
            while end < width and faces[end] == face:
                end += 1
            red, green, blue = out[0, row, first:end], out[1, row, first:end], out[2, row, first:end]
            if face >= 0:
                if canvas.style[face] == WALL:
                    slot = strip_of(face, row, y, R, pin, light, canvas)
                    strip, depth = canvas.strip[slot], canvas.strip_depth[slot]
                    wall_run(strip, depth, canvas.wall[face], rise, eye, light, first, end, canvas.packed)
                    _unpack(canvas.packed[first:end], red, green, blue)
                    share = canvas.wall[face, 15] / canvas.wall[face, 13]
                    if share > 0.0 and drop.cone.shape[1] > 0:
                        _light_wall(
                            canvas.inverse[row, first:end], drop.cone[camera, row, first:end], share, canvas.gain
                        )
                        _brighten(canvas.gain, red, green, blue)
                else:
                    colour = canvas.colour[face]
                    red[:], green[:], blue[:] = colour[0], colour[1], colour[2]
            elif level >= 0:
                colours = drop.ground[camera, row, 1 if face == SHADED else 0]
                _paint_ground(first, level, ground, index, tiles.data, colours, red, green, blue)
                if drop.lamp.shape[1] > 0:
                    _light_ground(canvas.lamp[row, first:end], red, green, blue)
            else:
                sky = drop.sky[camera, row]
                red[:], green[:], blue[:] = sky[0], sky[1], sky[2]
                if low_sun:
                    _warm(drop.warm[camera, row], canvas.warmth[first:end], red, green, blue)
            first = end


@kernel
def ground_row(
    camera: int,
    lenses: Lenses,
    depth: float,
    y: float,
    pose: Floats,
    origin: tuple[float, float],
    cell: float,
    out: Floats,
) -> None:
    """Column and row (in cells) of the ground under a row's first pixel, then the step from pixel to pixel."""
    R, at, pin = lenses.rotation[camera], lenses.position[camera], lenses.pinhole[camera]
    x = (0.5 - pin[2]) / pin[0]
    ex = at[0] + depth * (R[0, 0] * x + R[1, 0] * y + R[2, 0])
    ey = at[1] + depth * (R[0, 1] * x + R[1, 1] * y + R[2, 1])
    sx, sy = depth * R[0, 0] / pin[0], depth * R[0, 1] / pin[0]
    out[0] = (pose[0] + pose[2] * ex - pose[3] * ey - origin[0]) / cell
    out[1] = (pose[1] + pose[3] * ex + pose[2] * ey - origin[1]) / cell
    out[2] = (pose[2] * sx - pose[3] * sy) / cell
    out[3] = (pose[3] * sx + pose[2] * sy) / cell


@kernel
def _paint_ground(
    first: int,
    level: int,
    ground: Floats,
    index: NDArray[np.int32],
    data: Bytes,
    colours: NDArray[np.uint32],
    red: Bytes,
    green: Bytes,
    blue: Bytes,
) -> None:
    """A run of ground from column `first` on. Positions step in fixed point."""
    column_step, row_step = np.int64(np.round(ground[2] * 65536)), np.int64(np.round(ground[3] * 65536))
    column_at = np.int64(np.floor(ground[0] * 65536)) + first * column_step
    row_at = np.int64(np.floor(ground[1] * 65536)) + first * row_step
    bottom, right = np.uint64(index.shape[0]), np.uint64(index.shape[1])
    offset, line = OFFSETS[level], np.int64(5 - level)
    for column in range(len(red)):
        r, c = row_at >> 16, column_at >> 16
        ty, tx = r >> 5, c >> 5
        record = (ty & (PATTERN - 1)) * PATTERN + (tx & (PATTERN - 1))
        if np.uint64(ty) < bottom and np.uint64(tx) < right:
            record = np.int64(index[np.uint64(ty), np.uint64(tx)])
        at = record * RECORD + offset + ((r & 31) >> level << line) + ((c & 31) >> level)
        colour = colours[np.uint64(data[np.uint64(at)])]
        red[column], green[column], blue[column] = colour, colour >> 8, colour >> 16
        column_at += column_step
        row_at += row_step


@kernel
def _unpack(packed: NDArray[np.int32], red: Bytes, green: Bytes, blue: Bytes) -> None:
    """Colours in one number each, written apart: what works out the colours can then be vectorised."""
    for column in range(len(packed)):
        red[column] = packed[column]
        green[column] = packed[column] >> 8
        blue[column] = packed[column] >> 16


@kernel
def _light_ground(lamp: Bytes, red: Bytes, green: Bytes, blue: Bytes) -> None:
    """A run of ground by the light of lamps."""
    for channel in (red, green, blue):
        for column in range(len(channel)):
            channel[column] = (np.uint16(channel[column]) * np.uint16(lamp[column])) >> 8


@kernel
def _warm(warm: Bytes, warmth: NDArray[np.int32], red: Bytes, green: Bytes, blue: Bytes) -> None:
    """Adds the glow of a low sun to a run of sky."""
    r, g, b = np.int32(warm[0]), np.int32(warm[1]), np.int32(warm[2])
    for column in range(len(red)):
        red[column] += (r * warmth[column]) >> 8
        green[column] += (g * warmth[column]) >> 8
        blue[column] += (b * warmth[column]) >> 8


@kernel
def _light_wall(inverse: Singles, cone: Singles, share: float, gain: NDArray[np.int32]) -> None:
    """How many times brighter the own beam makes a run of a wall, of 256."""
    reach, much = np.float32(BEAM_REACH * BEAM_REACH), np.float32(256.0 * share)
    for column in range(len(inverse)):
        closeness = inverse[column] * inverse[column] * reach
        gain[column] = np.int32(np.float32(256.0) + much * cone[column] * closeness / (np.float32(1.0) + closeness))


@kernel
def _brighten(gain: NDArray[np.int32], red: Bytes, green: Bytes, blue: Bytes) -> None:
    """Multiplies a run."""
    for channel in (red, green, blue):
        for column in range(len(channel)):
            channel[column] = min(np.int32(255), np.int32(np.int32(channel[column]) * gain[column]) >> np.int32(8))

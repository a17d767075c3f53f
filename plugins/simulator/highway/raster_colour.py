"""From the visibility buffer to the picture: sky, painted ground, faces, walls with windows."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from me3bev_plugins.simulator.highway.compiled import kernel
from me3bev_plugins.simulator.highway.ground_tiles import BASES, OFFSETS, PATTERN, RECORD, SHADES, Tiles
from me3bev_plugins.simulator.highway.raster_backdrop import Backdrop, code_colours
from me3bev_plugins.simulator.highway.raster_buffers import SHADED, Canvas, Floats, Lenses, Singles
from me3bev_plugins.simulator.highway.raster_dress import BEAM, BEAM_REACH, HAZE, LIT, THICKNESS, WALL

__all__ = ["BASES", "SHADES", "code_colours", "ground_row", "paint"]

Bytes = NDArray[np.uint8]

WINDOWS = np.array(
    [(0.24, 0.76, 0.28, 0.78), (-1.0, 2.0, 0.36, 0.8), (0.3, 0.7, 0.14, 0.88), (0.12, 0.88, 0.3, 0.82)], np.float32
)
"""By style: left, right, lower and upper edge of the glass within a bay and storey: punched, ribbons, tall, wide."""
PLINTH, CORNICE = 0.5, 0.4
"""Heights of the darker bands at a wall's foot and top, metres."""


@kernel
def paint(
    camera: int,
    lenses: Lenses,
    drop: Backdrop,
    tiles: Tiles,
    town_level: int,
    pose: Floats,
    light: Floats,
    lamp: Bytes,
    warmth: NDArray[np.int32],
    canvas: Canvas,
    out: Bytes,
) -> None:
    """Colours one camera's picture.

    Args:
        town_level: which of the town's ground levels.
        pose: (4,) the ego's x, y, cosine and sine of heading in the world.
        light: as `raster_dress` says.
        lamp: (H, W) light on the ground, of 255; without pixels where it is the same everywhere.
        warmth: (W,) of 256, how much of the sky's glow is in each column; empty where there is none.
        out: (3, H, W), written.
    """
    height, width = canvas.inverse.shape
    R, pin = lenses.rotation[camera], lenses.pinhole[camera]
    ground, index = canvas.row, tiles.table[town_level]
    eye, step = np.float32(lenses.position[camera, 2]), np.float32(1.0 / pin[0])
    for row in range(height):
        level = drop.level[camera, row]
        y = (row + 0.5 - pin[3]) / pin[1]
        rise = np.float32(R[1, 2] * y + R[2, 2])
        if level >= 0:
            ground_row(camera, lenses, drop.depth[camera, row], y, pose, tiles.origin, tiles.cell, ground)
        faces, first = canvas.face[row], 0
        while first < width:
            face, end = faces[first], first + 1
            while end < width and faces[end] == face:
                end += 1
            red, green, blue = out[0, row, first:end], out[1, row, first:end], out[2, row, first:end]
            if face >= 0:
                if canvas.style[face] == WALL:
                    w = canvas.wall[face]
                    inverse, beam = canvas.inverse[row, first:end], canvas.beam[first:end]
                    if light[BEAM] > 0.0 and w[15] > 0.0 and drop.cone.shape[1] > 0:
                        _light_wall(inverse, drop.cone[camera, row, first:end], w[15] / w[13], beam)
                    x = np.float32((first + 0.5 - pin[2]) / pin[0])
                    ray = w[0] * x + w[1] * np.float32(y) + w[2]
                    _paint_wall(inverse, w, ray, rise, eye, step, light, beam, red, green, blue)
                else:
                    colour = canvas.colour[face]
                    red[:], green[:], blue[:] = colour[0], colour[1], colour[2]
            elif level >= 0:
                colours = drop.ground[camera, row, 1 if face == SHADED else 0]
                _paint_ground(first, level, ground, index, tiles.data, colours, red, green, blue)
                if lamp.shape[0] > 0:
                    _light_ground(lamp[row, first:end], red, green, blue)
            else:
                sky = drop.sky[camera, row]
                red[:], green[:], blue[:] = sky[0], sky[1], sky[2]
                if len(warmth) > 0:
                    _warm(drop.warm[camera, row], warmth[first:end], red, green, blue)
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
def _light_wall(inverse: Singles, cone: Singles, share: np.float32, beam: Singles) -> None:
    """How many times brighter the own beam makes a run of a wall."""
    one, reach = np.float32(1.0), np.float32(BEAM_REACH * BEAM_REACH)
    for column in range(len(inverse)):
        closeness = inverse[column] * inverse[column] * reach
        beam[column] = one + share * cone[column] * closeness / (one + closeness)


@kernel
def _paint_wall(
    inverse: Singles,
    w: Singles,
    ray: np.float32,
    rise: np.float32,
    eye: np.float32,
    step: np.float32,
    light: Floats,
    beam: Singles,
    red: Bytes,
    green: Bytes,
    blue: Bytes,
) -> None:
    """A run of a wall: windows by the building's style, doors, a plinth, a cornice, haze.

    Where pixels are wide against a bay, the windows fade into their mean. `ray` is how far along the wall the first
    pixel's ray runs per metre of depth, `rise` how far it climbs, from the height of the `eye`.
    """
    one, zero, full = np.float32(1.0), np.float32(0.0), np.float32(255.0)
    thickness = np.float32(light[THICKNESS])
    hr, hg, hb = np.float32(light[HAZE]), np.float32(light[HAZE + 1]), np.float32(light[HAZE + 2])
    left, right, low, high = WINDOWS[int(w[8]), 0], WINDOWS[int(w[8]), 1], WINDOWS[int(w[8]), 2], WINDOWS[int(w[8]), 3]
    cornice, own, lit_share = w[6] - np.float32(CORNICE), np.int32(w[9] * np.float32(16.0)), np.int32(light[LIT] * 32.0)
    ray_step, slope = w[0] * step, w[7]
    wr, wg, wb, dim = w[10], w[11], w[12], min(one, w[13])
    foot, bays, storeys = w[3], w[4], w[5]
    for column in range(len(red)):
        z = one / inverse[column]
        along = ray + ray_step * np.float32(column)
        up = eye + z * rise
        u, v = (z * along + foot) * bays, up * storeys
        bay, storey = np.int32(u), np.int32(v)
        fu, fv = u - np.float32(bay), v - np.float32(storey)
        number = bay * np.int32(7) + storey * np.int32(13) + own
        door = (storey < np.int32(1)) & ((bay * np.int32(5) + own) & np.int32(7) == np.int32(3))
        door &= (np.float32(0.3) < fu) & (fu < np.float32(0.7)) & (fv < np.float32(0.72))
        inside = (left < fu) & (fu < right) & (low < fv) & (fv < high)
        band = ((up < np.float32(PLINTH)) & (not door)) | (up > cornice)
        footprint = abs(z * (ray_step - slope * z * along)) * bays
        detail = min(one, max(zero, np.float32(1.3) - np.float32(2.0) * footprint))
        glass = np.float32(0.3) * (one - detail) + (detail if inside | door else zero)
        glass = zero if band else glass
        keep = np.float32(0.82) if band else one - glass
        lit = ((number * np.int32(11)) >> np.int32(1)) & np.int32(31) < lit_share
        tone = np.float32((number & np.int32(3)) * np.int32(9)) * detail
        bright = beam[column]
        glow = glass if (lit & (not door)) else zero
        dark = (glass - glow) * dim * bright
        keep *= bright
        r = min(full, wr * keep + (np.float32(50.0) + tone) * dark + np.float32(250.0) * glow)
        g = min(full, wg * keep + (np.float32(58.0) + tone) * dark + np.float32(206.0) * glow)
        b = min(full, wb * keep + (np.float32(70.0) + tone) * dark + np.float32(132.0) * glow)
        clear = inverse[column] / (inverse[column] + thickness)
        clear *= clear
        clear *= clear
        red[column] = np.int32(hr + (r - hr) * clear)
        green[column] = np.int32(hg + (g - hg) * clear)
        blue[column] = np.int32(hb + (b - hb) * clear)

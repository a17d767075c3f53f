"""From the visibility buffer to the picture: sky, painted ground, walls with windows, haze."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from me3bev_cli.api import Camera, Rig
from me3bev_plugins.simulator.highway.ground_tiles import CODES, MIX_PARTS, OFFSETS, RECORD, Paint, Tiles
from me3bev_plugins.simulator.highway.raster import SHADOW, WALL, Canvas, Lenses

Bytes = NDArray[np.uint8]
Floats = NDArray[np.float64]
Singles = NDArray[np.float32]

SHADES = 8
"""Brightness steps of the ground's grain."""
GRAIN = 128
"""The grain repeats after this many cells."""
HAZE = np.array([196.0, 206.0, 216.0])
ZENITH = np.array([92.0, 138.0, 198.0])
HAZE_DISTANCE = 260.0
"""Distance at which haze hides half of a colour, metres."""
SUN = np.array([0.35, 0.55, 0.76])
"""Direction to the sun in the world frame."""
AMBIENT, DIRECT = 0.62, 0.5
_SHADOW_LIGHT = 140
"""Of 256."""
_PAINT_COLOURS = {
    Paint.GRASS: (92, 122, 62),
    Paint.ASPHALT: (84, 85, 88),
    Paint.SIDEWALK: (158, 154, 148),
    Paint.WHITE: (228, 228, 224),
    Paint.YELLOW: (216, 168, 42),
    Paint.ZEBRA: (226, 226, 222),
    Paint.ZEBRA_GAP: (80, 81, 84),
    Paint.PATH: (136, 122, 92),
    Paint.KERB: (188, 186, 180),
}
_GRAIN_STRENGTH = np.array([0.16, 0.09, 0.07, 0.05, 0.05, 0.06, 0.09, 0.14, 0.05])
WINDOWS = np.array(
    [(0.24, 0.76, 0.28, 0.78), (-1.0, 2.0, 0.36, 0.8), (0.3, 0.7, 0.14, 0.88), (0.12, 0.88, 0.3, 0.82)], np.float32
)
"""By style: left, right, lower and upper edge of the glass within a bay and storey: punched, ribbons, tall, wide."""
PLINTH, CORNICE = 0.5, 0.4
"""Heights of the darker bands at a wall's foot and top, metres."""


class Backdrop(NamedTuple):
    """What depends on the rig only: colours of sky rows and of the ground's codes at each row's distance."""

    sky: Bytes
    """(C, H, 3)"""
    ground: Bytes
    """(C, H, CODES * SHADES, 3)"""
    level: NDArray[np.int64]
    """(C, H) mip level, -1 above the horizon."""
    depth: Floats
    """(C, H) distance along the optical axis of the ground, metres; 0 above the horizon."""
    grain: Bytes
    """(GRAIN, GRAIN) brightness step."""


def backdrop(rig: Rig, cell: float) -> Backdrop:
    """Tables for a rig. Cameras do not roll, so all ground in one row lies at one depth."""
    height, _ = rig.image_size
    count = len(rig.cameras)
    sky = np.zeros((count, height, 3), np.uint8)
    ground = np.zeros((count, height, CODES * SHADES, 3), np.uint8)
    level = np.full((count, height), -1, np.int64)
    depth = np.zeros((count, height))
    codes = code_colours()
    for i, camera in enumerate(rig.cameras):
        down = -_ray_z(camera, np.arange(height, dtype=np.float64) + 0.5)
        up = np.clip(-down / 0.45, 0.0, 1.0)[:, None] ** 0.7
        sky[i] = HAZE + (ZENITH - HAZE) * up
        below = down > 1e-6
        depth[i, below] = camera.position[2] / down[below]
        for row in np.flatnonzero(below):
            z = depth[i, row]
            across, along = z / camera.fx, z * z / (camera.fy * camera.position[2])
            footprint = across**0.7 * along**0.3
            level[i, row] = int(np.clip(np.log2(footprint / cell), 0, len(OFFSETS) - 1))
            share = z / (z + HAZE_DISTANCE)
            ground[i, row] = np.round(codes + (HAZE - codes) * share).clip(0, 255)
    return Backdrop(sky=sky, ground=ground, level=level, depth=depth, grain=_grain())


def _ray_z(camera: Camera, rows: Floats) -> Floats:
    """Upward part of the rays through the given rows (pixels) for unit depth."""
    down, forward = camera.camera_to_ego()[2][1], camera.camera_to_ego()[2][2]
    return down * (rows - camera.cy) / camera.fy + forward


def code_colours() -> Floats:
    """(CODES * SHADES, 3) colour of each ground code at each brightness step, before haze."""
    base = np.array([_PAINT_COLOURS[paint] for paint in Paint], np.float64)
    first, second, share = MIX_PARTS[:, 0], MIX_PARTS[:, 1], MIX_PARTS[:, 2:] / 8
    steps = (np.arange(SHADES) / (SHADES - 1) * 2 - 1)[None, :, None]
    grained = base[:, None] * (1 + steps * _GRAIN_STRENGTH[:, None, None])
    mixed = grained[first] * (1 - share[..., None]) + grained[second] * share[..., None]
    return np.asarray(mixed.reshape(-1, 3))


def _grain() -> Bytes:
    """Brightness steps: fine speckle over soft patches; repeats without a seam."""
    rng = np.random.default_rng(20240607)
    total: Floats = np.zeros((GRAIN, GRAIN))
    for size, weight in ((128, 0.9), (64, 0.6), (32, 0.6), (16, 0.7), (8, 0.6)):
        noise = rng.standard_normal((size, size))
        factor = GRAIN // size
        wide = np.kron(noise, np.ones((factor, factor)))
        for axis in (0, 1):
            wide = np.mean([np.roll(wide, k, axis) for k in range(-(factor // 2), factor - factor // 2)], axis=0)
        total += weight * wide / max(wide.std(), 1e-9)
    rank = np.argsort(np.argsort(total.ravel())).reshape(total.shape) / total.size
    return np.asarray((rank * SHADES).astype(np.uint8))


@njit(cache=True, error_model="numpy")
def paint(
    camera: int,
    lenses: Lenses,
    drop: Backdrop,
    tiles: Tiles,
    town_level: int,
    pose: Floats,
    canvas: Canvas,
    out: Bytes,
) -> None:
    """Colours one camera's picture.

    Args:
        town_level: which of the town's ground levels.
        pose: (4,) the ego's x, y, cosine and sine of heading in the world.
        out: (3, H, W), written.
    """
    height, width = canvas.inverse.shape
    R, pin = lenses.rotation[camera], lenses.pinhole[camera]
    ground = np.empty(4)
    index = tiles.table[town_level]
    for row in range(height):
        level = drop.level[camera, row]
        y = (row + 0.5 - pin[3]) / pin[1]
        rise, eye = np.float32(R[1, 2] * y + R[2, 2]), np.float32(lenses.position[camera, 2])
        step = np.float32(1.0 / pin[0])
        if level >= 0:
            ground_row(camera, lenses, drop.depth[camera, row], y, pose, tiles.origin, tiles.cell, ground)
        faces, first = canvas.face[row], 0
        while first < width:
            face, end = faces[first], first + 1
            while end < width and faces[end] == face:
                end += 1
            red, green, blue = out[0, row, first:end], out[1, row, first:end], out[2, row, first:end]
            inverse = canvas.inverse[row, first:end]
            style = canvas.style[face] if face >= 0 else -1
            if style == WALL:
                x = np.float32((first + 0.5 - pin[2]) / pin[0])
                _paint_wall(
                    inverse, canvas.colour[face], canvas.wall[face], x, np.float32(y), rise, eye, step, red, green, blue
                )
            elif style >= 0 and style != SHADOW:
                _paint_plain(inverse, canvas.colour[face], red, green, blue)
            elif level >= 0:
                colours = drop.ground[camera, row]
                _paint_ground(first, level, ground, index, tiles.data, colours, drop.grain, red, green, blue)
                if style == SHADOW:
                    _darken(red, green, blue)
            else:
                red[:], green[:], blue[:] = drop.sky[camera, row, 0], drop.sky[camera, row, 1], drop.sky[camera, row, 2]
            first = end


@njit(cache=True, error_model="numpy")
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


@njit(cache=True, error_model="numpy")
def _paint_ground(
    first: int,
    level: int,
    ground: Floats,
    index: NDArray[np.int32],
    data: Bytes,
    colours: Bytes,
    grain: Bytes,
    red: Bytes,
    green: Bytes,
    blue: Bytes,
) -> None:
    """A run of ground from column `first` on. Positions step in fixed point."""
    column_step, row_step = np.int64(np.round(ground[2] * 65536)), np.int64(np.round(ground[3] * 65536))
    column_at = np.int64(np.floor(ground[0] * 65536)) + first * column_step
    row_at = np.int64(np.floor(ground[1] * 65536)) + first * row_step
    bottom, right = index.shape[0], index.shape[1]
    offset, line = OFFSETS[level], 5 - level
    for column in range(len(red)):
        r, c = row_at >> 16, column_at >> 16
        ty, tx = r >> 5, c >> 5
        code = np.int64(0)
        if 0 <= ty < bottom and 0 <= tx < right:
            at = ((r & 31) >> level << line) + ((c & 31) >> level)
            code = np.int64(data[np.int64(index[ty, tx]) * RECORD + offset + at])
        shade = code * SHADES + grain[(r >> level) & (GRAIN - 1), (c >> level) & (GRAIN - 1)]
        red[column], green[column], blue[column] = colours[shade, 0], colours[shade, 1], colours[shade, 2]
        column_at += column_step
        row_at += row_step


@njit(cache=True, error_model="numpy")
def _darken(red: Bytes, green: Bytes, blue: Bytes) -> None:
    """A run of ground in shadow."""
    for channel in (red, green, blue):
        for column in range(len(channel)):
            channel[column] = (np.int32(channel[column]) * _SHADOW_LIGHT) >> 8


@njit(cache=True, error_model="numpy")
def _paint_plain(inverse: Singles, colour: Singles, red: Bytes, green: Bytes, blue: Bytes) -> None:
    """A run of a face of one colour, with haze by distance."""
    thickness = np.float32(1.0 / HAZE_DISTANCE)
    hr, hg, hb = np.float32(HAZE[0]), np.float32(HAZE[1]), np.float32(HAZE[2])
    r, g, b = colour[0], colour[1], colour[2]
    for column in range(len(red)):
        haze = thickness / (inverse[column] + thickness)
        red[column] = np.int32(r + (hr - r) * haze)
        green[column] = np.int32(g + (hg - g) * haze)
        blue[column] = np.int32(b + (hb - b) * haze)


@njit(cache=True, error_model="numpy")
def _paint_wall(
    inverse: Singles,
    colour: Singles,
    w: Singles,
    x: np.float32,
    y: np.float32,
    rise: np.float32,
    eye: np.float32,
    step: np.float32,
    red: Bytes,
    green: Bytes,
    blue: Bytes,
) -> None:
    """A run of a wall: windows by the building's style, a plinth, a cornice, haze.

    Where pixels are wide against a bay, the windows fade into their mean. `rise` is how far the row's rays climb
    per metre of depth, from the height of the `eye`.
    """
    thickness, one, zero = np.float32(1.0 / HAZE_DISTANCE), np.float32(1.0), np.float32(0.0)
    hr, hg, hb = np.float32(HAZE[0]), np.float32(HAZE[1]), np.float32(HAZE[2])
    left, right, low, high = WINDOWS[int(w[8]), 0], WINDOWS[int(w[8]), 1], WINDOWS[int(w[8]), 2], WINDOWS[int(w[8]), 3]
    cornice, own = w[6] - np.float32(CORNICE), np.int32(w[9] * np.float32(16.0))
    ray_step, ray_start = w[0] * step, w[0] * x + w[1] * y + w[2]
    wr, wg, wb = colour[0], colour[1], colour[2]
    foot, bays, storeys, slope = w[3], w[4], w[5], w[7]
    for column in range(len(red)):
        z = one / inverse[column]
        ray = ray_start + ray_step * np.float32(column)
        up = eye + z * rise
        u, v = (z * ray + foot) * bays, up * storeys
        bay, storey = np.int32(u), np.int32(v)
        fu, fv = u - np.float32(bay), v - np.float32(storey)
        inside = (left < fu) & (fu < right) & (low < fv) & (fv < high)
        band = (up < np.float32(PLINTH)) | (up > cornice)
        footprint = abs(z * (ray_step - slope * z * ray)) * bays
        detail = min(one, max(zero, np.float32(1.3) - np.float32(2.0) * footprint))
        glass = np.float32(0.3) * (one - detail) + (detail if inside else zero)
        glass = zero if band else glass
        keep = np.float32(0.82) if band else one - glass
        tone = np.float32(((bay * np.int32(7) + storey * np.int32(13) + own) & np.int32(3)) * np.int32(9)) * detail
        haze = thickness * z / (one + thickness * z)
        r = wr * keep + (np.float32(50.0) + tone) * glass
        g = wg * keep + (np.float32(58.0) + tone) * glass
        b = wb * keep + (np.float32(70.0) + tone) * glass
        red[column] = np.int32(r + (hr - r) * haze)
        green[column] = np.int32(g + (hg - g) * haze)
        blue[column] = np.int32(b + (hb - b) * haze)

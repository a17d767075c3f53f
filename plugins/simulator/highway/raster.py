"""Which face is nearest at each pixel: culling, clipping and z-buffered filling of convex polygons.

The image of 1/z of a plane is linear, so a face's depth costs one multiply-add per pixel and is exact. What
comes out is a visibility buffer (1/z and face per pixel), from which colour, depth, classes and instances are
all read (`raster_colour.py`, `raster_truth.py`).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from me3bev_plugins.simulator.highway.geometry import CORNERS, Meshes
from me3bev_plugins.simulator.highway.materials import COLOURS, Role

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Ints = NDArray[np.int64]

NEAR = 0.15
"""Nothing closer to a camera than this is drawn, metres."""
NOMINAL_FOCAL = 251.0
"""Faces' ranges are meant for this focal length, pixels."""

X, Y, COS, SIN, LENGTH, WIDTH, HEIGHT, RED, GREEN, BLUE, SECOND, BASE, RADIUS = range(13)
"""Columns of `Things.number`: pose in the ego frame, size, first colour (0..255), second colour packed as
65536 r + 256 g + b, height of the underside above the ground, bounding radius."""
NUMBERS = 13
SHAPE, SEMANTIC, IDENTITY, STATE = range(4)
"""Columns of `Things.label`: mesh, class, who it is (-1: scenery), and braking (0, 1) or light state."""
LABELS = 4

_ROLE_WALL, _ROLE_SHADOW, _ROLE_TAIL, _ROLE_RED = int(Role.WALL), int(Role.SHADOW), int(Role.TAIL), int(Role.RED)
_ROLE_GREEN, _ROLE_HEADLAMP = int(Role.GREEN), int(Role.HEADLAMP)
STOREY, BAY = 3.3, 3.1
"""Height of a storey and width of a window bay, metres."""
PLAIN, WALL, SHADOW, GLOW = 0, 1, 2, 3
"""How a face is coloured: one colour, windows, darkened ground, unshaded."""


class Things(NamedTuple):
    """What is to be drawn; the first so many rows count."""

    number: Floats
    label: Ints


class Lenses(NamedTuple):
    """The rig's C cameras."""

    rotation: Floats
    """(C, 3, 3) ego frame -> camera frame."""
    position: Floats
    """(C, 3) in the ego frame."""
    pinhole: Floats
    """(C, 4) fx, fy, cx, cy."""


class Canvas(NamedTuple):
    """One camera's visibility buffer and the faces in it."""

    inverse: Singles
    """(H, W) 1/z; 0 where no face is."""
    face: NDArray[np.int32]
    """(H, W) row of the arrays below, or -1."""
    colour: Singles
    """(F, 3) shaded."""
    style: NDArray[np.int32]
    """(F,) PLAIN, WALL, SHADOW or GLOW."""
    owner: NDArray[np.int32]
    """(F,) row of `Things`."""
    wall: Singles
    """(F, 10) of walls: direction along it in the camera frame and offset; window bays per metre along and up;
    height; how 1/z changes per column; style; a number of its own."""


@njit(cache=True, error_model="numpy")
def draw(camera: int, lenses: Lenses, meshes: Meshes, things: Things, count: int, sun: Floats, canvas: Canvas) -> int:
    """Fills the visibility buffer for one camera; returns the number of faces kept.

    Args:
        sun: (5,) direction to the sun in the ego frame, ambient and direct share.
    """
    height, width = canvas.inverse.shape
    canvas.inverse[:] = 0.0
    canvas.face[:] = -1
    R, at, pin = lenses.rotation[camera], lenses.position[camera], lenses.pinhole[camera]
    left, right = pin[2] / pin[0], (width - pin[2]) / pin[0]
    left_norm, right_norm = np.sqrt(1 + left * left), np.sqrt(1 + right * right)
    near_scale = NOMINAL_FOCAL / pin[0]
    local = np.empty((512, 5))
    polygon = np.empty((CORNERS + 4, 2))
    spans = np.empty((height, 2))
    sx = R[0, 0] * sun[0] + R[0, 1] * sun[1] + R[0, 2] * sun[2]
    sy = R[1, 0] * sun[0] + R[1, 1] * sun[1] + R[1, 2] * sun[2]
    sz = R[2, 0] * sun[0] + R[2, 1] * sun[1] + R[2, 2] * sun[2]
    kept = 0
    for i in range(count):
        n = things.number[i]
        dx, dy = n[X] - at[0], n[Y] - at[1]
        dz = n[BASE] + 0.5 * n[HEIGHT] - at[2]
        lateral = R[0, 0] * dx + R[0, 1] * dy
        ahead = R[2, 0] * dx + R[2, 1] * dy + R[2, 2] * dz
        if ahead + n[RADIUS] < NEAR:
            continue
        if lateral - right * ahead > n[RADIUS] * right_norm or -lateral - left * ahead > n[RADIUS] * left_norm:
            continue
        distance = max(0.0, np.sqrt(dx * dx + dy * dy) - n[RADIUS]) * near_scale
        shape = things.label[i, SHAPE]
        first = meshes.vertex_start[shape]
        nearest = _place(meshes.vertex, first, meshes.vertex_start[shape + 1], n, R, at, pin, local)
        for f in range(meshes.face_start[shape], meshes.face_start[shape + 1]):
            if meshes.reach[f] < distance:
                continue
            c = meshes.corner[f]
            a, b, d = local[c[0]], local[c[1]], local[c[2]]
            ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
            vx, vy, vz = d[0] - b[0], d[1] - b[1], d[2] - b[2]
            nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
            offset = nx * a[0] + ny * a[1] + nz * a[2]
            if offset >= 0.0:
                continue
            corners = meshes.corners[f]
            if nearest >= NEAR:
                for k in range(corners):
                    polygon[k, 0], polygon[k, 1] = local[c[k], 3], local[c[k], 4]
            else:
                corners = _clip(local, c, corners, pin, polygon)
            top, bottom = _outline(polygon, corners, spans, width, height)
            if top >= bottom:
                continue
            gx, gy = nx / (offset * pin[0]), ny / (offset * pin[1])
            _fill(canvas, spans, top, bottom, gx, gy, nz / offset - gx * pin[2] - gy * pin[3], kept)
            facing = (nx * sx + ny * sy + nz * sz) / np.sqrt(nx * nx + ny * ny + nz * nz)
            _dress(canvas, kept, i, n, things.label[i], meshes.role[f], sun[3] + sun[4] * max(0.0, facing))
            if canvas.style[kept] == WALL:
                _face_wall(canvas.wall[kept], a, b, n[HEIGHT], gx, things.label[i, STATE], n[RADIUS])
            kept += 1
    return kept


@njit(cache=True, error_model="numpy")
def _face_wall(w: Singles, a: Floats, b: Floats, height: float, slope: float, style: int, own: float) -> None:
    """What is needed to find windows on a wall whose foot runs from `a` to `b` (camera frame)."""
    ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    length = np.sqrt(ux * ux + uy * uy + uz * uz)
    ux, uy, uz = ux / length, uy / length, uz / length
    w[0], w[1], w[2], w[3] = ux, uy, uz, -(ux * a[0] + uy * a[1] + uz * a[2])
    w[4], w[5] = max(1.0, np.floor(length / BAY)) / length, max(1.0, np.floor(height / STOREY)) / height
    w[6], w[7], w[8], w[9] = height, slope, style & 3, own


@njit(cache=True, error_model="numpy")
def _place(vertex: Floats, first: int, end: int, n: Floats, R: Floats, at: Floats, pin: Floats, out: Floats) -> float:
    """A mesh's vertices, stretched, turned and moved into the camera frame, and their pixels; returns the least z."""
    nearest = np.inf
    for k in range(first, end):
        x, y, z = vertex[k, 0] * n[LENGTH], vertex[k, 1] * n[WIDTH], vertex[k, 2] * n[HEIGHT]
        ex = n[X] + n[COS] * x - n[SIN] * y - at[0]
        ey = n[Y] + n[SIN] * x + n[COS] * y - at[1]
        ez = n[BASE] + z - at[2]
        p = out[k - first]
        for r in range(3):
            p[r] = R[r, 0] * ex + R[r, 1] * ey + R[r, 2] * ez
        inverse = 1.0 / p[2]
        p[3], p[4] = pin[0] * p[0] * inverse + pin[2], pin[1] * p[1] * inverse + pin[3]
        nearest = min(nearest, p[2])
    return nearest


@njit(cache=True, error_model="numpy")
def _clip(local: Floats, corner: Ints, count: int, pin: Floats, out: Floats) -> int:
    """The pixels of a face cut at the near plane; returns how many corners remain."""
    kept = 0
    p = local[corner[count - 1]]
    for k in range(count):
        q = local[corner[k]]
        if (p[2] >= NEAR) != (q[2] >= NEAR):
            share = (NEAR - p[2]) / (q[2] - p[2])
            out[kept, 0] = pin[0] * (p[0] + share * (q[0] - p[0])) / NEAR + pin[2]
            out[kept, 1] = pin[1] * (p[1] + share * (q[1] - p[1])) / NEAR + pin[3]
            kept += 1
        if q[2] >= NEAR:
            out[kept, 0], out[kept, 1] = q[3], q[4]
            kept += 1
        p = q
    return kept


@njit(cache=True, error_model="numpy")
def _outline(polygon: Floats, corners: int, spans: Floats, width: int, height: int) -> tuple[int, int]:
    """The columns that a convex polygon of pixels spans at each row's middle; returns the range of rows."""
    low, high, left, right = np.inf, -np.inf, np.inf, -np.inf
    for k in range(corners):
        low, high = min(low, polygon[k, 1]), max(high, polygon[k, 1])
        left, right = min(left, polygon[k, 0]), max(right, polygon[k, 0])
    if right < 0.5 or left > width or high < 0.5 or low > height:
        return 0, 0
    top, bottom = int(max(0.0, np.ceil(low - 0.5))), int(min(float(height), np.ceil(high - 0.5)))
    for row in range(top, bottom):
        spans[row, 0], spans[row, 1] = np.inf, -np.inf
    j = corners - 1
    for k in range(corners):
        x0, y0, x1, y1 = polygon[j, 0], polygon[j, 1], polygon[k, 0], polygon[k, 1]
        j = k
        if y0 > y1:
            x0, y0, x1, y1 = x1, y1, x0, y0
        first, end = int(max(0.0, np.ceil(y0 - 0.5))), int(min(float(height), np.ceil(y1 - 0.5)))
        if first >= end:
            continue
        slope = (x1 - x0) / (y1 - y0)
        for row in range(first, end):
            x = x0 + slope * (row + 0.5 - y0)
            spans[row, 0], spans[row, 1] = min(spans[row, 0], x), max(spans[row, 1], x)
    return top, bottom


@njit(cache=True, error_model="numpy")
def _fill(canvas: Canvas, spans: Floats, top: int, bottom: int, gx: float, gy: float, g0: float, face: int) -> None:
    """Writes 1/z and the face wherever it is nearest. Spans hold columns; a pixel counts when its centre does."""
    width = canvas.inverse.shape[1]
    name = np.int32(face)
    for row in range(top, bottom):
        first = int(max(0.0, np.ceil(spans[row, 0] - 0.5)))
        end = int(min(float(width), np.ceil(spans[row, 1] - 0.5)))
        if end <= first:
            continue
        depth, owner = canvas.inverse[row, first:end], canvas.face[row, first:end]
        start = np.float32(g0 + gy * (row + 0.5) + gx * (first + 0.5))
        step = np.float32(gx)
        for column in range(len(depth)):
            value = start + step * np.float32(column)
            if value > depth[column]:
                depth[column] = value
                owner[column] = name


@njit(cache=True, error_model="numpy")
def _dress(canvas: Canvas, face: int, owner: int, n: Floats, label: Ints, role: int, light: float) -> None:
    """Colour and style of a face from its role and its owner's state."""
    canvas.owner[face] = owner
    style = PLAIN
    r, g, b = COLOURS[role, 0], COLOURS[role, 1], COLOURS[role, 2]
    if role == 0 or role == _ROLE_WALL:
        r, g, b = n[RED], n[GREEN], n[BLUE]
        style = WALL if role == _ROLE_WALL else PLAIN
    elif role == 1:
        packed = int(n[SECOND])
        r, g, b = float(packed >> 16), float((packed >> 8) & 255), float(packed & 255)
    elif role == _ROLE_SHADOW:
        style = SHADOW
    elif role == _ROLE_TAIL:
        if label[STATE] == 1:
            r, g, b, style = 255.0, 46.0, 36.0, GLOW
    elif _ROLE_RED <= role <= _ROLE_GREEN:
        if label[STATE] == role - _ROLE_RED + 1:
            style = GLOW
        else:
            r, g, b = 0.16 * r + 10, 0.16 * g + 10, 0.16 * b + 10
    elif role == _ROLE_HEADLAMP:
        style = GLOW
    shade = 1.0 if style == GLOW else light
    canvas.style[face] = style
    canvas.colour[face, 0] = min(255.0, r * shade)
    canvas.colour[face, 1] = min(255.0, g * shade)
    canvas.colour[face, 2] = min(255.0, b * shade)

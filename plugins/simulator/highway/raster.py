"""Which face is nearest at each pixel: culling, clipping and z-buffered filling of convex polygons.

The image of 1/z of a plane is linear, so a face's depth costs one multiply-add per pixel and is exact. What
comes out is a visibility buffer (1/z and face per pixel), from which colour, depth, classes and instances are
all read (`raster_colour.py`, `raster_truth.py`). Things are drawn from near to far, so that what is hidden is
found out before its vertices are turned.
"""

from __future__ import annotations

import numpy as np

from me3bev_plugins.simulator.highway.compiled import kernel
from me3bev_plugins.simulator.highway.geometry import Meshes
from me3bev_plugins.simulator.highway.raster_buffers import (
    BARE,
    BASE,
    BLUE,
    COS,
    GREEN,
    HEIGHT,
    IDENTITY,
    LABELS,
    LENGTH,
    NUMBERS,
    RADIUS,
    RED,
    SECOND,
    SEMANTIC,
    SHADED,
    SHAPE,
    SIN,
    STATE,
    WIDTH,
    Canvas,
    Floats,
    Lenses,
    Singles,
    Things,
    X,
    Y,
)
from me3bev_plugins.simulator.highway.raster_dress import dress
from me3bev_plugins.simulator.highway.raster_outline import NEAR, clip, outline

__all__ = [
    "BARE",
    "BASE",
    "BLUE",
    "COS",
    "GREEN",
    "HEIGHT",
    "IDENTITY",
    "LABELS",
    "LENGTH",
    "NUMBERS",
    "RADIUS",
    "RED",
    "SECOND",
    "SEMANTIC",
    "SHADED",
    "SHAPE",
    "SIN",
    "STATE",
    "WIDTH",
    "Canvas",
    "Lenses",
    "Things",
    "X",
    "Y",
    "draw",
    "sort_things",
]

NOMINAL_FOCAL = 251.0
"""Faces' ranges are meant for this focal length, pixels."""
PLAIN_FAR = 60.0
"""Beyond this the plainer mesh of a shape is drawn, metres at the nominal focal length."""


@kernel
def sort_things(things: Things, count: int) -> None:
    """Fills `order`: from near to far by the nearest point of the bounding sphere."""
    key, order = things.key, things.order
    for i in range(count):
        n = things.number[i]
        key[i] = np.sqrt(n[X] * n[X] + n[Y] * n[Y]) - n[RADIUS]
        order[i] = i
    gap = 1
    while gap < count // 3:
        gap = 3 * gap + 1
    while gap > 0:
        for i in range(gap, count):
            row, j = order[i], i
            while j >= gap and key[order[j - gap]] > key[row]:
                order[j] = order[j - gap]
                j -= gap
            order[j] = row
        gap //= 3


@kernel
def draw(camera: int, lenses: Lenses, meshes: Meshes, things: Things, count: int, light: Floats, canvas: Canvas) -> int:
    """Fills the visibility buffer for one camera; returns the number of faces kept.

    Args:
        light: as `raster_dress` says.
    """
    _, width = canvas.inverse.shape
    canvas.inverse[:] = 0.0
    canvas.face[:] = BARE
    R, at, pin = lenses.rotation[camera], lenses.position[camera], lenses.pinhole[camera]
    left, right = pin[2] / pin[0], (width - pin[2]) / pin[0]
    left_norm, right_norm = np.sqrt(1 + left * left), np.sqrt(1 + right * right)
    near_scale = NOMINAL_FOCAL / pin[0]
    kept = 0
    for k in range(count):
        i = things.order[k]
        n = things.number[i]
        dx, dy = n[X] - at[0], n[Y] - at[1]
        dz = n[BASE] + 0.5 * n[HEIGHT] - at[2]
        lateral = R[0, 0] * dx + R[0, 1] * dy + R[0, 2] * dz
        ahead = R[2, 0] * dx + R[2, 1] * dy + R[2, 2] * dz
        radius = n[RADIUS]
        if ahead + radius < NEAR:
            continue
        if lateral - right * ahead > radius * right_norm or -lateral - left * ahead > radius * left_norm:
            continue
        down = R[1, 0] * dx + R[1, 1] * dy + R[1, 2] * dz
        tall = 0.5 * abs(R[1, 2]) * n[HEIGHT] + (abs(R[1, 0]) + abs(R[1, 1])) * radius
        if ahead - radius > NEAR and _covered(canvas.inverse, lateral, down, ahead, radius, tall, pin):
            continue
        distance = max(0.0, np.sqrt(dx * dx + dy * dy) - radius) * near_scale
        shape = things.label[i, SHAPE]
        if distance > PLAIN_FAR:
            shape = meshes.plainer[shape]
        kept = _draw_thing(i, shape, distance, R, at, pin, meshes, things, light, canvas, kept)
    return kept


@kernel
def _covered(
    inverse: Singles, lateral: float, down: float, ahead: float, radius: float, tall: float, pin: Floats
) -> bool:
    """Whether everything that a bounding cylinder could cover is already covered by nearer faces."""
    height, width = inverse.shape
    near, far = 1.0 / (ahead - radius), 1.0 / (ahead + radius)
    low, high = lateral - radius, lateral + radius
    up, deep = down - tall, down + tall
    first = int(max(0.0, pin[0] * low * (near if low < 0 else far) + pin[2] - 0.5))
    end = int(min(float(width), pin[0] * high * (far if high < 0 else near) + pin[2] + 1.5))
    top = int(max(0.0, pin[1] * up * (near if up < 0 else far) + pin[3] - 0.5))
    bottom = int(min(float(height), pin[1] * deep * (far if deep < 0 else near) + pin[3] + 1.5))
    nearest = np.float32(near)
    for row in range(top, bottom):
        line = inverse[row, first:end] if end > first else inverse[row, 0:0]
        for column in range(len(line)):
            if line[column] < nearest:
                return False
    return True


@kernel
def _draw_thing(
    i: int,
    shape: int,
    distance: float,
    R: Floats,
    at: Floats,
    pin: Floats,
    meshes: Meshes,
    things: Things,
    light: Floats,
    canvas: Canvas,
    kept: int,
) -> int:
    """Draws the faces of one thing; returns how many faces are kept now."""
    height, width = canvas.inverse.shape
    n, local, polygon, spans = things.number[i], canvas.local, canvas.polygon, canvas.spans
    cos, sin, along, across, tall = n[COS], n[SIN], 1.0 / n[LENGTH], 1.0 / n[WIDTH], 1.0 / n[HEIGHT]
    dx, dy = at[0] - n[X], at[1] - n[Y]
    px, py, pz = (cos * dx + sin * dy) * along, (cos * dy - sin * dx) * across, (at[2] - n[BASE]) * tall
    nearest = np.inf
    for f in range(meshes.face_start[shape], meshes.face_start[shape + 1]):
        plane = meshes.plane[f]
        offset = plane[0] * px + plane[1] * py + plane[2] * pz - plane[3]
        if offset <= 1e-9 or meshes.reach[f] < distance:
            continue
        if nearest == np.inf:
            nearest = _place(
                meshes.vertex, meshes.vertex_start[shape], meshes.vertex_start[shape + 1], n, R, at, pin, local
            )
        c, corners = meshes.corner[f], meshes.corners[f]
        if nearest >= NEAR:
            for k in range(corners):
                polygon[k, 0], polygon[k, 1] = local[c[k], 3], local[c[k], 4]
        else:
            corners = clip(local, c, corners, pin, polygon)
        top, bottom = outline(polygon, corners, spans, width, height)
        if top >= bottom:
            continue
        hx, hy, ez = plane[0] * along, plane[1] * across, plane[2] * tall
        ex, ey = cos * hx - sin * hy, sin * hx + cos * hy
        gx = -(R[0, 0] * ex + R[0, 1] * ey + R[0, 2] * ez) / (offset * pin[0])
        gy = -(R[1, 0] * ex + R[1, 1] * ey + R[1, 2] * ez) / (offset * pin[1])
        gz = -(R[2, 0] * ex + R[2, 1] * ey + R[2, 2] * ez) / offset
        start = gz - gx * pin[2] - gy * pin[3]
        if not _fill(canvas, spans, top, bottom, gx, gy, start, kept):
            continue
        canvas.owner[kept] = i
        norm = 1.0 / np.sqrt(ex * ex + ey * ey + ez * ez)
        normal = (ex * norm, ey * norm, ez * norm)
        dress(kept, f, n, things.label[i], *normal, local, gx, gy, start, corners, R, meshes, light, canvas)
        kept += 1
    return kept


@kernel
def _place(vertex: Floats, first: int, end: int, n: Floats, R: Floats, at: Floats, pin: Floats, out: Floats) -> float:
    """A mesh's vertices, stretched, turned and moved into the camera frame, and their pixels; returns the least z."""
    cos, sin = n[COS], n[SIN]
    dx, dy, dz = n[X] - at[0], n[Y] - at[1], n[BASE] - at[2]
    nearest = np.inf
    for k in range(first, end):
        x, y, z = vertex[k, 0] * n[LENGTH], vertex[k, 1] * n[WIDTH], vertex[k, 2] * n[HEIGHT]
        ex, ey, ez = dx + cos * x - sin * y, dy + sin * x + cos * y, dz + z
        p = out[k - first]
        p[0] = R[0, 0] * ex + R[0, 1] * ey + R[0, 2] * ez
        p[1] = R[1, 0] * ex + R[1, 1] * ey + R[1, 2] * ez
        p[2] = R[2, 0] * ex + R[2, 1] * ey + R[2, 2] * ez
        inverse = 1.0 / p[2]
        p[3], p[4] = pin[0] * p[0] * inverse + pin[2], pin[1] * p[1] * inverse + pin[3]
        nearest = min(nearest, p[2])
    return nearest


@kernel
def _fill(canvas: Canvas, spans: Floats, top: int, bottom: int, gx: float, gy: float, g0: float, face: int) -> bool:
    """Writes 1/z and the face wherever it is nearest; whether it is anywhere. A pixel counts when its centre does."""
    width = canvas.inverse.shape[1]
    name, step = np.int32(face), np.float32(gx)
    any_nearer = False
    for row in range(top, bottom):
        first = int(max(0.0, np.ceil(spans[row, 0] - 0.5)))
        end = int(min(float(width), np.ceil(spans[row, 1] - 0.5)))
        if end <= first:
            continue
        depth, owner = canvas.inverse[row, first:end], canvas.face[row, first:end]
        start = np.float32(g0 + gy * (row + 0.5) + gx * (first + 0.5))
        nearer = np.int32(0)
        for column in range(len(depth)):
            value = start + step * np.float32(column)
            if value > depth[column]:
                depth[column] = value
                owner[column] = name
                nearer |= np.int32(1)
        any_nearer |= nearer != 0
    return any_nearer

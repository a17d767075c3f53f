"""Shadows on the ground: each thing's outline, moved away from the sun, marked where the ground is seen."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from me3bev_plugins.simulator.highway.compiled import kernel
from me3bev_plugins.simulator.highway.geometry import SHADOWS
from me3bev_plugins.simulator.highway.raster_buffers import (
    BARE,
    BASE,
    COS,
    HEIGHT,
    IDENTITY,
    LENGTH,
    RADIUS,
    SHADED,
    SHAPE,
    SIN,
    WIDTH,
    Canvas,
    Floats,
    Ints,
    Lenses,
    Things,
    X,
    Y,
)
from me3bev_plugins.simulator.highway.raster_outline import NEAR, clip, outline

REACH = 75.0
"""Things farther than this cast none, metres."""
FARTHEST = 40.0
"""Length of the longest shadow, metres."""
CORNERS = 8


class Shadows(NamedTuple):
    """Outlines on the ground in the ego frame; the first so many count."""

    points: Floats
    """(N, CORNERS, 2)"""
    corners: Ints
    """(N,)"""
    room: Floats
    """(2 * CORNERS, 5) to work in."""
    order: Ints
    """(CORNERS,) 0, 1, 2 ..."""


def make_shadows(count: int) -> Shadows:
    """Room for so many."""
    return Shadows(
        points=np.zeros((count, CORNERS, 2)),
        corners=np.zeros(count, np.int64),
        room=np.zeros((2 * CORNERS, 5)),
        order=np.arange(CORNERS, dtype=np.int64),
    )


@kernel
def cast(things: Things, count: int, sun: Floats, slanted: bool, shadows: Shadows) -> int:
    """Fills `shadows`; returns how many.

    Args:
        sun: (3,) direction to the sun in the ego frame.
        slanted: whether they fall to the side; else they lie under what moves.
    """
    made = 0
    east, north = -sun[0] / sun[2], -sun[1] / sun[2]
    for i in range(count):
        n = things.number[i]
        kind = SHADOWS[things.label[i, SHAPE]]
        if kind[0] == 0.0 or n[X] * n[X] + n[Y] * n[Y] > (REACH + n[RADIUS]) ** 2:
            continue
        if not slanted and things.label[i, IDENTITY] < 0:
            continue
        low, high = n[BASE] + kind[3] * n[HEIGHT], n[BASE] + kind[6] * n[HEIGHT]
        if not slanted:
            low, high = 0.0, 0.0
        length = max(1e-9, high * np.sqrt(east * east + north * north))
        if length > FARTHEST:
            low, high = low * FARTHEST / length, high * FARTHEST / length
        k = 0
        for sx in (-0.5, 0.5):
            for sy in (-0.5, 0.5):
                for top in range(2):
                    lx, ly = sx * kind[1 + 3 * top] * n[LENGTH], sy * kind[2 + 3 * top] * n[WIDTH]
                    z = high if top else low
                    shadows.room[k, 0] = n[X] + n[COS] * lx - n[SIN] * ly + east * z
                    shadows.room[k, 1] = n[Y] + n[SIN] * lx + n[COS] * ly + north * z
                    k += 1
        shadows.corners[made] = _wrap(shadows.room, shadows.points[made])
        made += 1
    return made


@kernel
def _wrap(points: Floats, out: Floats) -> int:
    """The convex outline of eight points; returns its corners."""
    start = 0
    for k in range(1, CORNERS):
        if points[k, 0] < points[start, 0] or (points[k, 0] == points[start, 0] and points[k, 1] < points[start, 1]):
            start = k
    at, count = start, 0
    while count < CORNERS:
        out[count, 0], out[count, 1] = points[at, 0], points[at, 1]
        count += 1
        following = (at + 1) % CORNERS
        for k in range(CORNERS):
            ax, ay = points[following, 0] - points[at, 0], points[following, 1] - points[at, 1]
            bx, by = points[k, 0] - points[at, 0], points[k, 1] - points[at, 1]
            cross = ax * by - ay * bx
            if cross < -1e-9 or (abs(cross) <= 1e-9 and bx * bx + by * by > ax * ax + ay * ay):
                following = k
        at = following
        if at == start:
            break
    return count


@kernel
def shade(camera: int, lenses: Lenses, shadows: Shadows, count: int, canvas: Canvas) -> None:
    """Marks bare pixels that are in a shadow."""
    height, width = canvas.inverse.shape
    R, at, pin = lenses.rotation[camera], lenses.position[camera], lenses.pinhole[camera]
    shaded, bare = np.int32(SHADED), np.int32(BARE)
    local, polygon = shadows.room, canvas.polygon
    for i in range(count):
        corners, nearest, farthest = shadows.corners[i], np.inf, -np.inf
        for k in range(corners):
            dx, dy, dz = shadows.points[i, k, 0] - at[0], shadows.points[i, k, 1] - at[1], -at[2]
            p = local[k]
            p[0] = R[0, 0] * dx + R[0, 1] * dy + R[0, 2] * dz
            p[1] = R[1, 0] * dx + R[1, 1] * dy + R[1, 2] * dz
            p[2] = R[2, 0] * dx + R[2, 1] * dy + R[2, 2] * dz
            nearest, farthest = min(nearest, p[2]), max(farthest, p[2])
            p[3], p[4] = pin[0] * p[0] / p[2] + pin[2], pin[1] * p[1] / p[2] + pin[3]
        if farthest < NEAR:
            continue
        if nearest < NEAR:
            corners = clip(local, shadows.order, corners, pin, polygon)
        else:
            for k in range(corners):
                polygon[k, 0], polygon[k, 1] = local[k, 3], local[k, 4]
        top, bottom = outline(polygon, corners, canvas.spans, width, height)
        for row in range(top, bottom):
            first = int(max(0.0, np.ceil(canvas.spans[row, 0] - 0.5)))
            end = int(min(float(width), np.ceil(canvas.spans[row, 1] - 0.5)))
            if end <= first:
                continue
            face = canvas.face[row, first:end]
            for column in range(len(face)):
                if face[column] == bare:
                    face[column] = shaded

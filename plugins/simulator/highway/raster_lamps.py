"""Lamps that are lit: what they light on the ground, how they glare in the picture and shine on wet asphalt."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from me3bev_plugins.simulator.highway.compiled import kernel
from me3bev_plugins.simulator.highway.geometry import Shape
from me3bev_plugins.simulator.highway.geometry_scenery import LAMP_HEAD
from me3bev_plugins.simulator.highway.raster_buffers import (
    BASE,
    COS,
    HEIGHT,
    LENGTH,
    SHAPE,
    SIN,
    STATE,
    WIDTH,
    Canvas,
    Floats,
    Lenses,
    Things,
    X,
    Y,
)

Bytes = NDArray[np.uint8]

LAMP_NUMBERS = 11
"""Of a lamp: 0-2 place in the ego frame, 3-5 colour, 6 size in metres, 7-8 the way it shines (0, 0: all around),
9 radius of what it lights on the ground, 10 how much, of 255."""
REACH = 120.0
"""Lamps farther than this do not glare, metres."""
POOL_REACH = 60.0
_NONE, _PAIR, _SINGLE, _STREET, _SIGNAL = range(5)
_KINDS = {
    Shape.CAR: (_PAIR, 0.36, 0.44, 0.46),
    Shape.HATCHBACK: (_PAIR, 0.36, 0.45, 0.47),
    Shape.SUV: (_PAIR, 0.36, 0.48, 0.5),
    Shape.VAN: (_PAIR, 0.36, 0.35, 0.38),
    Shape.TRUCK: (_PAIR, 0.36, 0.22, 0.25),
    Shape.MOTORCYCLE: (_SINGLE, 0.0, 0.52, 0.46),
    Shape.LAMP: (_STREET, 0.0, 0.0, 0.0),
    Shape.SIGNAL: (_SIGNAL, 0.0, 0.0, 0.0),
}
_AT = np.array([_KINDS.get(shape, (0.0,) * 4) for shape in Shape], np.float64)
"""By shape: kind, share of the width from the middle, heights of head and tail lamps."""
_SIGNALS = np.array(
    [(0, 0, 0, 0), (0.82, 255, 40, 30), (0.5, 255, 180, 30), (0.18, 50, 245, 110), (0, 0, 0, 0)], np.float64
)
"""By state: height in the head, colour."""
_HEAD_X, _HEAD_Z = LAMP_HEAD


@kernel
def collect_lamps(things: Things, count: int, night: bool, lamps: Floats) -> int:
    """Fills `lamps` (L, LAMP_NUMBERS) from near to far with those that are lit; returns how many."""
    made = 0
    for k in range(count):
        i = things.order[k]
        n, state = things.number[i], things.label[i, STATE]
        kind = _AT[things.label[i, SHAPE]]
        if kind[0] == _NONE or n[X] * n[X] + n[Y] * n[Y] > REACH * REACH:
            continue
        if made + 4 > len(lamps):
            break
        if kind[0] == _STREET:
            _set(lamps[made], n, _HEAD_X, 0.0, _HEAD_Z, 255.0, 212.0, 150.0, 0.5, 0.0)
            lamps[made, 9], lamps[made, 10] = 9.5, 135.0 if night else 0.0
            made += 1
        elif kind[0] == _SIGNAL:
            lamp = _SIGNALS[min(4, max(0, state))]
            if lamp[0] > 0.0:
                _set(lamps[made], n, -0.4, 0.0, lamp[0], lamp[1], lamp[2], lamp[3], 0.34, -1.0)
                made += 1
        else:
            for side in range(2 if kind[0] == _PAIR else 1):
                across = kind[1] * (1.0 if side else -1.0)
                _set(lamps[made], n, 0.51, across, kind[2], 255.0, 244.0, 216.0, 0.3, 1.0)
                if side == 0 and night:
                    lamps[made, 9], lamps[made, 10] = 5.5, 70.0
                _set(lamps[made + 1], n, -0.51, across, kind[3], 255.0, 30.0, 22.0, 0.34 if state == 1 else 0.18, -1.0)
                made += 2
    return made


@kernel
def _set(
    lamp: Floats, n: Floats, x: float, y: float, z: float, r: float, g: float, b: float, size: float, way: float
) -> None:
    """One lamp at a place in a thing's unit box that shines ahead (1), back (-1) or all around (0)."""
    along, across = x * n[LENGTH], y * n[WIDTH]
    lamp[0] = n[X] + n[COS] * along - n[SIN] * across
    lamp[1] = n[Y] + n[SIN] * along + n[COS] * across
    lamp[2] = n[BASE] + z * n[HEIGHT]
    lamp[3], lamp[4], lamp[5], lamp[6] = r, g, b, size
    lamp[7], lamp[8] = way * n[COS], way * n[SIN]
    lamp[9], lamp[10] = 0.0, 0.0


@kernel
def light_pools(camera: int, lenses: Lenses, depth: Floats, lamps: Floats, count: int, canvas: Canvas) -> None:
    """Adds what lamps light on the ground to `canvas.lamp`."""
    height, width = canvas.inverse.shape
    R, at, pin = lenses.rotation[camera], lenses.position[camera], lenses.pinhole[camera]
    for k in range(count):
        lamp = lamps[k]
        if lamp[10] <= 0.0 or lamp[0] * lamp[0] + lamp[1] * lamp[1] > POOL_REACH * POOL_REACH:
            continue
        radius = lamp[9]
        x, y = lamp[0] + 0.9 * radius * lamp[7] - at[0], lamp[1] + 0.9 * radius * lamp[8] - at[1]
        ahead = R[2, 0] * x + R[2, 1] * y - R[2, 2] * at[2]
        if ahead + radius < 0.0 or abs(R[0, 0] * x + R[0, 1] * y) > 1.2 * max(0.0, ahead) + 2.0 * radius:
            continue
        for row in range(height):
            z = depth[row]
            if z <= 0.0 or abs(z - ahead) > radius:
                continue
            down = (row + 0.5 - pin[3]) / pin[1]
            side = (0.5 - pin[2]) / pin[0]
            ax = z * (R[0, 0] * side + R[1, 0] * down + R[2, 0]) - x
            ay = z * (R[0, 1] * side + R[1, 1] * down + R[2, 1]) - y
            sx, sy = z * R[0, 0] / pin[0], z * R[0, 1] / pin[0]
            square = sx * sx + sy * sy
            nearest = -(ax * sx + ay * sy) / square
            least = ax * ax + ay * ay - nearest * nearest * square
            if least >= radius * radius:
                continue
            reach = np.sqrt((radius * radius - least) / square)
            first, end = int(max(0.0, np.ceil(nearest - reach))), int(min(float(width), np.floor(nearest + reach) + 1))
            if end <= first:
                continue
            line = canvas.lamp[row, first:end]
            scale, middle = np.float32(square / (radius * radius)), np.float32(nearest - first)
            rest, much = np.float32(1.0 - least / (radius * radius)), np.float32(lamp[10])
            for column in range(len(line)):
                d = np.float32(column) - middle
                t = max(np.float32(0.0), rest - scale * d * d)
                line[column] = min(np.int32(255), np.int32(line[column]) + np.int32(much * t * t))


@kernel
def glare(
    camera: int, lenses: Lenses, lamps: Floats, count: int, strength: float, wetness: float, canvas: Canvas, out: Bytes
) -> None:
    """Adds the glare of lamps that are in sight, and their long reflections on wet ground."""
    height, width = canvas.inverse.shape
    R, at, pin = lenses.rotation[camera], lenses.position[camera], lenses.pinhole[camera]
    for k in range(count):
        lamp = lamps[k]
        dx, dy, dz = lamp[0] - at[0], lamp[1] - at[1], lamp[2] - at[2]
        z = R[2, 0] * dx + R[2, 1] * dy + R[2, 2] * dz
        if z < 0.6:
            continue
        facing = 1.0
        if lamp[7] != 0.0 or lamp[8] != 0.0:
            facing = -(lamp[7] * dx + lamp[8] * dy) / np.sqrt(dx * dx + dy * dy)
            if facing <= 0.05:
                continue
        u = pin[0] * (R[0, 0] * dx + R[0, 1] * dy + R[0, 2] * dz) / z + pin[2]
        v = pin[1] * (R[1, 0] * dx + R[1, 1] * dy + R[1, 2] * dz) / z + pin[3]
        row, column = int(np.floor(v)), int(np.floor(u))
        if row < 0 or row >= height or column < 0 or column >= width:
            continue
        if canvas.inverse[row, column] * (z - 0.6) > 1.0:
            continue
        radius = min(0.09 * pin[0], max(0.006 * pin[0], 2.4 * pin[0] * lamp[6] / z))
        much = strength * (0.35 + 0.65 * facing)
        _splash(out, canvas, u, v, radius, radius, much, lamp, False)
        if wetness > 0.0:
            mirror = -lamp[2] - at[2]
            foot = pin[1] * (R[1, 0] * dx + R[1, 1] * dy + R[1, 2] * mirror) / z + pin[3]
            _splash(out, canvas, u, foot, 0.6 * radius, 4.0 * radius, 0.7 * wetness * much, lamp, True)


@kernel
def _splash(
    out: Bytes, canvas: Canvas, u: float, v: float, wide: float, tall: float, much: float, lamp: Floats, ground: bool
) -> None:
    """Adds a soft ellipse of light, on the ground only or on everything."""
    height, width = canvas.inverse.shape
    top, bottom = int(max(0.0, np.ceil(v - tall - 0.5))), int(min(float(height), np.floor(v + tall + 0.5)))
    left, right = int(max(0.0, np.ceil(u - wide - 0.5))), int(min(float(width), np.floor(u + wide + 0.5)))
    for row in range(top, bottom):
        down = (row + 0.5 - v) / tall
        for column in range(left, right):
            side = (column + 0.5 - u) / wide
            t = 1.0 - side * side - down * down
            if t <= 0.0 or (ground and canvas.face[row, column] >= 0):
                continue
            add = much * t * t
            for channel in range(3):
                out[channel, row, column] = int(min(255.0, out[channel, row, column] + add * lamp[3 + channel]))


@kernel
def streak(camera: int, seed: int, amount: int, out: Bytes) -> None:
    """Draws falling rain, the same for the same seed."""
    height, width = out.shape[1], out.shape[2]
    state = np.uint64(seed) * np.uint64(6364136223846793005) + np.uint64(1442695040888963407 + 2 * camera)
    for _ in range(amount):
        state = state * np.uint64(6364136223846793005) + np.uint64(1442695040888963407)
        bits = state >> np.uint64(20)
        column, row = (
            int(bits & np.uint64(0xFFF)) * width >> 12,
            int(bits >> np.uint64(12) & np.uint64(0xFFF)) * height >> 12,
        )
        length = 4 + (int(bits >> np.uint64(24) & np.uint64(0xFF)) * height >> 11)
        weight = 30 + int(bits >> np.uint64(32) & np.uint64(0x1F))
        slant = int(bits >> np.uint64(40) & np.uint64(7)) - 2
        for k in range(length):
            r, c = row + k, column + (k * slant >> 4)
            if r >= height or c < 0 or c >= width:
                break
            for channel in range(3):
                old = int(out[channel, r, c])
                out[channel, r, c] = old + ((208 - old) * weight >> 8)

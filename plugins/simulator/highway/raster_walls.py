"""Walls: windows, doors, plinth and cornice, by the building's style.

A level camera sees each upright wall at one depth per column, so all that does not change up the wall is worked out
once per column and face, into a strip: the colours that a pixel can have there. A pixel only picks one.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from me3bev_plugins.simulator.highway.compiled import kernel
from me3bev_plugins.simulator.highway.raster_buffers import Canvas, Floats, Singles
from me3bev_plugins.simulator.highway.raster_dress import HAZE, LIT, THICKNESS

Whole = NDArray[np.int32]

WINDOWS = np.array(
    [(0.5, 0.26, 0.53, 0.25), (0.5, 1.5, 0.58, 0.22), (0.5, 0.2, 0.51, 0.37), (0.5, 0.38, 0.56, 0.26)], np.float32
)
"""By style, of the glass within a bay and storey: its middle and half its width, across then up: punched, ribbons,
tall, wide."""
PLINTH, CORNICE = 0.5, 0.4
"""Heights of the darker bands at a wall's foot and top, metres."""
DOOR = 0.72
"""Height of doors, storeys."""
_WALL, _BAND, _GLASS, _GLINT, _LIT, _NUMBER = range(6)
"""Rows of a strip: colours, and a number of the bay from which its windows differ."""


@kernel
def strip_of(face: int, row: int, y: float, R: Floats, pin: Floats, light: Floats, canvas: Canvas) -> int:
    """The place of a face's strip, which is worked out if it is not there or holds for one row only."""
    level = R[2, 2] == 0.0
    slot, used = canvas.slot[face], canvas.strips[0]
    if level and slot < used and canvas.strip_face[slot] == face:
        return slot
    slot = min(used, len(canvas.strip_face) - 1)
    if level and used < len(canvas.strip_face) - 1:
        canvas.strips[0] = used + 1
        canvas.strip_face[slot] = face
        canvas.slot[face] = slot
    _fill_strip(canvas.wall[face], row, y, pin, light, canvas.strip[slot], canvas.strip_depth[slot])
    return slot


@kernel
def _fill_strip(w: Singles, row: int, y: float, pin: Floats, light: Floats, strip: Whole, depth: Singles) -> None:
    """Works out the columns of a wall. Where pixels are wide against a bay, the windows fade into their mean."""
    one, zero = np.float32(1.0), np.float32(0.0)
    thickness, step = np.float32(light[THICKNESS]), np.float32(1.0 / pin[0])
    middle, wide = WINDOWS[int(w[8]), 0], WINDOWS[int(w[8]), 1]
    own, dim = np.int32(w[9] * np.float32(16.0)), min(one, w[13])
    ray, foot, bays = w[1] * np.float32(y) + w[2], w[3], w[4]
    for column in range(int(w[18]), int(w[19])):
        inverse = w[16] + w[17] * np.float32(row + 0.5) + w[7] * np.float32(column + 0.5)
        z = one / max(np.float32(1e-4), inverse)
        along = ray + w[0] * np.float32((column + 0.5 - pin[2]) / pin[0])
        u = (z * along + foot) * bays
        bay = np.int32(np.floor(u))
        fu = u - np.float32(bay)
        footprint = abs(z * (w[0] * step - w[7] * z * along)) * bays
        detail = min(one, max(zero, np.float32(1.3) - np.float32(2.0) * footprint))
        clear = one / (one + thickness * z)
        clear *= clear
        clear *= clear
        mean = np.float32(0.3) * (one - detail)
        glass = mean + (detail if abs(fu - middle) < wide else zero)
        strip[_WALL, column] = _mix(w, one - mean, mean * dim, zero, zero, clear, light)
        strip[_BAND, column] = _mix(w, np.float32(0.82), zero, zero, zero, clear, light)
        strip[_GLASS, column] = _mix(w, one - glass, glass * dim, zero, zero, clear, light)
        strip[_GLINT, column] = _mix(w, one - glass, glass * dim, np.float32(22.0) * detail, zero, clear, light)
        strip[_LIT, column] = _mix(w, one - glass, zero, zero, glass, clear, light)
        strip[_NUMBER, column] = np.int32(bay * 7) + own
        depth[column] = z
        if ((bay * 5 + own) & 7) == 3 and abs(fu - np.float32(0.5)) < np.float32(0.2):
            strip[_NUMBER, column] |= np.int32(1 << 20)


@kernel
def _mix(
    w: Singles,
    wall: np.float32,
    dark: np.float32,
    tone: np.float32,
    glow: np.float32,
    clear: np.float32,
    light: Floats,
) -> int:
    """Shares of wall, of dark glass (brighter by `tone`) and of lit glass, in haze, as one number."""
    r = min(255.0, w[10] * wall + (50.0 + tone) * dark + 250.0 * glow)
    g = min(255.0, w[11] * wall + (58.0 + tone) * dark + 206.0 * glow)
    b = min(255.0, w[12] * wall + (70.0 + tone) * dark + 132.0 * glow)
    red = int(light[HAZE] + (r - light[HAZE]) * clear)
    green = int(light[HAZE + 1] + (g - light[HAZE + 1]) * clear)
    blue = int(light[HAZE + 2] + (b - light[HAZE + 2]) * clear)
    return red | green << 8 | blue << 16


@kernel
def wall_run(
    strip: Whole,
    depth: Singles,
    w: Singles,
    rise: np.float32,
    eye: np.float32,
    light: Floats,
    first: int,
    end: int,
    packed: Whole,
) -> None:
    """Colours of a run of a wall, r + 256 g + 65536 b.

    Args:
        rise: how far the row's rays climb per metre of depth, from the height of the `eye`.
        end: rounded up to whole vectors: single pixels would cost as much as all the rest.
    """
    storeys, centre, tall = w[5], WINDOWS[int(w[8]), 2], WINDOWS[int(w[8]), 3]
    climb, start = rise * storeys, eye * storeys
    end = first + (end - first + 15) // 16 * 16
    plinth, cornice = np.float32(PLINTH) * storeys, (w[6] - np.float32(CORNICE)) * storeys
    lit_share, door = np.int32(light[LIT] * 32.0), np.int32(1 << 20)
    wall, band, glass = strip[_WALL, first:end], strip[_BAND, first:end], strip[_GLASS, first:end]
    glint, lit, number = strip[_GLINT, first:end], strip[_LIT, first:end], strip[_NUMBER, first:end]
    z, out = depth[first:end], packed[first:end]
    for column in range(len(out)):
        v = z[column] * climb + start
        a, b, c, d, e, bay = glass[column], glint[column], lit[column], wall[column], band[column], number[column]
        storey = np.int32(v)
        mark = np.int32(bay + storey * 13)
        colour = b if mark & np.int32(1) else a
        colour = c if (np.int32(mark * 11) >> np.int32(1)) & np.int32(31) < lit_share else colour
        colour = colour if abs(v - np.float32(storey) - centre) < tall else d
        colour = e if (v < plinth) | (v > cornice) else colour
        out[column] = a if (v < np.float32(DOOR)) & (bay >= door) else colour

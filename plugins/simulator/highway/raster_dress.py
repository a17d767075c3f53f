"""How faces look: their colour by role, light, weather and distance, and what walls need for their windows."""

from __future__ import annotations

import numpy as np

from me3bev_plugins.simulator.highway.compiled import kernel
from me3bev_plugins.simulator.highway.geometry import Meshes
from me3bev_plugins.simulator.highway.materials import COLOURS, Role
from me3bev_plugins.simulator.highway.raster_buffers import (
    BLUE,
    GREEN,
    RADIUS,
    RED,
    SECOND,
    STATE,
    Canvas,
    Floats,
    Ints,
    Singles,
)
from me3bev_plugins.simulator.highway.weather import Weather

SUN, AMBIENT, DIRECT, HAZE, THICKNESS, BEAM, LAMPS, LIT = 0, 3, 6, 9, 12, 13, 14, 15
"""Places in the light (16,): direction to the sun in the ego frame, light from everywhere, of the sun, colour of the
haze (three each), a quarter of its thickness per metre, strength of the ego's beam, whether lamps are on (0 or 1),
share of lit windows."""
PLAIN, WALL, GLOW = 0, 1, 2
"""How a face is coloured: one colour, windows, a lamp."""
STOREY, BAY = 3.3, 3.1
"""Height of a storey and width of a window bay, metres."""
BEAM_REACH = 18.0
"""Distance at which the ego's beam has half its strength, metres."""
_WALL, _LEAF, _TAIL, _HEADLAMP = int(Role.WALL), int(Role.LEAF), int(Role.TAIL), int(Role.HEADLAMP)
_LAMP_RED, _LAMP_GREEN, _LAMP = int(Role.RED), int(Role.GREEN), int(Role.LAMP)
_TAIL_LIT = (255.0, 46.0, 36.0)


def light_of(weather: Weather, cos: float, sin: float) -> Floats:
    """The light (16,) for an ego whose heading has this cosine and sine."""
    east, north, up = weather.sun
    sun = (cos * east + sin * north, cos * north - sin * east, up)
    return np.array(
        [
            *sun,
            *weather.ambient,
            *weather.direct,
            *weather.haze,
            0.25 / weather.haze_distance,
            weather.headlights,
            float(weather.lamps),
            weather.lit_windows,
        ]
    )


@kernel
def beam_at(x: float, y: float, z: float) -> float:
    """Light of the ego's beam, 0..1, in a direction of the ego frame (z up) and at its distance."""
    if x <= 0.0:
        return 0.0
    distance = np.sqrt(x * x + y * y + z * z)
    side, rise = y / distance, z / distance
    wide = 1.0 / (1.0 + 14.0 * side * side * side * side * (1.0 + 20.0 * side * side))
    high = 1.0 if rise < 0.0 else max(0.12, 1.0 - 9.0 * rise)
    fall = distance / BEAM_REACH
    return wide * high / (1.0 + fall * fall)


@kernel
def dress(
    face: int,
    f: int,
    n: Floats,
    label: Ints,
    ex: float,
    ey: float,
    ez: float,
    local: Floats,
    slope: float,
    fall: float,
    start: float,
    corners: int,
    R: Floats,
    meshes: Meshes,
    light: Floats,
    canvas: Canvas,
) -> None:
    """Sets colour and style of a face whose normal in the ego frame is (ex, ey, ez)."""
    role, style = meshes.role[f], PLAIN
    r, g, b = COLOURS[role, 0], COLOURS[role, 1], COLOURS[role, 2]
    if role == 0 or role == _WALL:
        r, g, b = n[RED], n[GREEN], n[BLUE]
        style = WALL if role == _WALL else PLAIN
    elif role == 1:
        packed = int(n[SECOND])
        r, g, b = float(packed >> 16), float((packed >> 8) & 255), float(packed & 255)
    elif role == _LEAF:
        tone = 0.8 + 0.05 * ((f * 5 + int(n[RADIUS] * 64.0) * 3) & 7)
        r, g, b = n[RED] * tone, n[GREEN] * tone, n[BLUE] * tone
    elif role == _TAIL:
        if label[STATE] == 1:
            r, g, b, style = _TAIL_LIT[0], _TAIL_LIT[1], _TAIL_LIT[2], GLOW
        elif light[LAMPS] > 0.0:
            r, g, b, style = 205.0, 26.0, 22.0, GLOW
    elif _LAMP_RED <= role <= _LAMP_GREEN:
        if label[STATE] == role - _LAMP_RED + 1:
            style = GLOW
        else:
            r, g, b = 0.14 * r + 8, 0.14 * g + 8, 0.14 * b + 8
    elif role == _HEADLAMP:
        style = GLOW
        if light[LAMPS] == 0.0:
            r, g, b = 0.88 * r, 0.9 * g, 0.94 * b
    elif role == _LAMP:
        style = GLOW if light[LAMPS] > 0.0 else PLAIN
    canvas.style[face] = style
    corner = meshes.corner[f]
    a, c = local[corner[0]], local[corner[2]]
    z = max(0.3, 0.5 * (a[2] + c[2]))
    lr, lg, lb = 1.0, 1.0, 1.0
    if style != GLOW:
        facing = max(0.0, ex * light[SUN] + ey * light[SUN + 1] + ez * light[SUN + 2])
        sky = 0.88 + 0.12 * ez
        beam = 0.0
        if light[BEAM] > 0.0:
            mx, my = 0.5 * (a[0] + c[0]), 0.5 * (a[1] + c[1])
            bx = R[0, 0] * mx + R[1, 0] * my + R[2, 0] * z
            by = R[0, 1] * mx + R[1, 1] * my + R[2, 1] * z
            bz = R[0, 2] * mx + R[1, 2] * my + R[2, 2] * z
            turned = -(ex * bx + ey * by) / max(1e-6, np.sqrt(bx * bx + by * by))
            beam = light[BEAM] * (0.25 + 0.75 * max(0.0, turned))
            beam *= 1.0 if style == WALL else beam_at(bx, by, bz)
        lr = light[AMBIENT] * sky + light[DIRECT] * facing
        lg = light[AMBIENT + 1] * sky + light[DIRECT + 1] * facing
        lb = light[AMBIENT + 2] * sky + light[DIRECT + 2] * facing
        if style == WALL:
            w = canvas.wall[face]
            _face_wall(w, a, local[corner[1]], c, n, label, beam, lr, lg, lb, r, g, b)
            w[7], w[16], w[17] = slope, start, fall
            left, right = np.inf, -np.inf
            for k in range(corners):
                left, right = min(left, canvas.polygon[k, 0]), max(right, canvas.polygon[k, 0])
            w[18] = max(0.0, np.floor(left - 0.5))
            w[19] = min(float(canvas.inverse.shape[1]), np.ceil(right + 0.5))
        lr, lg, lb = lr + beam, lg + 0.96 * beam, lb + 0.84 * beam
    clear = 1.0 / (1.0 + z * light[THICKNESS] * (0.5 if style == GLOW else 1.0))
    clear *= clear
    clear *= clear
    canvas.colour[face, 0] = np.uint8(min(255.0, light[HAZE] + (min(255.0, r * lr) - light[HAZE]) * clear))
    canvas.colour[face, 1] = np.uint8(min(255.0, light[HAZE + 1] + (min(255.0, g * lg) - light[HAZE + 1]) * clear))
    canvas.colour[face, 2] = np.uint8(min(255.0, light[HAZE + 2] + (min(255.0, b * lb) - light[HAZE + 2]) * clear))


@kernel
def _face_wall(
    w: Singles,
    a: Floats,
    b: Floats,
    top: Floats,
    n: Floats,
    label: Ints,
    beam: float,
    lr: float,
    lg: float,
    lb: float,
    red: float,
    green: float,
    blue: float,
) -> None:
    """What is needed to find windows on a wall whose foot runs from `a` to `b` (camera frame), up to `top`."""
    ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    length = np.sqrt(ux * ux + uy * uy + uz * uz)
    ux, uy, uz = ux / length, uy / length, uz / length
    height = np.sqrt((top[0] - b[0]) ** 2 + (top[1] - b[1]) ** 2 + (top[2] - b[2]) ** 2)
    w[0], w[1], w[2], w[3] = ux, uy, uz, -(ux * a[0] + uy * a[1] + uz * a[2])
    w[4], w[5] = max(1.0, np.floor(length / BAY)) / length, max(1.0, np.floor(height / STOREY)) / height
    w[6], w[8], w[9] = height, label[STATE] & 3, n[RADIUS]
    w[10], w[11], w[12] = min(255.0, red * lr), min(255.0, green * lg), min(255.0, blue * lb)
    w[13], w[14], w[15] = lr, lg, beam

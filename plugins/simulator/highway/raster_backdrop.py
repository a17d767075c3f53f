"""Tables that depend on the rig and the weather only: sky, colours of the ground by distance, the own beam."""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from me3bev_cli.api import Camera, Rig
from me3bev_plugins.simulator.highway.ground_tiles import BASES, MIX_PARTS, OFFSETS, SHADES, Paint
from me3bev_plugins.simulator.highway.raster_dress import beam_at
from me3bev_plugins.simulator.highway.weather import Weather

Bytes = NDArray[np.uint8]
Floats = NDArray[np.float64]

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
_POROUS = (Paint.GRASS, Paint.PATH)
"""Ground that does not shine when wet."""
_SHADE_TINT = np.array([0.97, 1.0, 1.06])
_BEAM_TINT = np.array([1.0, 0.95, 0.82])


class Backdrop(NamedTuple):
    """For C cameras of H x W pixels in one weather."""

    sky: Bytes
    """(C, H, 3)"""
    warm: Bytes
    """(C, H, 3) added to the sky towards the sun."""
    azimuth: Floats
    """(C, W) direction of the columns in the ego frame, radians."""
    ground: NDArray[np.uint32]
    """(C, H, 2, 256) colour of what ground cells hold, r + 256 g + 65536 b: in the open and in the shade."""
    level: NDArray[np.int64]
    """(C, H) mip level, -1 above the horizon."""
    depth: Floats
    """(C, H) distance along the optical axis of the ground, metres; 0 above the horizon."""
    cone: NDArray[np.float32]
    """(C, H, W) strength of the own beam in each pixel's direction; without pixels where there is no beam."""
    lamp: Bytes
    """(C, H, W) light on the ground, of 255; without pixels where it is the same everywhere."""


@lru_cache(maxsize=32)
def backdrop(rig: Rig, weather: Weather, cell: float) -> Backdrop:
    """Tables for a rig. Cameras do not roll, so all ground in one row lies at one depth.

    Args:
        cell: of the ground raster, metres.
    """
    height, width = rig.image_size
    count = len(rig.cameras)
    rows = np.arange(height, dtype=np.float64) + 0.5
    sky, warm = np.zeros((count, height, 3), np.uint8), np.zeros((count, height, 3), np.uint8)
    ground = np.zeros((count, height, 2, 256), np.uint32)
    level = np.full((count, height), -1, np.int64)
    depth = np.zeros((count, height))
    azimuth = np.zeros((count, width))
    columns = np.arange(width) + 0.5
    for i, camera in enumerate(rig.cameras):
        down = -_ray_z(camera, rows)
        sky[i], warm[i] = _sky(weather, -down)
        azimuth[i] = camera.yaw - np.arctan((columns - camera.cx) / camera.fx)
        below = down > 1e-6
        depth[i, below] = camera.position[2] / down[below]
        for row in np.flatnonzero(below):
            z = depth[i, row]
            across, along = z / camera.fx, z * z / (camera.fy * camera.position[2])
            footprint = across**0.7 * along**0.3
            level[i, row] = int(np.clip(np.log2(footprint / cell), 0, len(OFFSETS) - 1))
            ground[i, row] = _ground_colours(weather, float(z), float(down[row]))
    cone, lamp = _beams(rig, weather, depth)
    return Backdrop(sky, warm, azimuth, ground, level, depth, cone, lamp)


def _ray_z(camera: Camera, rows: Floats) -> Floats:
    """Upward part of the rays through the given rows (pixels) for unit depth."""
    down, forward = camera.camera_to_ego()[2][1], camera.camera_to_ego()[2][2]
    return down * (rows - camera.cy) / camera.fy + forward


def _sky(weather: Weather, rise: Floats) -> tuple[Bytes, Bytes]:
    """Colours (H, 3) of the sky and of what is added towards a low sun."""
    up = np.clip(rise / 0.45, 0.0, 1.0)[:, None] ** 0.7
    horizon, zenith = np.array(weather.horizon), np.array(weather.zenith)
    low = weather.cast and weather.sun[2] < 0.5
    if not low:
        return (horizon + (zenith - horizon) * up).astype(np.uint8), np.zeros((len(rise), 3), np.uint8)
    away = 0.55 * horizon + 0.45 * zenith
    base = away + (zenith - away) * up
    warm = np.clip(np.minimum(1.06 * horizon, 255.0) - base, 0, None) * np.exp(-3.2 * up)
    return base.astype(np.uint8), np.minimum(warm, 255.0 - base).astype(np.uint8)


def code_colours(wet: float = 0.0, sheen: float = 0.0, shine: Floats | None = None) -> Floats:
    """(CODES * SHADES, 3) colour of each class or mix at each brightness step, by full light and before haze.

    Args:
        wet: 0..1, how much water is on it.
        sheen: share of `shine`, the colour (3,) that wet ground reflects.
    """
    base = np.array([_PAINT_COLOURS[paint] for paint in Paint], np.float64)
    first, second, share = MIX_PARTS[:, 0], MIX_PARTS[:, 1], MIX_PARTS[:, 2:] / 8
    steps = (np.arange(SHADES) / (SHADES - 1) * 2 - 1)[None, :, None]
    grained = base[:, None] * (1 + steps * _GRAIN_STRENGTH[:, None, None])
    if wet:
        porous = np.isin(np.arange(BASES), [int(paint) for paint in _POROUS])
        dark = np.where(porous, 1 - 0.2 * wet, 1 - 0.42 * wet)[:, None, None]
        part = np.where(porous, 0.15 * sheen, sheen)[:, None, None]
        ripple = 1 + 0.35 * steps
        reflected = np.zeros(3) if shine is None else shine
        grained = grained * dark * (1 - part) + reflected * part * ripple
    mixed = grained[first] * (1 - share[..., None]) + grained[second] * share[..., None]
    return np.asarray(mixed.reshape(-1, 3))


def _ground_colours(weather: Weather, z: float, down: float) -> NDArray[np.uint32]:
    """(2, 256) packed colours at one depth, in the open and in the shade."""
    light = np.array(weather.ambient) + weather.sun[2] * np.array(weather.direct)
    if weather.headlights > 0.5:
        light = _BEAM_TINT
    haze = np.array(weather.haze)
    sheen = weather.wetness * (0.06 + 0.5 * float(np.exp(-11.0 * down)))
    codes = code_colours(weather.wetness, sheen, np.array(weather.horizon) / np.maximum(light, 0.1))
    codes = np.concatenate([codes[: BASES * SHADES], codes[BASES * SHADES + SHADES // 2 :: SHADES]])
    clear = (1.0 + 0.25 * z / weather.haze_distance) ** -4
    out = np.zeros((2, 256), np.uint32)
    for k, shade in enumerate((np.ones(3), weather.shadow * _SHADE_TINT)):
        colour = np.clip(haze + (codes * light * shade - haze) * clear, 0, 255).astype(np.uint32)
        out[k, : len(colour)] = colour[:, 0] | colour[:, 1] << 8 | colour[:, 2] << 16
    return out


def _beams(rig: Rig, weather: Weather, depth: Floats) -> tuple[NDArray[np.float32], Bytes]:
    """`Backdrop.cone` and `Backdrop.lamp`."""
    height, width = rig.image_size
    count = len(rig.cameras)
    if weather.headlights <= 0.5:
        return np.zeros((count, 0, 0), np.float32), np.zeros((count, 0, 0), np.uint8)
    cone, lamp = np.zeros((count, height, width), np.float32), np.zeros((count, height, width), np.uint8)
    least = sum(weather.ambient) / 3 + weather.sun[2] * sum(weather.direct) / 3
    for i, camera in enumerate(rig.cameras):
        pose = np.array(camera.camera_to_ego())
        for row in range(height):
            for column in range(width):
                ray = ((column + 0.5 - camera.cx) / camera.fx, (row + 0.5 - camera.cy) / camera.fy, 1.0)
                way = pose[:3, :3] @ ray
                far = way * 1000.0
                cone[i, row, column] = weather.headlights * beam_at(*far) * (1 + (np.linalg.norm(far) / 18.0) ** 2)
                z = depth[i, row]
                here = least
                if z > 0:
                    at = way * z + pose[:3, 3]
                    here += weather.headlights * beam_at(at[0] - 1.5, at[1], at[2] - 0.7)
                lamp[i, row, column] = int(255 * min(1.0, here))
    return cone, lamp

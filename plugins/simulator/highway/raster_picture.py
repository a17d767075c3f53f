"""All pictures of a frame in one compiled call: handing the arrays over costs as much as drawing a dozen things."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from me3bev_plugins.simulator.highway.compiled import kernel
from me3bev_plugins.simulator.highway.geometry import Meshes
from me3bev_plugins.simulator.highway.ground_tiles import Tiles
from me3bev_plugins.simulator.highway.raster import draw
from me3bev_plugins.simulator.highway.raster_backdrop import Backdrop
from me3bev_plugins.simulator.highway.raster_buffers import Canvas, Floats, Lenses, Things
from me3bev_plugins.simulator.highway.raster_colour import paint
from me3bev_plugins.simulator.highway.raster_dress import BEAM, LAMPS, SUN
from me3bev_plugins.simulator.highway.raster_lamps import collect_lamps, glare, light_pools, streak
from me3bev_plugins.simulator.highway.raster_shadow import Shadows, cast, shade


class Air(NamedTuple):
    """What the pictures need of the weather beyond its light and its tables."""

    shadows: bool
    slanted: bool
    """Whether shadows fall to the side."""
    low_sun: bool
    glare: float
    """Strength of lamps' glare, 0: none."""
    wetness: float
    streaks: int
    seed: int
    """What the rain depends on."""


@kernel
def pictures(
    lenses: Lenses,
    meshes: Meshes,
    things: Things,
    count: int,
    tiles: Tiles,
    town_level: int,
    pose: Floats,
    light: Floats,
    air: Air,
    drop: Backdrop,
    shadows: Shadows,
    lamps: Floats,
    canvas: Canvas,
    out: NDArray[np.uint8],
) -> None:
    """Draws every camera's picture into `out` (C, 3, H, W).

    Args:
        town_level: which of the town's ground levels.
        pose: (4,) the ego's x, y, cosine and sine of heading in the world.
        light: as `raster_dress` says.
        lamps: (L, LAMP_NUMBERS) room to work in.
    """
    height, width = canvas.inverse.shape
    cast_count = cast(things, count, light[SUN : SUN + 3], air.slanted, shadows) if air.shadows else 0
    night = light[BEAM] > 0.5
    lit = collect_lamps(things, count, night, lamps) if light[LAMPS] > 0.0 else 0
    bearing = np.arctan2(light[SUN + 1], light[SUN])
    for camera in range(len(lenses.position)):
        draw(camera, lenses, meshes, things, count, light, canvas)
        shade(camera, lenses, shadows, cast_count, canvas)
        if air.low_sun:
            for column in range(width):
                near = 0.5 + 0.5 * np.cos(drop.azimuth[camera, column] - bearing)
                canvas.warmth[column] = np.int32(250.0 * near * near * near)
        if night:
            for row in range(height):
                for column in range(width):
                    canvas.lamp[row, column] = drop.lamp[camera, row, column]
            light_pools(camera, lenses, drop.depth[camera], lamps, lit, canvas)
        paint(camera, lenses, drop, tiles, town_level, pose, light, air.low_sun, canvas, out[camera])
        if air.glare > 0.0:
            glare(camera, lenses, lamps, lit, air.glare, air.wetness, canvas, out[camera])
        if air.streaks > 0:
            streak(camera, air.seed, air.streaks, out[camera])

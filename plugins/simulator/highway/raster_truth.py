"""From the visibility buffer to the truth: depth, class and instance of every pixel."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from me3bev_plugins.simulator.highway.compiled import kernel
from me3bev_plugins.simulator.highway.ground_tiles import SEMANTIC as GROUND_SEMANTIC
from me3bev_plugins.simulator.highway.ground_tiles import Tiles, lookup
from me3bev_plugins.simulator.highway.raster import IDENTITY, SEMANTIC, Canvas, Lenses, Things
from me3bev_plugins.simulator.highway.raster_backdrop import Backdrop
from me3bev_plugins.simulator.highway.raster_colour import ground_row


@kernel
def read_truth(
    camera: int,
    lenses: Lenses,
    drop: Backdrop,
    tiles: Tiles,
    town_level: int,
    pose: NDArray[np.float64],
    things: Things,
    canvas: Canvas,
    depth: NDArray[np.float32],
    semantics: NDArray[np.uint8],
    instances: NDArray[np.int32],
) -> None:
    """Writes (H, W) depth along the optical axis (inf in the sky), class and instance (-1 for none)."""
    height, width = canvas.inverse.shape
    pin = lenses.pinhole[camera]
    index = tiles.table[town_level]
    ground = canvas.row
    for row in range(height):
        z = drop.depth[camera, row]
        if z > 0:
            y = (row + 0.5 - pin[3]) / pin[1]
            ground_row(camera, lenses, z, y, pose, tiles.origin, tiles.cell, ground)
        for column in range(width):
            face = canvas.face[row, column]
            instances[row, column] = -1
            if face >= 0:
                owner = canvas.owner[face]
                depth[row, column] = np.float32(1.0) / canvas.inverse[row, column]
                semantics[row, column] = things.label[owner, SEMANTIC]
                instances[row, column] = things.label[owner, IDENTITY]
            elif z > 0:
                c, r = int(np.floor(ground[0] + ground[2] * column)), int(np.floor(ground[1] + ground[3] * column))
                depth[row, column] = z
                semantics[row, column] = GROUND_SEMANTIC[lookup(index, tiles.data, r, c)]
            else:
                depth[row, column] = np.inf
                semantics[row, column] = 0

"""A picture of the environment for people: the cameras beside the bird's-eye view."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from me3bev_cli.api import Rig
from me3bev_plugins.simulator.highway.bev import bev_semantics
from me3bev_plugins.simulator.highway.cameras import Cameras
from me3bev_plugins.simulator.highway.scene import Scene

COLOURS = np.array(
    [
        (58, 66, 56),
        (96, 98, 104),
        (232, 232, 226),
        (240, 206, 120),
        (150, 146, 138),
        (122, 92, 82),
        (70, 130, 220),
        (226, 76, 70),
    ],
    np.uint8,
)
"""(8, 3) r, g, b of each of `BEV_CLASSES`."""
EGO_COLOUR = (255, 255, 255)
COLUMNS = 3
"""Cameras per row."""


def tile(images: NDArray[np.uint8], columns: int = COLUMNS) -> NDArray[np.uint8]:
    """Images (C, 3, H, W) in rows of `columns`, black where none is left: (rows * H, columns * W, 3)."""
    count, _, height, width = images.shape
    columns = min(columns, count)
    rows = -(-count // columns)
    sheet = np.zeros((rows * columns, height, width, 3), np.uint8)
    sheet[:count] = images.transpose(0, 2, 3, 1)
    grid = sheet.reshape(rows, columns, height, width, 3).transpose(0, 2, 1, 3, 4)
    return np.ascontiguousarray(grid.reshape(rows * height, columns * width, 3))


def bird(scene: Scene, size: int, cell: float = 0.5) -> NDArray[np.uint8]:
    """The semantic map around the ego in colours, (size, size, 3), the ego in white in the middle."""
    classes = bev_semantics(scene)
    colours = COLOURS[classes]
    half = len(classes) / 2
    ahead, left = scene.ego.length / 2 / cell, scene.ego.width / 2 / cell
    colours[round(half - ahead) : round(half + ahead), round(half - left) : round(half + left)] = EGO_COLOUR
    index = np.arange(size) * len(classes) // size
    return np.ascontiguousarray(colours[index][:, index])


def picture(scene: Scene, cameras: Cameras, rig: Rig) -> NDArray[np.uint8]:
    """All cameras and, to their right, the bird's-eye view: (H, W, 3) r, g, b."""
    images = np.empty((len(rig.cameras), 3, *rig.image_size), np.uint8)
    cameras.render(scene, images)
    sheet = tile(images)
    return np.concatenate([sheet, bird(scene, len(sheet))], axis=1)

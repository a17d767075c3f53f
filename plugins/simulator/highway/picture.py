"""The cameras of an environment in one picture, for people."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from me3bev_cli.api import Rig
from me3bev_plugins.simulator.highway.cameras import Cameras
from me3bev_plugins.simulator.highway.scene import Scene

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


def camera_sheet(scene: Scene, cameras: Cameras, rig: Rig) -> NDArray[np.uint8]:
    """All cameras side by side: (H, W, 3) r, g, b."""
    images = np.empty((len(rig.cameras), 3, *rig.image_size), np.uint8)
    cameras.render(scene, images)
    return tile(images)

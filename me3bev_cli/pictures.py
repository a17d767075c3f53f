"""What pictures of a drive have in common: colours of the semantic map, cameras side by side."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

BEV_COLOURS = np.array(
    [
        (58, 80, 56),  # other
        (78, 80, 88),  # road
        (238, 238, 232),  # lane marking
        (236, 196, 96),  # crosswalk
        (150, 148, 142),  # sidewalk
        (134, 98, 80),  # building
        (64, 136, 255),  # vehicle
        (240, 62, 70),  # pedestrian
    ],
    np.uint8,
)
"""(8, 3) r, g, b of each of `api.BEV_CLASSES`."""
CAMERA_COLUMNS = 3
"""Cameras in a row."""


def colour_map(classes: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Classes (X, Y) -> (X, Y, 3) r, g, b."""
    return BEV_COLOURS[np.minimum(classes, len(BEV_COLOURS) - 1)]


def tile(images: NDArray[np.uint8], columns: int = CAMERA_COLUMNS) -> NDArray[np.uint8]:
    """Images (C, 3, H, W) in rows of `columns`, black where none is left: (rows * H, columns * W, 3)."""
    count, channels, height, width = images.shape
    columns = min(columns, count)
    rows = -(-count // columns)
    sheet = np.zeros((rows * columns, channels, height, width), np.uint8)
    sheet[:count] = images
    grid = sheet.reshape(rows, columns, channels, height, width).transpose(0, 3, 1, 4, 2)
    return np.ascontiguousarray(grid.reshape(rows * height, columns * width, channels))

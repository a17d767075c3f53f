"""The paper's figure: six camera images, true BEV and decoded BEV, side by side."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

PALETTE = np.array(
    [
        (58, 92, 52),  # other
        (72, 72, 78),  # road
        (240, 240, 240),  # lane marking
        (214, 184, 96),  # crosswalk
        (150, 150, 150),  # sidewalk
        (150, 104, 70),  # building
        (40, 98, 255),  # vehicle
        (230, 40, 60),  # pedestrian
    ],
    np.uint8,
)
"""Colour (r, g, b) of each of `api.BEV_CLASSES`."""

GAP = 4


def colour_map(classes: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Classes (X, Y) -> RGB (X, Y, 3)."""
    return PALETTE[classes]


def camera_mosaic(images: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Images (C, 3, H, W) in rows of three -> RGB."""
    pictures = list(images.transpose(0, 2, 3, 1))
    while len(pictures) % 3:
        pictures.append(np.zeros_like(pictures[0]))
    return np.concatenate([np.concatenate(pictures[i : i + 3], 1) for i in range(0, len(pictures), 3)], 0)


def panel(images: NDArray[np.uint8], maps: list[NDArray[np.uint8]]) -> NDArray[np.uint8]:
    """Cameras on the left, semantic maps (200, 200) on the right, all as high as the mosaic at twice its size."""
    mosaic = camera_mosaic(images)
    height = max(256, mosaic.shape[0])
    width = round(mosaic.shape[1] * height / mosaic.shape[0])
    parts = [cv2.resize(mosaic, (width, height), interpolation=cv2.INTER_NEAREST)]
    for classes in maps:
        parts.append(np.full((height, GAP, 3), 255, np.uint8))
        parts.append(cv2.resize(colour_map(classes), (height, height), interpolation=cv2.INTER_NEAREST))
    return np.concatenate(parts, 1)


def write_png(path: Path, picture: NDArray[np.uint8]) -> None:
    """Write an RGB picture under a temporary name and rename it."""
    ok, data = cv2.imencode(".png", np.ascontiguousarray(picture[:, :, ::-1]))
    if not ok:
        raise RuntimeError("OpenCV could not encode a PNG")
    temporary = path.with_name(f".{path.name}.part")
    temporary.write_bytes(data.tobytes())
    temporary.rename(path)

"""The paper's figure: six camera images, true BEV and decoded BEV, side by side."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from me3bev_cli.pictures import colour_map, tile

GAP = 4


def panel(images: NDArray[np.uint8], maps: list[NDArray[np.uint8]]) -> NDArray[np.uint8]:
    """Cameras on the left, semantic maps (200, 200) on the right, all as high as the mosaic at twice its size."""
    mosaic = tile(images)
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

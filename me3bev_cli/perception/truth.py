"""What a frame is learned from, beside its pictures: depth per feature cell, and which cells of the map are in sight.

No torch here: worker processes make it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from me3bev_cli.api import Rig

CELLS, CELL = 200, 0.5
"""Cells per side of the semantic map, and metres per cell."""
BODY = 5.0
"""Metres: so much of a thing's own length may lie between its visible side and a cell under it."""
SLACK = 0.75
"""Pixels: how far a ground point's depth may be off for being read at the centre of a pixel."""
SAMPLES = 4
"""Pixels per feature cell and axis, at most, of which the shares of depth are made."""

Bytes = NDArray[np.uint8]


@dataclass(frozen=True)
class DepthBins:
    """The bins in which a spatial plugin predicts depth.

    Args:
        edges: (bins + 1,) metres along the optical axis, rising.
        size: (h, w) of the feature map.
        image: (H, W) of the images.
    """

    edges: tuple[float, ...]
    size: tuple[int, int]
    image: tuple[int, int]

    def shares(self, depth: NDArray[np.float32]) -> Bytes:
        """How the pixels of each feature cell spread over the bins: (C, bins, h, w), in 255ths.

        What is nearer or farther than the bins is left out, so a cell adds up to 255 times its share inside.

        Args:
            depth: (C, H, W), metres along the optical axis; inf where nothing is.
        """
        rows, columns = (_samples(image, cells) for image, cells in zip(self.image, self.size, strict=True))
        picked = depth[:, rows[:, None], columns[None]]
        bins = len(self.edges) - 1
        found = np.searchsorted(np.asarray(self.edges, np.float32), picked, side="right") - 1
        inside = (found >= 0) & (found < bins)
        cameras, (h, w) = len(depth), self.size
        cell_row = np.repeat(np.arange(h), len(rows) // h)
        cell_column = np.repeat(np.arange(w), len(columns) // w)
        camera = np.arange(cameras)[:, None, None]
        flat = ((camera * bins + np.where(inside, found, 0)) * h + cell_row[None, :, None]) * w + cell_column
        counts = np.bincount(flat[inside], minlength=cameras * bins * h * w)
        of = (len(rows) // h) * (len(columns) // w)
        return (counts * 255 // of).astype(np.uint8).reshape(cameras, bins, h, w)


def _samples(pixels: int, cells: int) -> NDArray[np.int64]:
    """Pixels, equally many in each of `cells` feature cells; the last ones may stand at the border."""
    stride = _stride(pixels, cells)
    count = min(SAMPLES, stride)
    inner = (np.arange(count) * stride + stride // 2) // count
    places = np.arange(cells)[:, None] * stride + inner
    return np.minimum(places.ravel(), pixels - 1)


def _stride(pixels: int, cells: int) -> int:
    """Pixels per feature cell: the power of two that leaves so many cells, or an equal share."""
    powers = [2**n for n in range(12) if -(-pixels // 2**n) == cells]
    return powers[0] if powers else max(1, pixels // cells)


class Sight:
    """Finds the cells of the semantic map that are in some camera's clear sight.

    A cell is seen where the line from a camera to the ground at its centre is free, or ends on a thing of the cell's
    own class at most `BODY` metres before it: of a car one side is seen, and that is a sight of the car.

    Args:
        rig: C cameras of one size.
    """

    def __init__(self, rig: Rig) -> None:
        height, width = rig.image_size
        half = CELLS * CELL / 2
        steps = half - CELL * (np.arange(CELLS) + 0.5)
        ground = np.stack(
            [*np.meshgrid(steps, steps, indexing="ij"), np.zeros((CELLS, CELLS)), np.ones((CELLS, CELLS))]
        )
        cells, pixels, depths, slacks = [], [], [], []
        for index, camera in enumerate(rig.cameras):
            x, y, z = (np.linalg.inv(np.array(camera.camera_to_ego())) @ ground.reshape(4, -1))[:3]
            ahead = z > 0.1
            safe = np.where(ahead, z, 1.0)
            u, v = camera.fx * x / safe + camera.cx, camera.fy * y / safe + camera.cy
            inside = np.flatnonzero(ahead & (u >= 0) & (u < width) & (v >= 0) & (v < height))
            cells.append(inside)
            pixels.append((index * height + v[inside].astype(np.int64)) * width + u[inside].astype(np.int64))
            depths.append(z[inside])
            # On the ground the inverse of depth is linear in the image; this is its change over a pixel.
            slacks.append(np.full(len(inside), SLACK / (camera.fy * max(camera.position[2], 0.1))))
        self._cell, self._pixel = np.concatenate(cells), np.concatenate(pixels)
        self._depth = np.concatenate(depths).astype(np.float32)
        self._farthest = (1 / self._depth + np.concatenate(slacks)).astype(np.float32)

    def __call__(self, depth: NDArray[np.float32], classes: Bytes, bev: Bytes) -> NDArray[np.bool_]:
        """Which cells are seen, (200, 200).

        Args:
            depth, classes: (C, H, W), of every pixel: metres along the optical axis, and `BEV_CLASSES`.
            bev: (200, 200), the true map.
        """
        there = depth.ravel()[self._pixel]
        free = 1 / there <= self._farthest
        own = classes.ravel()[self._pixel] == bev.ravel()[self._cell]
        seen = np.zeros(CELLS * CELLS, bool)
        seen[self._cell[free | (own & (there >= self._depth - BODY))]] = True
        return seen.reshape(CELLS, CELLS)


SEEN = 0x80
"""The bit of a map's byte that says whether the cell is in sight."""


def packed(bev: Bytes, seen: NDArray[np.bool_]) -> Bytes:
    """Class and sight of each cell in one byte."""
    return bev | (seen.astype(np.uint8) * np.uint8(SEEN))


def classes_of(maps: Bytes) -> Bytes:
    """The classes of packed maps."""
    return maps & np.uint8(SEEN - 1)


def seen_in(maps: Bytes) -> NDArray[np.bool_]:
    """Which cells of packed maps are in sight."""
    return maps >= SEEN


def mirrored_cameras(rig: Rig) -> tuple[int, ...] | None:
    """For each camera the one that sees the mirrored world (y turned to -y); None where the rig is not symmetric.

    A mirrored frame takes camera k's picture, mirrored, from the k-th of these.
    """
    places = {}
    for index, camera in enumerate(rig.cameras):
        if abs(camera.cx - camera.width / 2) > 1e-6:
            return None
        places[_place(camera.position, camera.yaw, camera.pitch, camera.fx, camera.fy, camera.cy)] = index
    found = []
    for camera in rig.cameras:
        x, y, z = camera.position
        found.append(places.get(_place((x, -y, z), -camera.yaw, camera.pitch, camera.fx, camera.fy, camera.cy)))
    return tuple(index for index in found if index is not None) if None not in found else None


def _place(position: tuple[float, float, float], yaw: float, *rest: float) -> tuple[float, ...]:
    turn = (round(float(np.cos(yaw)), 6) + 0.0, round(float(np.sin(yaw)), 6) + 0.0)
    return (*(round(value, 6) + 0.0 for value in position), *turn, *(round(value, 6) for value in rest))

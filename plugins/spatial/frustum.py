"""Where every (camera, feature cell, depth bin) lies in the bird's-eye grid (the geometry of eqs. 9-10).

Frames as in the plugin contract: ego x forward, y left, z up. The grid's row 0 is farthest ahead (largest x),
its column 0 farthest left (largest y). Everything is computed in float64.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from me3bev_cli.api import Rig


class Grid(NamedTuple):
    """A bird's-eye grid of `rows` x `columns` square cells in the ego frame."""

    x_range: tuple[float, float]
    y_range: tuple[float, float]
    z_range: tuple[float, float]
    cell: float

    @property
    def rows(self) -> int:
        """Cells along x."""
        return round((self.x_range[1] - self.x_range[0]) / self.cell)

    @property
    def columns(self) -> int:
        """Cells along y."""
        return round((self.y_range[1] - self.y_range[0]) / self.cell)

    def centres(self, samples: int = 1) -> Tensor:
        """Points (rows * samples, columns * samples, 2), x and y in metres, spread evenly over the cells."""
        step = self.cell / samples
        x = self.x_range[1] - step * (torch.arange(self.rows * samples, dtype=torch.float64) + 0.5)
        y = self.y_range[1] - step * (torch.arange(self.columns * samples, dtype=torch.float64) + 0.5)
        return torch.stack(torch.meshgrid(x, y, indexing="ij"), dim=-1)


def calibration(rig: Rig) -> tuple[Tensor, Tensor]:
    """Intrinsics (C, 3, 3) and camera-to-ego extrinsics (C, 4, 4) of a rig."""
    intrinsics = torch.tensor([camera.intrinsics() for camera in rig.cameras], dtype=torch.float64)
    extrinsics = torch.tensor([camera.camera_to_ego() for camera in rig.cameras], dtype=torch.float64)
    return intrinsics, extrinsics


def depth_edges(nearest: float, farthest: float, bins: int) -> Tensor:
    """The bins' borders (bins + 1,), metres along the optical axis."""
    return torch.linspace(nearest, farthest, bins + 1, dtype=torch.float64)


def feature_size(height: int, width: int, stride: int) -> tuple[int, int]:
    """(h, w) of a trunk's features: the image's size over the stride, rounded up."""
    return -(-height // stride), -(-width // stride)


def frustum(intrinsics: Tensor, extrinsics: Tensor, features: tuple[int, int], stride: int, depths: Tensor) -> Tensor:
    """Ego coordinates of every feature cell at every depth: (C, D, h, w, 3), metres, on the calibration's device.

    Args:
        intrinsics, extrinsics: (C, 3, 3) and (C, 4, 4).
        features: (h, w) of the feature map; a cell stands for the ray through its centre.
        stride: image pixels per feature cell.
        depths: (D,), metres along the optical axis.
    """
    h, w = features
    device = intrinsics.device
    v = (torch.arange(h, dtype=torch.float64, device=device) + 0.5) * stride
    u = (torch.arange(w, dtype=torch.float64, device=device) + 0.5) * stride
    v, u = torch.meshgrid(v, u, indexing="ij")
    pixels = torch.stack([u, v, torch.ones_like(u)], dim=-1)
    rays = torch.einsum("cij,hwj->chwi", torch.linalg.inv(intrinsics), pixels)
    points = depths.to(device)[None, :, None, None, None] * rays[:, None]
    turned = torch.einsum("cij,cdhwj->cdhwi", extrinsics[:, :3, :3], points)
    return turned + extrinsics[:, None, None, None, :3, 3]


def frame_cells(cells: Tensor, frames: int, count: int) -> Tensor:
    """Cells (N * C, ...), each of its frame's grid of `count` cells -> of the N grids one after another; -1 stays."""
    shift = count * torch.arange(frames, device=cells.device).repeat_interleave(len(cells) // frames)
    return torch.where(cells >= 0, cells + shift.view(-1, *(1 for _ in cells.shape[1:])), -1)


def cells_of(points: Tensor, grid: Grid) -> Tensor:
    """Flat cell index (row * columns + column) of points (..., 3); -1 outside the grid or its range of heights."""
    x, y, z = points.unbind(-1)
    row = torch.floor((grid.x_range[1] - x) / grid.cell).long()
    column = torch.floor((grid.y_range[1] - y) / grid.cell).long()
    inside = (row >= 0) & (row < grid.rows) & (column >= 0) & (column < grid.columns)
    inside &= (z >= grid.z_range[0]) & (z <= grid.z_range[1])
    return torch.where(inside, row * grid.columns + column, -1)

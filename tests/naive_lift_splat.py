"""Lift and splat as the paper writes them, with every lifted point in memory: slow, plain, in float64."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from me3bev_cli.api import Camera, Rig


def rig(cameras: int = 6, height: int = 32, width: int = 48, shift: tuple[float, float] = (0.0, 0.0)) -> Rig:
    """Cameras that look all around, moved by `shift` metres; odd numbers keep their points off the cells' borders."""
    return Rig(
        cameras=tuple(
            Camera(
                name=f"camera_{index}",
                width=width,
                height=height,
                fx=30.7 + index,
                fy=31.0,
                cx=width / 2 + 0.3 * index,
                cy=0.4 * height,
                position=(0.513 * math.cos(index) + shift[0], 0.4 * math.sin(index) + shift[1], 1.507 + 0.05 * index),
                yaw=2 * math.pi * index / cameras + 0.07 * index,
                pitch=-0.03 * index,
            )
            for index in range(cameras)
        )
    )


def point(camera: Camera, u: float, v: float, depth: float) -> tuple[float, float, float]:
    """Where pixel position (u, v) at `depth` metres along the optical axis lies in the ego frame."""
    right = (u - camera.cx) / camera.fx * depth
    down = (v - camera.cy) / camera.fy * depth
    # The camera's axes from its angles: the nose turned left by yaw, then up by pitch.
    sy, cy, sp, cp = math.sin(camera.yaw), math.cos(camera.yaw), math.sin(camera.pitch), math.cos(camera.pitch)
    ahead, up = depth * cp + down * sp, depth * sp - down * cp
    x, y = ahead * cy + right * sy, ahead * sy - right * cy
    return x + camera.position[0], y + camera.position[1], up + camera.position[2]


def lift_splat(
    rig: Rig,
    probability: Tensor,
    context: Tensor,
    *,
    stride: int,
    depth_range: tuple[float, float],
    x_range: tuple[float, float],
    y_range: tuple[float, float],
    z_range: tuple[float, float],
    cell: float,
) -> Tensor:
    """eqs. 9-10.

    Args:
        probability: (N, C, D, h, w).
        context: (N, C, channels, h, w).

    Returns:
        (N, channels, X, Y), row 0 farthest ahead, column 0 farthest left.
    """
    frames, cameras, bins, h, w = probability.shape
    lifted = probability.unsqueeze(2) * context.unsqueeze(3)
    rows, columns = round((x_range[1] - x_range[0]) / cell), round((y_range[1] - y_range[0]) / cell)
    sums: dict[tuple[int, int], Tensor] = {}
    for c in range(cameras):
        for d in range(bins):
            depth = depth_range[0] + (d + 0.5) * (depth_range[1] - depth_range[0]) / bins
            for i in range(h):
                for j in range(w):
                    x, y, z = point(rig.cameras[c], (j + 0.5) * stride, (i + 0.5) * stride, depth)
                    row, column = math.floor((x_range[1] - x) / cell), math.floor((y_range[1] - y) / cell)
                    if 0 <= row < rows and 0 <= column < columns and z_range[0] <= z <= z_range[1]:
                        add = lifted[:, c, :, d, i, j]
                        sums[row, column] = sums[row, column] + add if (row, column) in sums else add
    empty = context.new_zeros(frames, context.shape[2])
    grid = [torch.stack([sums.get((row, column), empty) for column in range(columns)], -1) for row in range(rows)]
    return torch.stack(grid, -2)


def assert_same(grid: Tensor, expected: Tensor, inputs: tuple[Tensor, ...]) -> None:
    """Two float64 grids made from the same inputs have the same values and gradients, and are not empty."""
    assert expected.abs().max() > 0.1
    torch.testing.assert_close(grid, expected, rtol=1e-9, atol=1e-12)
    weights = torch.randn(grid.shape, dtype=torch.float64)
    given = torch.autograd.grad((grid * weights).sum(), inputs)
    right = torch.autograd.grad((expected * weights).sum(), inputs)
    for mine, theirs in zip(given, right, strict=True):
        torch.testing.assert_close(mine, theirs, rtol=1e-9, atol=1e-12)

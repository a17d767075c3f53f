"""The images warped to the ground plane: a flat-world view of road paint, free of any estimate of depth."""

from __future__ import annotations

from typing import NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor

from me3bev_cli.api import Rig
from me3bev_plugins.spatial.frustum import Grid, calibration
from me3bev_plugins.spatial.splat import weighted_bags


class GroundIndex(NamedTuple):
    """Where each ground point (z = 0) is seen: four pixels and their weights per point, S points in V cells."""

    pixel: Tensor
    """(M,) flat index in (C, H, W), by point."""
    weight: Tensor
    """(M,) share of the pixel in the point's colour; a point's four add up to 1."""
    offsets: Tensor
    """(S,) where each point's pixels begin; points that no camera sees have none."""
    seen: Tensor
    """(V, 1) share of each cell's points that some camera sees."""


def ground_index(rig: Rig, grid: Grid, samples: int) -> GroundIndex:
    """Find the ground in the images.

    Every cell has samples x samples points, which follow each other. A point that several cameras see is taken
    from the one nearest whose optical axis it lies.
    """
    points = grid.centres(samples).view(grid.rows, samples, grid.columns, samples, 2)
    points = points.transpose(1, 2).reshape(-1, 2)
    camera, u, v, seen = _seen_by(rig, points)
    height, width = rig.image_size
    # Centres of pixels lie at halves; at the border the outermost pixel is held.
    u = (u - 0.5).clamp(0, width - 1)
    v = (v - 0.5).clamp(0, height - 1)
    left, top = u.floor().clamp(max=width - 2), v.floor().clamp(max=height - 2)
    right_share, low_share = u - left, v - top
    corner = (camera * height + top.long()) * width + left.long()
    pixel = torch.stack([corner, corner + 1, corner + width, corner + width + 1], dim=1)
    across = torch.stack([1 - right_share, right_share], dim=1)
    weight = torch.cat([across * (1 - low_share)[:, None], across * low_share[:, None]], dim=1)
    return GroundIndex(
        pixel=pixel[seen].flatten(),
        weight=weight[seen].flatten().float(),
        offsets=4 * (seen.cumsum(0) - seen.long()),
        seen=seen.view(-1, samples**2).float().mean(1, keepdim=True),
    )


def _seen_by(rig: Rig, points: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """For ground points (S, 2): the camera that sees each best, the pixel position there, and whether any does."""
    intrinsics, extrinsics = calibration(rig)
    height, width = rig.image_size
    ground = F.pad(points, (0, 1))
    ground = torch.cat([ground, torch.ones_like(ground[:, :1])], dim=1)
    seen_from = torch.einsum("cij,sj->csi", torch.linalg.inv(extrinsics), ground)[..., :3]
    depth = seen_from[..., 2]
    position = torch.einsum("cij,csj->csi", intrinsics, seen_from)[..., :2] / depth.clamp(min=1e-6).unsqueeze(-1)
    u, v = position.unbind(-1)
    seen = (depth > 0.1) & (u >= 0) & (u <= width) & (v >= 0) & (v <= height)
    score = torch.where(seen, depth / seen_from.norm(dim=-1), -1.0) - 1e-9 * _ranks(rig)[:, None]
    best = score.argmax(0)
    chosen = best, torch.arange(len(points))
    return best, u[chosen], v[chosen], seen.any(0)


def _ranks(rig: Rig) -> Tensor:
    """A place for each camera that does not depend on its place in the rig: ties go to the same one."""
    keys = [(camera.yaw, camera.pitch, camera.position, camera.name) for camera in rig.cameras]
    order = sorted(keys)
    return torch.tensor([order.index(key) for key in keys], dtype=torch.float64)


def warp(pixels: Tensor, index: GroundIndex) -> Tensor:
    """The ground as the cameras see it.

    Args:
        pixels: (N, C * H * W, 3).
        index: from `ground_index`.

    Returns:
        (N, V, 3 * samples^2 + 1): the colours of each cell's points, and the share of them that is seen.
    """
    weight = index.weight.to(pixels.dtype)
    points = torch.stack([weighted_bags(frame, weight, index.pixel, index.offsets) for frame in pixels])
    cells = points.view(len(pixels), len(index.seen), -1)
    return torch.cat([cells, index.seen.to(cells.dtype).expand(len(pixels), -1, -1)], dim=2)

"""The images warped to the ground plane: a flat-world view of road paint, free of any estimate of depth."""

from __future__ import annotations

from typing import NamedTuple

import torch
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
    """Find the ground in the images of a rig; see `find_ground`."""
    intrinsics, extrinsics = calibration(rig)
    return find_ground(intrinsics, extrinsics, ranks(rig), rig.image_size, grid, samples)


def find_ground(
    intrinsics: Tensor, extrinsics: Tensor, order: Tensor, image_size: tuple[int, int], grid: Grid, samples: int
) -> GroundIndex:
    """Find the ground in the images.

    Every cell has samples x samples points, which follow each other. A point that several cameras see is taken
    from the one nearest whose optical axis it lies.

    Args:
        intrinsics, extrinsics: (C, 3, 3) and (C, 4, 4) of one frame, float64.
        order: from `ranks`.
        image_size: (H, W), pixels.
        grid: whose cells are looked for.
        samples: ground points per cell and axis.
    """
    points = grid.centres(samples).view(grid.rows, samples, grid.columns, samples, 2)
    points = points.transpose(1, 2).reshape(-1, 2).to(intrinsics.device)
    camera, u, v, seen = _seen_by(intrinsics, extrinsics, order, image_size, points)
    height, width = image_size
    # Centres of pixels lie at halves; at the border the outermost pixel is held.
    u = (u - 0.5).clamp(0, width - 1)
    v = (v - 0.5).clamp(0, height - 1)
    left, top = u.floor().clamp(max=width - 2), v.floor().clamp(max=height - 2)
    right_share, low_share = u - left, v - top
    corner = (camera * height + top.long()) * width + left.long()
    pixel = torch.stack([corner, corner + 1, corner + width, corner + width + 1], dim=1)
    across = torch.stack([1 - right_share, right_share], dim=1)
    weight = torch.cat([across * (1 - low_share)[:, None], across * low_share[:, None]], dim=1)
    # Numbers up to four pixels per ground point: int32 holds them and is half as much to read.
    return GroundIndex(
        pixel=pixel[seen].flatten().int(),
        weight=weight[seen].flatten().float(),
        offsets=(4 * (seen.cumsum(0) - seen.long())).int(),
        seen=seen.view(-1, samples**2).float().mean(1, keepdim=True),
    )


def _seen_by(
    intrinsics: Tensor, extrinsics: Tensor, order: Tensor, image_size: tuple[int, int], points: Tensor
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """For ground points (S, 2): the camera that sees each best, the pixel position there, and whether any does."""
    height, width = image_size
    # On the plane z = 0 a camera is a homography (3 x 3) of (x, y, 1); its last row gives the depth.
    plane = (intrinsics @ torch.linalg.inv(extrinsics)[:, :3])[:, :, [0, 1, 3]]
    x, y = points.unbind(-1)
    across, down, depth = (plane.reshape(-1, 3) @ torch.stack([x, y, torch.ones_like(x)])).view(-1, 3, len(x)).unbind(1)
    eye = extrinsics[:, :3, 3, None]
    distance = ((x - eye[:, 0]).square() + (y - eye[:, 1]).square() + eye[:, 2].square()).sqrt()
    seen = (depth > 0.1) & (across >= 0) & (across <= width * depth) & (down >= 0) & (down <= height * depth)
    score = torch.where(seen, depth / distance, -1.0) - 1e-9 * order[:, None]
    best = score.argmax(0)
    chosen = best, torch.arange(len(points), device=best.device)
    nearest = depth[chosen].clamp(min=0.1)
    return best, across[chosen] / nearest, down[chosen] / nearest, seen.any(0)


def ranks(rig: Rig) -> Tensor:
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
    points = [weighted_bags(frame, weight, index.pixel, index.offsets) for frame in pixels]
    cells = torch.cat([frame.view(1, len(index.seen), -1) for frame in points])
    return torch.cat([cells, index.seen.to(cells.dtype).expand(len(pixels), -1, -1)], dim=2)

"""The images warped to the ground plane: a flat-world view of road paint, free of any estimate of depth."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor

from me3bev_cli.api import Rig
from me3bev_plugins.spatial.frustum import Grid, calibration


def ground_lookup(rig: Rig, grid: Grid, samples: int) -> tuple[Tensor, Tensor]:
    """Where each ground point (z = 0) is seen.

    Every cell has samples x samples points. A point that several cameras see is taken from the one
    nearest whose optical axis it lies.

    Returns:
        Sampling positions (rows * samples, columns * samples, 2) for `grid_sample` over the cameras' images
        stacked downwards, and a mask (rows * samples, columns * samples) of the points that are seen.
    """
    intrinsics, extrinsics = calibration(rig)
    height, width = rig.image_size
    ground = F.pad(grid.centres(samples), (0, 2))
    ground[..., 3] = 1.0
    seen_by = torch.einsum("cij,xyj->cxyi", torch.linalg.inv(extrinsics), ground)[..., :3]
    depth = seen_by[..., 2]
    pixels = torch.einsum("cij,cxyj->cxyi", intrinsics, seen_by)[..., :2] / depth.clamp(min=1e-6).unsqueeze(-1)
    u, v = pixels.unbind(-1)
    seen = (depth > 0.1) & (u >= 0) & (u <= width) & (v >= 0) & (v <= height)
    score = torch.where(seen, depth / seen_by.norm(dim=-1), -1.0) - 1e-9 * _ranks(rig)[:, None, None]
    best = score.argmax(0, keepdim=True)
    # Half a pixel from the border, so that no sample reaches into the image stacked next to it.
    u = u.gather(0, best)[0].clamp(0.5, width - 0.5)
    v = v.gather(0, best)[0].clamp(0.5, height - 0.5) + best[0] * height
    where = torch.stack([u / width, v / (height * len(rig.cameras))], dim=-1) * 2 - 1
    return where.float(), seen.any(0)


def _ranks(rig: Rig) -> Tensor:
    """A place for each camera that does not depend on its place in the rig: ties go to the same one."""
    keys = [(camera.yaw, camera.pitch, camera.position, camera.name) for camera in rig.cameras]
    order = sorted(keys)
    return torch.tensor([order.index(key) for key in keys], dtype=torch.float64)


def warp(images: Tensor, where: Tensor, seen: Tensor, samples: int) -> Tensor:
    """The ground as the cameras see it.

    Args:
        images: (N, C, 3, H, W).
        where, seen: from `ground_lookup`.
        samples: points per cell and axis, as given there.

    Returns:
        (N, 3 * samples^2 + 1, X, Y): each cell's samples, and whether it is seen.
    """
    count = len(images)
    stacked = images.transpose(1, 2).flatten(2, 3)
    ground = F.grid_sample(stacked, where.to(images.dtype).expand(count, -1, -1, -1), align_corners=False)
    ground = ground * seen
    cells = F.pixel_unshuffle(ground, samples)
    mask = F.avg_pool2d(seen[None, None].to(images.dtype), samples)
    return torch.cat([cells, mask.expand(count, -1, -1, -1)], dim=1)

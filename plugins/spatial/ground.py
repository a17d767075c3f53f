"""The images warped to the ground plane: a flat-world view of road paint, free of any estimate of depth."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from me3bev_cli.api import Rig
from me3bev_plugins.spatial.frustum import Grid, calibration
from me3bev_plugins.spatial.splat import weighted_bags


class GroundIndex(NamedTuple):
    """Where each piece of ground (z = 0) is seen: pixels and their weights, S pieces in V cells."""

    pixel: Tensor
    """(M,) flat index in (C, H, W), by piece."""
    weight: Tensor
    """(M,) share of the pixel in the piece's colour; a piece's add up to 1."""
    offsets: Tensor
    """(S,) where each piece's pixels begin; pieces that no camera sees have none."""
    seen: Tensor
    """(V, 1) share of each cell's points that some camera sees."""


class Sampling(NamedTuple):
    """How finely the ground is looked at, per cell and axis."""

    pieces: int
    """Pieces of ground, each of which gives a colour."""
    points: int = 1
    """Points per piece and axis, whose mean its colour is: a line narrower than a piece is not missed."""


def ground_index(rig: Rig, grid: Grid, sampling: Sampling) -> GroundIndex:
    """Find the ground in the images of a rig; see `find_ground`."""
    intrinsics, extrinsics = calibration(rig)
    return find_ground(intrinsics, extrinsics, ranks(rig), rig.image_size, grid, sampling)


def find_ground(
    intrinsics: Tensor, extrinsics: Tensor, order: Tensor, image_size: tuple[int, int], grid: Grid, sampling: Sampling
) -> GroundIndex:
    """Find the ground in the images.

    A cell's pieces follow each other. A point that several cameras see is taken from the one nearest whose optical
    axis it lies.

    Args:
        intrinsics, extrinsics: (C, 3, 3) and (C, 4, 4) of one frame, float64.
        order: from `ranks`.
        image_size: (H, W), pixels.
        grid: whose cells are looked for.
        sampling: how finely.
    """
    points = _points(grid, sampling).to(intrinsics.device)
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
    pieces = seen.view(-1, sampling.points**2)
    pixel, weight, counts = _merged(pixel, weight, pieces, len(order) * height * width)
    # Numbers up to a few pixels per ground point: int32 holds them and is half as much to read.
    return GroundIndex(
        pixel=pixel.int(),
        weight=weight.float(),
        offsets=(counts.cumsum(0) - counts).int(),
        seen=pieces.view(-1, (sampling.pieces * sampling.points) ** 2).float().mean(1, keepdim=True),
    )


def _points(grid: Grid, sampling: Sampling) -> Tensor:
    """The ground points (V * pieces^2 * points^2, 2), a piece's next to each other, as a cell's pieces are."""
    pieces, points = sampling
    centres = grid.centres(pieces * points).view(grid.rows, pieces, points, grid.columns, pieces, points, 2)
    return centres.permute(0, 3, 1, 4, 2, 5, 6).reshape(-1, 2)


def _merged(pixel: Tensor, weight: Tensor, pieces: Tensor, pixels: int) -> tuple[Tensor, Tensor, Tensor]:
    """The mean over each piece's points that are seen, each pixel of it told once.

    Args:
        pixel, weight: (S * points, 4).
        pieces: (S, points), whether a point is seen.
        pixels: how many there are.

    Returns:
        pixel and weight (M,) by piece, and how many of them each piece has (S,).
    """
    piece = torch.arange(len(pieces), device=pixel.device)[:, None, None].expand(*pieces.shape, 4)
    share = weight.view(*pieces.shape, 4) / pieces.sum(1).clamp(min=1)[:, None, None]
    keys, place = torch.unique((piece * pixels + pixel.view(*pieces.shape, 4))[pieces].flatten(), return_inverse=True)
    merged = share.new_zeros(len(keys)).index_add_(0, place, share[pieces].flatten())
    return keys % pixels, merged, torch.bincount(keys // pixels, minlength=len(pieces))


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
        (N, V, 3 * pieces^2 + 1): the colours of each cell's pieces, and the share of its points that is seen.
    """
    weight = index.weight.to(pixels.dtype)
    points = [weighted_bags(frame, weight, index.pixel, index.offsets) for frame in pixels]
    cells = torch.cat([frame.view(1, len(index.seen), -1) for frame in points])
    return torch.cat([cells, index.seen.to(cells.dtype).expand(len(pixels), -1, -1)], dim=2)

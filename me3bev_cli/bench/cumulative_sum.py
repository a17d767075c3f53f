"""The splat as it was first published: lift every point, sort, sum cumulatively, subtract. The bench's yardstick.

Written from the formula (eqs. 9-10), for comparison only: it makes a tensor of N x C x D x h x w x channels, and its
running sums lose digits, so that tests run it in float64.
"""

from __future__ import annotations

import torch
from torch import Tensor


def cumulative_sum_splat(
    probability: Tensor, context: Tensor, cells: Tensor, count: int, order: Tensor | None = None
) -> Tensor:
    """Depth-weighted sum pooling by differences of a cumulative sum.

    Args:
        probability: (N, C, D, h, w), each pixel's distribution over depth.
        context: (N, C, channels, h, w).
        cells: (C, D, h, w), the flat cell of each point, -1 outside the grid.
        count: number of cells, V.
        order: for one frame, the points inside the grid by cell, where that is known before; None to sort at each
            call, as published.

    Returns:
        (N, V, channels), differentiable in both.
    """
    frames, channels = len(context), context.shape[2]
    lifted = probability.unsqueeze(2) * context.unsqueeze(3)
    points = lifted.permute(0, 1, 3, 4, 5, 2).reshape(-1, channels)
    shift = count * torch.arange(frames, device=cells.device)[:, None]
    cell = torch.where(cells.flatten() >= 0, cells.flatten() + shift, -1).flatten()
    if order is None:
        inside = cell >= 0
        points, cell = points[inside], cell[inside]
        order = cell.argsort()
    points, cell = points[order], cell[order]
    sums = points.cumsum(0)
    last = torch.ones_like(cell, dtype=torch.bool)
    last[:-1] = cell[1:] != cell[:-1]
    sums, cell = sums[last], cell[last]
    grid = context.new_zeros(frames * count, channels)
    grid[cell] = torch.cat([sums[:1], sums[1:] - sums[:-1]])
    return grid.view(frames, count, channels)

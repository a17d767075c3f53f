"""A grid that is stretched and pressed along its axes, so that widths are not learned by heart."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor


def stretched(grid: Tensor, places: Tensor) -> Tensor:
    """The grid with its rows and columns taken from elsewhere; nothing where that is outside.

    Args:
        grid: (N, channels, X, X).
        places: (N, 2, X') for rows and columns, from -1 to 1 across the grid; X' may be coarser than X.

    Returns:
        (N, channels, X, X).

    Raises:
        ValueError: the grid is not square or the places are not for it.
    """
    count, _, rows, columns = grid.shape
    if rows != columns or places.shape[:2] != (count, 2):
        raise ValueError(f"places of shape {tuple(places.shape)} for a grid of shape {tuple(grid.shape)}")
    if places.shape[2] != rows:
        places = F.interpolate(places, size=rows, mode="linear", align_corners=False)
    down, across = places.to(grid.dtype).unbind(1)
    whole = (count, rows, columns)
    at = torch.stack([across[:, None].expand(whole), down[:, :, None].expand(whole)], dim=-1)
    return F.grid_sample(grid, at, mode="bilinear", padding_mode="zeros", align_corners=False)

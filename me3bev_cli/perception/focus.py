"""Maps that were made of tokens, finer in the middle than outside, laid out evenly."""

from __future__ import annotations

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from me3bev_cli.api import TokenSpec

_FINE = 4096
"""Points from which the way back from a place to the token is read."""


def even_places(cells: int, tokens: TokenSpec) -> Tensor | None:
    """Where, in the grid of tokens, each cell of an even map lies: (cells, cells, 2), as `grid_sample` wants it.

    None where tokens are all of one size, and their grid is an even map.
    """
    if tokens.focus == 1:
        return None
    at = np.linspace(-1, 1, _FINE)
    centres = (np.arange(cells) + 0.5) * 2 / cells - 1
    axis = torch.from_numpy(np.interp(centres, tokens.place(at), at)).float()
    rows, columns = torch.meshgrid(axis, axis, indexing="ij")
    return torch.stack([columns, rows], dim=-1)


def laid_out_evenly(scores: Tensor, places: Tensor) -> Tensor:
    """Scores (N, K, X, X) over the grid of tokens, at the places (cells, cells, 2) of an even map."""
    at = places.to(scores.dtype).expand(len(scores), *places.shape)
    return F.grid_sample(scores, at, mode="bilinear", padding_mode="border", align_corners=False)

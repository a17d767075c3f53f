"""The segmentation head: from a spatial plugin's bird's-eye grid to class scores at 200 x 200."""

from __future__ import annotations

from typing import cast

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from me3bev_cli.api import BEV_CLASSES, TokenSpec
from me3bev_cli.perception.focus import even_places, laid_out_evenly
from me3bev_cli.perception.truth import CELLS


class SegmentationHead(nn.Module):
    """Grid (N, channels, X, Y) -> scores (N, 8, 200, 200).

    The scores of all the finer cells in a coarse one are made at once from what is around it; what is left to 200 is
    interpolated.

    Args:
        channels: of the grid.
        size: (X, Y) of the grid.
        width: channels between the two layers.
        tokens: what the grid is made of, if it is not even.
    """

    places: Tensor | None
    class_weights: Tensor
    """(8,), of the cross entropy by which it is learned."""

    def __init__(self, channels: int, size: tuple[int, int], width: int, tokens: TokenSpec | None = None) -> None:
        super().__init__()
        finer = max(1, CELLS // max(size))
        self.first = nn.Conv2d(channels, width, 3, padding=1)
        self.scores = nn.Conv2d(width, len(BEV_CLASSES) * finer**2, 3, padding=1)
        self.shuffle = nn.PixelShuffle(finer)
        self.register_buffer("class_weights", torch.ones(len(BEV_CLASSES)))
        places = None if tokens is None else even_places(CELLS, tokens)
        self.register_buffer("places", places, persistent=False)

    def forward(self, grid: Tensor) -> Tensor:
        """See the class."""
        scores = cast(Tensor, self.shuffle(self.scores(F.relu(self.first(grid), inplace=True))))
        if self.places is not None:
            return laid_out_evenly(scores, self.places)
        if scores.shape[-2:] == (CELLS, CELLS):
            return scores
        return F.interpolate(scores, size=(CELLS, CELLS), mode="bilinear", align_corners=False)

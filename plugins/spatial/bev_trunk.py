"""The residual trunk on the bird's-eye grid: a feature map and a small grid of tokens (h_BEV, eq. 4)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import cast

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from me3bev_cli.api import TokenSpec
from me3bev_plugins.spatial.blocks import Residual, conv

PATCH = 4
"""Samples per side of a token: it is a projection of where things are in it, which their mean would not tell."""


class BEVTrunk(nn.Module):
    """Strided early, since the grid has more cells than the images have feature cells.

    Args:
        inputs: channels of the grid.
        channels: widths at 1/2, 1/4 and 1/8 of the grid's resolution; the first is that of the feature map.
        blocks: residual blocks at 1/4 and 1/8, each.
        tokens: the token grid.
        stride: of the first layer; with 1 all resolutions are twice as fine.
    """

    places: Tensor | None

    def __init__(self, inputs: int, channels: Sequence[int], blocks: int, tokens: TokenSpec, stride: int = 2) -> None:
        super().__init__()
        half, quarter, eighth = channels
        self.stem = conv(inputs, half, 3, stride)
        self.quarter = _stage(half, quarter, blocks)
        self.eighth = _stage(quarter, eighth, blocks)
        self.tokens = tokens
        self.token = nn.Linear(half * PATCH**2, tokens.width)
        self.register_buffer("places", _places(tokens) if tokens.focus != 1 else None, persistent=False)
        self.down_quarter = nn.Conv2d(quarter, half, 1)
        self.down_eighth = nn.Conv2d(eighth, half, 1, bias=False)

    def forward(self, grid: Tensor) -> tuple[Tensor, Tensor]:
        """Grid (N, inputs, X, Y) -> tokens (N, K, D) and the feature map (N, channels[0], X / stride, ...)."""
        half = cast(Tensor, self.stem(grid))
        quarter = cast(Tensor, self.quarter(half))
        eighth = cast(Tensor, self.eighth(quarter))
        above = _grown(self.down_eighth(eighth), quarter) + cast(Tensor, self.down_quarter(quarter))
        patches = F.relu(self._sampled(above))
        # Not a strided convolution: on CPUs with AMX, oneDNN computes those of 16 or 24 channels wrongly in bf16.
        tokens = cast(Tensor, self.token(F.pixel_unshuffle(patches, PATCH).flatten(2).transpose(1, 2)))
        return tokens, half + _grown(above, half)

    def _sampled(self, above: Tensor) -> Tensor:
        """The samples of all tokens (N, half, PATCH * rows, PATCH * columns)."""
        if self.places is None:
            size = (PATCH * self.tokens.rows, PATCH * self.tokens.columns)
            return F.interpolate(above, size=size, mode="bilinear", align_corners=False)
        at = self.places.to(above.dtype).expand(len(above), *self.places.shape)
        return F.grid_sample(above, at, mode="bilinear", padding_mode="border", align_corners=False)


def _places(tokens: TokenSpec) -> Tensor:
    """Where the samples lie on the map: (rows, columns, 2), as `grid_sample` wants it."""
    down, across = (
        tokens.place((torch.arange(PATCH * count, dtype=torch.float64) + 0.5) * 2 / (PATCH * count) - 1).float()
        for count in (tokens.rows, tokens.columns)
    )
    return torch.stack(torch.meshgrid(down, across, indexing="ij")[::-1], dim=-1)


def _stage(inputs: int, outputs: int, blocks: int) -> nn.Sequential:
    return nn.Sequential(Residual(inputs, outputs, 2), *(Residual(outputs, outputs) for _ in range(blocks - 1)))


def _grown(x: Tensor, like: Tensor) -> Tensor:
    return F.interpolate(x, size=like.shape[-2:], mode="bilinear", align_corners=False)

"""The semantic decoder: S = Upsample(ResNet(Conv(u_BEV))) with shallow features concatenated (eq. 14)."""

from __future__ import annotations

from typing import NamedTuple, cast

import torch
from torch import Tensor, nn
from torch.nn.functional import interpolate

from me3bev_cli.api import BEV_CLASSES, TokenSpec
from me3bev_cli.decoding.resnet import resnet_stages
from me3bev_cli.perception.focus import even_places, laid_out_evenly

SIZE = 200
"""Cells per side of the semantic map."""
SPREAD = 50
"""Cells per side that a coarse latent is spread to, about: a token tells of all the finer cells in it at once."""
FACTOR = 8
"""By how much it is spread, at most."""
COARSE = 25
"""Cells per side at which the ResNet begins, about."""
LEAST = 24
"""What is still coarser is interpolated to as many."""
SHALLOW, WIDE, JOINED = 48, 64, 64
"""Channels of the shallow features, of what the ResNet reads, and between the two layers that score."""


class LatentSpec(NamedTuple):
    """What is decoded: `channels` numbers for each of `rows` x `columns` places."""

    channels: int
    rows: int
    columns: int
    focus: float = 1.0
    """As `TokenSpec.focus`."""


class SemanticDecoder(nn.Module):
    """A latent (N, channels, rows, columns) -> class scores (N, 8, 200, 200).

    Args:
        latent: what is decoded; a single vector is a grid of one place.
        pretrained: True for torchvision's ResNet-18, False for random weights, or a file of weights.

    Raises:
        UserError: the weights cannot be had.
    """

    places: Tensor | None
    class_weights: Tensor
    """(8,), of the cross entropy by which it is learned."""

    def __init__(self, latent: LatentSpec, pretrained: bool | str = False) -> None:
        super().__init__()
        self.latent = latent
        longest = max(latent.rows, latent.columns)
        factor = min(FACTOR, max(1, round(SPREAD / longest)))
        around = 3 if longest > 1 else 1
        self.conv = nn.Sequential(
            nn.Conv2d(latent.channels, WIDE * factor**2, around, padding=around // 2),
            nn.PixelShuffle(factor),
            nn.BatchNorm2d(WIDE),
            nn.ReLU(),
        )
        fine = factor * longest
        self.size = max(fine, LEAST)
        # What is around a place is read coarsely; what is at it comes by the shallow features.
        self.coarse = nn.MaxPool2d(max(1, round(self.size / COARSE)))
        self.shallow = nn.Sequential(nn.Conv2d(WIDE, SHALLOW, 1), nn.ReLU())
        self.resnet = resnet_stages(pretrained)
        self.deep = nn.Sequential(nn.Conv2d(256, WIDE, 1), nn.BatchNorm2d(WIDE), nn.ReLU())
        finer = max(1, SIZE // self.size)
        self.join = nn.Sequential(nn.Conv2d(WIDE + SHALLOW, JOINED, 3, padding=1), nn.BatchNorm2d(JOINED), nn.ReLU())
        self.scores = nn.Sequential(
            nn.Conv2d(JOINED, len(BEV_CLASSES) * finer**2, 3, padding=1), nn.PixelShuffle(finer)
        )

        self.register_buffer("class_weights", torch.ones(len(BEV_CLASSES)))
        tokens = TokenSpec(latent.rows, latent.columns, latent.channels, latent.focus)
        self.register_buffer("places", even_places(SIZE, tokens), persistent=False)

    def forward(self, latent: Tensor) -> Tensor:
        """See the class."""
        spread = self.conv(latent)
        if max(spread.shape[-2:]) < self.size:
            spread = interpolate(spread, size=(self.size, self.size), mode="bilinear")
        deep = self.deep(self.resnet(self.coarse(spread)))
        deep = interpolate(deep, size=spread.shape[-2:], mode="bilinear")
        scores = cast(Tensor, self.scores(self.join(torch.cat([deep, self.shallow(spread)], 1))))
        if self.places is not None:
            return laid_out_evenly(scores, self.places)
        if scores.shape[-2:] == (SIZE, SIZE):
            return scores
        return interpolate(scores, size=(SIZE, SIZE), mode="bilinear")

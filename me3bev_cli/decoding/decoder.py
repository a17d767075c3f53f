"""The semantic decoder: S = Upsample(ResNet(Conv(u_BEV))) with shallow features concatenated (eq. 14)."""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn.functional import interpolate
from torchvision.models import resnet18

from me3bev_cli.api import BEV_CLASSES, TokenSpec
from me3bev_cli.errors import UserError

SIZE = 200
"""Cells per side of the semantic map."""
COARSE = 25
"""Cells per side at which the ResNet works: three times finer than the tokens."""
SHALLOW = 64
"""Channels of the shallow features."""


class SemanticDecoder(nn.Module):
    """Latent tokens u_BEV (N, K, D) -> class scores (N, 8, 200, 200).

    Args:
        tokens: the token grid that is decoded.
        pretrained: False for random weights, or a file of ResNet-18 weights (a torchvision state dict).

    Raises:
        UserError: the weights file is missing or is not ResNet-18's.
    """

    def __init__(self, tokens: TokenSpec, pretrained: str | None = None) -> None:
        super().__init__()
        self.tokens = tokens
        trunk = resnet18(weights=None)
        if pretrained is not None:
            load_resnet(trunk, pretrained)
        self.conv = nn.Sequential(nn.Conv2d(tokens.width, SHALLOW, 3, padding=1), nn.BatchNorm2d(SHALLOW), nn.ReLU())
        self.deep = nn.Sequential(trunk.layer1, trunk.layer2, trunk.layer3)
        self.head = nn.Sequential(
            nn.Conv2d(256 + SHALLOW, 64, 3, padding=1),
            nn.BatchNorm2d(64),
            nn.ReLU(),
            nn.Upsample(scale_factor=4, mode="bilinear"),
            nn.Conv2d(64, 32, 3, padding=1),
            nn.BatchNorm2d(32),
            nn.ReLU(),
            nn.Conv2d(32, len(BEV_CLASSES), 1),
        )

    def forward(self, latent: Tensor) -> Tensor:
        """(N, K, D) -> (N, 8, 200, 200)."""
        grid = latent.transpose(1, 2).reshape(-1, self.tokens.width, self.tokens.rows, self.tokens.columns)
        shallow = self.conv(interpolate(grid, size=(COARSE, COARSE), mode="bilinear"))
        deep = interpolate(self.deep(shallow), size=shallow.shape[-2:], mode="bilinear")
        scores = self.head(torch.cat([deep, shallow], 1))
        return interpolate(scores, size=(SIZE, SIZE), mode="bilinear")


def load_resnet(trunk: nn.Module, path: str) -> None:
    """Fill a torchvision ResNet-18 from a file of weights.

    Raises:
        UserError: the file is missing, damaged or of another network.
    """
    try:
        trunk.load_state_dict(torch.load(path, map_location="cpu", weights_only=True))
    except Exception as error:  # torch.load raises many types for a file that is not its own
        raise UserError(
            f"'{path}' does not hold ResNet-18 weights ({type(error).__name__})",
            where="--pretrained",
            hint="Save torchvision's resnet18 state dict there, or leave the option out",
        ) from error

"""Convolution blocks that do not depend on the batch: group normalisation instead of batch statistics.

A driver acts on one frame and learns from hundreds; statistics of the batch would make the two networks differ.
"""

from __future__ import annotations

from typing import cast

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from me3bev_plugins.spatial.precision import unhalved


class GroupNorm(nn.GroupNorm):
    """As torch's, but what autocast has halved is normalised in single precision where gradients are wanted: on CPUs
    torch's backward pass takes three times as long in bf16 with channels innermost."""

    def forward(self, x: Tensor) -> Tensor:
        """(N, channels, ...) -> the same."""
        halved = x.dtype == torch.bfloat16 and self.weight.dtype == torch.float32
        if not (halved and x.device.type == "cpu" and torch.is_grad_enabled()):
            return super().forward(x)
        with unhalved(x.device):
            return super().forward(x.float())


def group_norm(channels: int) -> nn.GroupNorm:
    """Group normalisation with groups of at least 4 channels, at most 8 groups."""
    groups = next(g for g in (8, 4, 2, 1) if channels % g == 0 and (channels // g >= 4 or g == 1))
    return GroupNorm(groups, channels)


def conv(inputs: int, outputs: int, kernel: int = 3, stride: int = 1) -> nn.Sequential:
    """Convolution without bias, group norm, ReLU."""
    return nn.Sequential(
        nn.Conv2d(inputs, outputs, kernel, stride, kernel // 2, bias=False), group_norm(outputs), nn.ReLU(inplace=True)
    )


class Residual(nn.Module):
    """norm, convolution, ReLU, convolution beside a skip; (N, inputs, H, W) -> (N, outputs, H / stride, W / stride).

    One norm per block: on a CPU a second one costs as much as a third of the convolutions.
    """

    def __init__(self, inputs: int, outputs: int, stride: int = 1) -> None:
        super().__init__()
        self.norm = group_norm(inputs)
        self.first = nn.Conv2d(inputs, outputs, 3, stride, 1)
        self.second = nn.Conv2d(outputs, outputs, 3, 1, 1)
        same = inputs == outputs and stride == 1
        self.skip = nn.Identity() if same else nn.Conv2d(inputs, outputs, 1, stride, bias=False)

    def forward(self, x: Tensor) -> Tensor:
        """See the class."""
        inner = F.relu(cast(Tensor, self.first(self.norm(x))), inplace=True)
        return cast(Tensor, self.skip(x)) + cast(Tensor, self.second(inner))

"""Fusion by concatenation and one dense layer."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Literal

import torch
import torch.nn.functional as F
from pydantic import Field, PositiveInt
from torch import Tensor, nn

from me3bev_cli.api import PluginConfig

_ACTIVATIONS: dict[str, Callable[[Tensor], Tensor]] = {
    "relu": F.relu,
    "silu": F.silu,
    "gelu": F.gelu,
    "tanh": torch.tanh,
    "none": lambda x: x,
}


class Concat(nn.Module):
    """The modalities side by side, through a linear layer and an activation."""

    class Config(PluginConfig):
        """Settings of the dense layer."""

        width: PositiveInt = Field(default=512, description="width of the result")
        activation: Literal["relu", "silu", "gelu", "tanh", "none"] = Field(
            default="relu", description="applied to the dense layer's output"
        )

    def __init__(self, config: Config, widths: Mapping[str, int]) -> None:
        super().__init__()
        self.output_width(config, widths)
        self.names = tuple(widths)
        self.linear = nn.Linear(sum(widths.values()), config.width)
        self.activation = config.activation

    @classmethod
    def output_width(cls, config: Config, widths: Mapping[str, int]) -> int:
        """The configured width; any input widths fit.

        Raises:
            ValueError: when there is no modality.
        """
        if not widths:
            raise ValueError("there is nothing to join: no modality is given")
        return config.width

    def forward(self, features: Mapping[str, Tensor]) -> Tensor:
        """Each (B, D_m) -> (B, width)."""
        joined: Tensor = self.linear(torch.cat([features[name] for name in self.names], dim=-1))
        return _ACTIVATIONS[self.activation](joined)

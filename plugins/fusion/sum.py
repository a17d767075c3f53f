"""Fusion by adding, as in the paper (eq. 8)."""

from __future__ import annotations

from collections.abc import Mapping

from torch import Tensor, nn

from me3bev_cli.api import NoConfig


class Sum(nn.Module):
    """u = u_bev + u_vr + u_nav (eq. 8); the widths must agree."""

    Config = NoConfig

    def __init__(self, config: NoConfig, widths: Mapping[str, int]) -> None:
        super().__init__()
        self.output_width(config, widths)
        self.names = tuple(widths)

    @classmethod
    def output_width(cls, config: NoConfig, widths: Mapping[str, int]) -> int:
        """The width that the modalities share.

        Raises:
            ValueError: when the widths differ or there is no modality.
        """
        if not widths:
            raise ValueError("there is nothing to add: no modality is given")
        if len(set(widths.values())) > 1:
            listed = ", ".join(f"{name} {width}" for name, width in widths.items())
            raise ValueError(f"adding needs equal widths, but they are {listed}")
        return next(iter(widths.values()))

    def forward(self, features: Mapping[str, Tensor]) -> Tensor:
        """Each (B, D) -> (B, D)."""
        first, *others = self.names
        total = features[first]
        for name in others:
            total = total + features[name]
        return total

"""What the GRU and the LSTM share: settings, sizes, and one pass of a fused kernel over episodes inside a batch."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from pydantic import Field, PositiveInt
from torch import Tensor, nn

from me3bev_cli.api import PluginConfig
from me3bev_plugins.temporal.packing import cut, enter, leave, pack, unpack

Parts = tuple[Tensor, ...]
"""The memory's tensors, each (B, layers, hidden); on their way through a kernel (layers, sequences, hidden)."""


class RecurrentConfig(PluginConfig):
    """Settings of a stack of recurrent units."""

    layers: PositiveInt = Field(default=1, description="units stacked")
    hidden: PositiveInt | None = Field(
        default=None, description="numbers of memory; None: the width. Otherwise a linear layer leads back"
    )


class Recurrent(nn.Module):
    """The frame of a recurrent module over vectors of `width` numbers; the kernel is the heir's."""

    def __init__(self, config: RecurrentConfig, width: int) -> None:
        super().__init__()
        self.check(config, width)
        self.layers, self.hidden = config.layers, config.hidden or width
        self.out: nn.Module = nn.Identity() if self.hidden == width else nn.Linear(self.hidden, width)

    @classmethod
    def check(cls, config: RecurrentConfig, width: int) -> None:
        """Any positive width fits.

        Raises:
            ValueError: for a width below 1.
        """
        if width < 1:
            raise ValueError(f"width must be positive, not {width}")

    def zeros(self, batch: int) -> Tensor:
        """An empty part of the memory, (B, layers, hidden)."""
        return next(self.parameters()).new_zeros(batch, self.layers, self.hidden)

    def run(
        self, kernel: Callable[[Any, Parts], tuple[Any, Parts]], x: Tensor, parts: Parts, starts: Tensor
    ) -> tuple[Tensor, Parts]:
        """x (B, T, D), starts (B, T) bool -> y (B, T, D) and the memory after the last frame.

        Args:
            kernel: takes and gives a whole batch or a packed sequence.
        """
        if x.shape[1] > 1 and bool(starts[:, 1:].any()):
            segments = cut(starts)
            packed, last = kernel(pack(x, segments), tuple(enter(part, segments) for part in parts))
            return self.out(unpack(packed, segments, len(x))), tuple(leave(part, segments) for part in last)
        fresh = starts[:, 0, None, None]
        y, last = kernel(x, tuple(part.masked_fill(fresh, 0.0).transpose(0, 1).contiguous() for part in parts))
        return self.out(y), tuple(part.transpose(0, 1) for part in last)

"""A long short-term memory as temporal module, on torch's fused kernels."""

from __future__ import annotations

from pydantic import Field, PositiveInt
from torch import Tensor, nn

from me3bev_cli.api import PluginConfig
from me3bev_plugins.temporal.packing import cut, enter, leave, pack, unpack

Memory = tuple[Tensor, Tensor]


class LSTM(nn.Module):
    """`layers` long short-term memories over vectors of `width` numbers.

    State: the output and the cell, each (B, layers, hidden).
    """

    class Config(PluginConfig):
        """Settings of the LSTM."""

        layers: PositiveInt = Field(default=1, description="units stacked")
        hidden: PositiveInt | None = Field(
            default=None, description="numbers of memory; None: the width. Otherwise a linear layer leads back"
        )

    def __init__(self, config: Config, width: int) -> None:
        super().__init__()
        self.check(config, width)
        self.layers, self.hidden = config.layers, config.hidden or width
        self.lstm = nn.LSTM(width, self.hidden, config.layers, batch_first=True)
        self.out: nn.Module = nn.Identity() if self.hidden == width else nn.Linear(self.hidden, width)

    @classmethod
    def check(cls, config: Config, width: int) -> None:
        """Any positive width fits.

        Raises:
            ValueError: for a width below 1.
        """
        if width < 1:
            raise ValueError(f"width must be positive, not {width}")

    def initial_state(self, batch: int) -> Memory:
        """Zeros, twice (B, layers, hidden)."""
        zeros = next(self.lstm.parameters()).new_zeros(2, batch, self.layers, self.hidden)
        return zeros[0], zeros[1]

    def forward(self, x: Tensor, state: Memory, starts: Tensor) -> tuple[Tensor, Memory]:
        """x (B, T, D), starts (B, T) bool -> y (B, T, D) and the state after the last frame."""
        if x.shape[1] > 1 and bool(starts[:, 1:].any()):
            segments = cut(starts)
            packed, (h, c) = self.lstm(pack(x, segments), (enter(state[0], segments), enter(state[1], segments)))
            return self.out(unpack(packed, segments, len(x))), (leave(h, segments), leave(c, segments))
        fresh = starts[:, 0, None, None]
        h, c = (part.masked_fill(fresh, 0.0).transpose(0, 1).contiguous() for part in state)
        y, (h, c) = self.lstm(x, (h, c))
        return self.out(y), (h.transpose(0, 1), c.transpose(0, 1))

"""A long short-term memory as temporal module, on torch's fused kernels."""

from __future__ import annotations

from torch import Tensor, nn

from me3bev_plugins.temporal.recurrent import Parts, Recurrent, RecurrentConfig


class LSTM(Recurrent):
    """`layers` long short-term memories over vectors of `width` numbers.

    State: the output and the cell, each (B, layers, hidden).
    """

    Config = RecurrentConfig

    def __init__(self, config: RecurrentConfig, width: int) -> None:
        super().__init__(config, width)
        self.lstm = nn.LSTM(width, self.hidden, config.layers, batch_first=True)

    def initial_state(self, batch: int) -> Parts:
        """Zeros, twice (B, layers, hidden)."""
        return self.zeros(batch), self.zeros(batch)

    def forward(self, x: Tensor, state: Parts, starts: Tensor) -> tuple[Tensor, Parts]:
        """x (B, T, D), starts (B, T) bool -> y (B, T, D) and the state after the last frame."""
        return self.run(self.lstm, x, state, starts)

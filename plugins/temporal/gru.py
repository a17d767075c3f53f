"""A gated recurrent unit as temporal module, on torch's fused kernels."""

from __future__ import annotations

from typing import Any

from torch import Tensor, nn

from me3bev_plugins.temporal.recurrent import Parts, Recurrent, RecurrentConfig


class GRU(Recurrent):
    """`layers` gated recurrent units over vectors of `width` numbers.

    State: (B, layers, hidden).
    """

    Config = RecurrentConfig

    def __init__(self, config: RecurrentConfig, width: int) -> None:
        super().__init__(config, width)
        self.gru = nn.GRU(width, self.hidden, config.layers, batch_first=True)

    def initial_state(self, batch: int) -> Tensor:
        """Zeros (B, layers, hidden)."""
        return self.zeros(batch)

    def forward(self, x: Tensor, state: Tensor, starts: Tensor) -> tuple[Tensor, Tensor]:
        """x (B, T, D), starts (B, T) bool -> y (B, T, D) and the state after the last frame."""
        y, (last,) = self.run(self._kernel, x, (state,), starts)
        return y, last

    def _kernel(self, x: Any, parts: Parts) -> tuple[Any, Parts]:
        y, last = self.gru(x, *parts)
        return y, (last,)

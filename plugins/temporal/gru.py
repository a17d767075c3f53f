"""A gated recurrent unit as temporal module, on torch's fused kernels."""

from __future__ import annotations

from pydantic import Field, PositiveInt
from torch import Tensor, nn

from me3bev_cli.api import PluginConfig
from me3bev_plugins.temporal.packing import cut, enter, leave, pack, unpack


class GRU(nn.Module):
    """`layers` gated recurrent units over vectors of `width` numbers.

    State: (B, layers, hidden).
    """

    class Config(PluginConfig):
        """Settings of the GRU."""

        layers: PositiveInt = Field(default=1, description="units stacked")
        hidden: PositiveInt | None = Field(
            default=None, description="numbers of memory; None: the width. Otherwise a linear layer leads back"
        )

    def __init__(self, config: Config, width: int) -> None:
        super().__init__()
        self.check(config, width)
        self.layers, self.hidden = config.layers, config.hidden or width
        self.gru = nn.GRU(width, self.hidden, config.layers, batch_first=True)
        self.out: nn.Module = nn.Identity() if self.hidden == width else nn.Linear(self.hidden, width)

    @classmethod
    def check(cls, config: Config, width: int) -> None:
        """Any positive width fits.

        Raises:
            ValueError: for a width below 1.
        """
        if width < 1:
            raise ValueError(f"width must be positive, not {width}")

    def initial_state(self, batch: int) -> Tensor:
        """Zeros (B, layers, hidden)."""
        return next(self.gru.parameters()).new_zeros(batch, self.layers, self.hidden)

    def forward(self, x: Tensor, state: Tensor, starts: Tensor) -> tuple[Tensor, Tensor]:
        """x (B, T, D), starts (B, T) bool -> y (B, T, D) and the state after the last frame."""
        if x.shape[1] > 1 and bool(starts[:, 1:].any()):
            segments = cut(starts)
            packed, last = self.gru(pack(x, segments), enter(state, segments))
            return self.out(unpack(packed, segments, len(x))), leave(last, segments)
        state = state.masked_fill(starts[:, 0, None, None], 0.0)
        y, last = self.gru(x, state.transpose(0, 1).contiguous())
        return self.out(y), last.transpose(0, 1)

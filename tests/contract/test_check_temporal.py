"""A memory that breaks what a stored state needs is told which promise."""

from __future__ import annotations

from typing import Any

import pytest
import torch
from torch import Tensor, nn

from me3bev_cli import registry
from me3bev_cli.api import NoConfig, PluginConfig
from me3bev_cli.errors import PluginError
from me3bev_cli.testing import check_plugin


class Average(nn.Module):
    """A correct memory: m = m / 2 + x / 2, y = w m; the fakes below each break one thing."""

    Config = NoConfig

    def __init__(self, config: PluginConfig, width: int) -> None:
        super().__init__()
        self.width = width
        self.weight = nn.Parameter(torch.randn(width))

    @classmethod
    def check(cls, config: PluginConfig, width: int) -> None:
        """Any width."""

    def initial_state(self, batch: int) -> Any:
        return {"mean": self.weight.new_zeros(batch, self.width)}

    def forward(self, x: Tensor, state: Any, starts: Tensor) -> tuple[Tensor, Any]:
        mean, ys = state["mean"], []
        for t in range(x.shape[1]):
            mean = (mean.masked_fill(starts[:, t, None], 0.0) + x[:, t]) / 2
            ys.append(self.weight * mean)
        return torch.stack(ys, 1), {"mean": mean}


class WritesInPlace(Average):
    """Without gradients it spares itself an allocation."""

    def forward(self, x: Tensor, state: Any, starts: Tensor) -> tuple[Tensor, Any]:
        y, after = super().forward(x, state, starts)
        if x.shape[1] == 1 and not torch.is_grad_enabled():
            after = {"mean": state["mean"].copy_(after["mean"])}
        return y, after


class Grows(Average):
    """Keeps what it does not need, so the state's form changes."""

    def initial_state(self, batch: int) -> Any:
        return super().initial_state(batch) | {"frames": self.weight.new_zeros(batch, 0, self.width)}

    def forward(self, x: Tensor, state: Any, starts: Tensor) -> tuple[Tensor, Any]:
        y, after = super().forward(x, state, starts)
        return y, after | {"frames": torch.cat([state["frames"], x], 1)}


class HalfPrecision(Average):
    def forward(self, x: Tensor, state: Any, starts: Tensor) -> tuple[Tensor, Any]:
        y, after = super().forward(x.float(), {"mean": state["mean"].float()}, starts)
        return y.float(), after


class BreaksInLargeBatches(Average):
    """A kernel that is wrong for more rows than its author tried."""

    def forward(self, x: Tensor, state: Any, starts: Tensor) -> tuple[Tensor, Any]:
        y, after = super().forward(x, state, starts)
        return (y * 2 if len(x) > 20 else y), after


def test_a_correct_memory_passes() -> None:
    check_plugin("temporal", Average)


@pytest.mark.parametrize(
    ("name", "keys"),
    [
        ("mamba", {"backend": "torch"}),
        ("mamba", {"backend": "native", "d_state": 5, "d_conv": 2}),
        ("gru", {"layers": 2, "hidden": 20}),
        ("lstm", {"layers": 2}),
        ("transformer", {"context": 3}),
        ("transformer", {"context": 1}),
    ],
)
def test_built_in_memories_keep_the_contract_in_other_sizes_too(name: str, keys: dict[str, Any]) -> None:
    check_plugin("temporal", registry.load("temporal", name), keys, width=24)


@pytest.mark.parametrize(
    ("cls", "promise"),
    [
        (WritesInPlace, "a call leaves its input and the given state as they were"),
        (Grows, "the state keeps its form"),
        (HalfPrecision, "float64 in, float64 out. Seen: y is torch.float32"),
        (BreaksInLargeBatches, "windows of 4 equal each window alone"),
    ],
)
def test_a_broken_memory_is_told_what_it_breaks(cls: type, promise: str) -> None:
    with pytest.raises(PluginError) as caught:
        check_plugin("temporal", cls)
    assert promise in str(caught.value)

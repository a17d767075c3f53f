"""A memory that keeps its contract passes, and one that breaks a promise is told which."""

from __future__ import annotations

from typing import Any

import pytest
import torch
from pydantic import BaseModel, ConfigDict
from torch import Tensor, nn

from me3bev_cli.api import NoConfig, PluginConfig
from me3bev_cli.errors import PluginError
from me3bev_cli.testing import check_plugin


class Decay(nn.Module):
    """A correct memory: m = rate * m + x, y = w m; the fakes below each break one thing."""

    Config = NoConfig

    def __init__(self, config: PluginConfig, width: int) -> None:
        super().__init__()
        self.width = width
        self.rate = nn.Parameter(torch.full((width,), 0.5))
        self.weight = nn.Parameter(torch.randn(width))

    @classmethod
    def check(cls, config: PluginConfig, width: int) -> None:
        """Any width."""

    def initial_state(self, batch: int) -> Any:
        return (self.rate.new_zeros(batch, self.width),)

    def forward(self, x: Tensor, state: Any, starts: Tensor) -> tuple[Tensor, Any]:
        (memory,) = state
        ys = []
        for t in range(x.shape[1]):
            memory = self.rate * self.cleared(memory, starts[:, t]) + x[:, t]
            ys.append(self.weight * memory)
        return torch.stack(ys, 1), (memory,)

    def cleared(self, memory: Tensor, start: Tensor) -> Tensor:
        return memory.masked_fill(start[:, None], 0.0)


class NeverClears(Decay):
    def cleared(self, memory: Tensor, start: Tensor) -> Tensor:
        return memory


class ClearsFirstOnly(Decay):
    """Looks at the start of a call only, as many recurrent policies do."""

    def forward(self, x: Tensor, state: Any, starts: Tensor) -> tuple[Tensor, Any]:
        return super().forward(x, state, starts & (torch.arange(x.shape[1]) == 0))


class DropsState(Decay):
    def forward(self, x: Tensor, state: Any, starts: Tensor) -> tuple[Tensor, Any]:
        return super().forward(x, self.initial_state(len(x)), starts)


class DetachesState(Decay):
    def forward(self, x: Tensor, state: Any, starts: Tensor) -> tuple[Tensor, Any]:
        return super().forward(x, (state[0].detach(),), starts)


class LooksAhead(Decay):
    def forward(self, x: Tensor, state: Any, starts: Tensor) -> tuple[Tensor, Any]:
        y, state = super().forward(x, state, starts)
        return y + x.flip(1).cumsum(1).flip(1), state


class MixesRows(Decay):
    def forward(self, x: Tensor, state: Any, starts: Tensor) -> tuple[Tensor, Any]:
        y, state = super().forward(x, state, starts)
        return y + x.mean(0, keepdim=True), state


class LayersFirst(Decay):
    def initial_state(self, batch: int) -> Any:
        return (self.rate.new_zeros(1, batch, self.width),)

    def forward(self, x: Tensor, state: Any, starts: Tensor) -> tuple[Tensor, Any]:
        y, (memory,) = super().forward(x, (state[0][0],), starts)
        return y, (memory[None],)


class StaysOnCpu(Decay):
    def initial_state(self, batch: int) -> Any:
        return (torch.zeros(batch, self.width),)


class ObjectState(Decay):
    def initial_state(self, batch: int) -> Any:
        return {"memory": (self.rate.new_zeros(batch, self.width), "text")}

    def forward(self, x: Tensor, state: Any, starts: Tensor) -> tuple[Tensor, Any]:
        y, (memory,) = super().forward(x, (state["memory"][0],), starts)
        return y, {"memory": (memory, "text")}


class DeadParameter(Decay):
    def __init__(self, config: PluginConfig, width: int) -> None:
        super().__init__(config, width)
        self.unused = nn.Parameter(torch.zeros(1))


class DropsOut(Decay):
    def forward(self, x: Tensor, state: Any, starts: Tensor) -> tuple[Tensor, Any]:
        y, state = super().forward(x, state, starts)
        return nn.functional.dropout(y, 0.5, self.training), state


class Unsaved(Decay):
    """Holds a random weight outside its state_dict."""

    def __init__(self, config: PluginConfig, width: int) -> None:
        super().__init__(config, width)
        self.hidden = torch.randn(width)

    def forward(self, x: Tensor, state: Any, starts: Tensor) -> tuple[Tensor, Any]:
        y, state = super().forward(x, state, starts)
        return y * self.hidden, state


class Loose(Decay):
    class Config(PluginConfig):
        model_config = ConfigDict(extra="ignore")


class Foreign(Decay):
    class Config(BaseModel):  # type: ignore[assignment]
        """Not one of ours."""


class NoCheck(Decay):
    check = None  # type: ignore[assignment]


def test_a_correct_memory_passes() -> None:
    check_plugin("temporal", Decay)


@pytest.mark.parametrize(
    ("cls", "promise"),
    [
        (NeverClears, "a start clears the memory inside a sequence"),
        (ClearsFirstOnly, "a sequence frame by frame equals the whole"),
        (DropsState, "a sequence frame by frame equals the whole"),
        (DetachesState, "a sequence frame by frame equals the whole. Seen: gradient"),
        (LooksAhead, "a sequence frame by frame equals the whole"),
        (MixesRows, "sequences are independent of each other"),
        (LayersFirst, "the state has the batch as first axis"),
        (StaysOnCpu, "the state follows the module across devices"),
        (ObjectState, "a plain tree of tensors"),
        (DeadParameter, "gradients flow to every parameter. Seen: none to unused"),
        (DropsOut, "the same input gives the same output"),
        (Unsaved, "a module with a loaded state_dict computes the same"),
        (Loose, "`Config` refuses unknown keys"),
        (Foreign, "`Config` is a subclass of me3bev_cli.api.PluginConfig"),
        (NoCheck, "there is a method `check`"),
    ],
)
def test_a_broken_memory_is_told_what_it_breaks(cls: type, promise: str) -> None:
    with pytest.raises(PluginError) as caught:
        check_plugin("temporal", cls)
    assert f"{cls.__name__} breaks its contract" in str(caught.value)
    assert promise in str(caught.value)

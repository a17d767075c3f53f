"""GRU and LSTM against their equations, frame by frame in float64, with starts at any place."""

from __future__ import annotations

from typing import Any

import pytest
import torch
from torch import Tensor

from me3bev_plugins.temporal.gru import GRU
from me3bev_plugins.temporal.lstm import LSTM
from me3bev_plugins.temporal.packing import cut, pack, unpack


def gru_step(weights: list[Tensor], x: Tensor, h: Tensor) -> Tensor:
    w_in, w_h, b_in, b_h = weights
    r_in, z_in, n_in = (w_in @ x + b_in).chunk(3)
    r_h, z_h, n_h = (w_h @ h + b_h).chunk(3)
    reset, update = torch.sigmoid(r_in + r_h), torch.sigmoid(z_in + z_h)
    return (1 - update) * torch.tanh(n_in + reset * n_h) + update * h


def lstm_step(weights: list[Tensor], x: Tensor, h: Tensor, c: Tensor) -> tuple[Tensor, Tensor]:
    w_in, w_h, b_in, b_h = weights
    i, f, g, o = (w_in @ x + b_in + w_h @ h + b_h).chunk(4)
    c = torch.sigmoid(f) * c + torch.sigmoid(i) * torch.tanh(g)
    return torch.sigmoid(o) * torch.tanh(c), c


def reference(module: Any, x: Tensor, state: list[Tensor], starts: Tensor) -> tuple[Tensor, list[Tensor]]:
    """y (B, T, D) and the final parts of the state, each (B, layers, hidden)."""
    cell = module.gru if isinstance(module, GRU) else module.lstm
    weights = [[getattr(cell, f"{name}_l{k}") for name in ("weight_ih", "weight_hh", "bias_ih", "bias_hh")]
               for k in range(module.layers)]  # fmt: skip
    rows, finals = [], []
    for b in range(len(x)):
        parts = [[part[b, k] for part in state] for k in range(module.layers)]
        ys = []
        for t in range(x.shape[1]):
            value = x[b, t]
            for k in range(module.layers):
                old = [torch.zeros_like(p) for p in parts[k]] if starts[b, t] else parts[k]
                if isinstance(module, GRU):
                    parts[k] = [gru_step(weights[k], value, old[0])]
                else:
                    parts[k] = list(lstm_step(weights[k], value, old[0], old[1]))
                value = parts[k][0]
            ys.append(module.out(value))
        rows.append(torch.stack(ys))
        finals.append(parts)
    last = [torch.stack([torch.stack([p[k][i] for k in range(module.layers)]) for p in finals])
            for i in range(len(state))]  # fmt: skip
    return torch.stack(rows), last


@pytest.mark.parametrize("cls", [GRU, LSTM])
@pytest.mark.parametrize(("share", "keys"), [(0.0, {}), (0.3, {}), (1.0, {}), (0.3, {"layers": 2, "hidden": 7})])
def test_outputs_and_gradients_equal_the_equations(cls: Any, share: float, keys: dict[str, int]) -> None:
    torch.manual_seed(3)
    module = cls(cls.Config(**keys), 5).double()
    starts = torch.rand(4, 9) < share
    x = torch.randn(4, 9, 5, dtype=torch.float64, requires_grad=True)
    empty = module.initial_state(4)
    parts = [empty] if cls is GRU else list(empty)
    parts = [torch.randn_like(part).requires_grad_() for part in parts]
    y, last = module(x, parts[0] if cls is GRU else tuple(parts), starts)
    given = [y, *([last] if cls is GRU else last)]
    expected_y, expected_last = reference(module, x, parts, starts)
    wanted = [x, *parts, *module.parameters()]
    grads = []
    for outputs in (given, [expected_y, *expected_last]):
        torch.manual_seed(4)
        loss = sum((out * torch.randn(out.shape, dtype=out.dtype)).sum() for out in outputs)
        grads.append(torch.autograd.grad(loss, wanted, allow_unused=True, materialize_grads=True))
    for ours, theirs in zip([*given, *grads[0]], [expected_y, *expected_last, *grads[1]], strict=True):
        torch.testing.assert_close(ours, theirs, rtol=1e-9, atol=1e-10)


@pytest.mark.parametrize("cls", [GRU, LSTM])
@pytest.mark.parametrize("share", [0.0, 0.1, 0.5, 1.0])
def test_the_fused_kernel_runs_once_however_dense_the_starts_are(cls: Any, share: float) -> None:
    module = cls(cls.Config(), 6)
    calls: list[int] = []
    kernel = module.gru if cls is GRU else module.lstm
    kernel.register_forward_hook(lambda *_: calls.append(1))
    module(torch.randn(3, 40, 6), module.initial_state(3), torch.rand(3, 40) < share)
    assert calls == [1]


@pytest.mark.parametrize("cls", [GRU, LSTM])
def test_streaming_with_dense_starts_equals_the_sequence(cls: Any) -> None:
    torch.manual_seed(2)
    module = cls(cls.Config(layers=2), 6)
    x, starts = torch.randn(3, 30, 6), torch.rand(3, 30) < 0.7
    expected, _ = module(x, module.initial_state(3), starts)
    state, ys = module.initial_state(3), []
    for t in range(30):
        y, state = module(x[:, t : t + 1], state, starts[:, t : t + 1])
        ys.append(y)
    torch.testing.assert_close(torch.cat(ys, 1), expected, rtol=1e-5, atol=1e-6)


def test_segments_by_hand() -> None:
    """Rows 0001 and 0101 hold the segments 000, 1 and 0, 10, 1: lengths 3, 1, 1, 2, 1."""
    starts = torch.tensor([[0, 0, 0, 1], [0, 1, 0, 1]], dtype=torch.bool)
    segments = cut(starts)
    assert segments.sizes.tolist() == [5, 2, 1]
    assert segments.row.tolist() == [0, 1, 0, 1, 1]
    assert segments.fresh.tolist() == [False, True, True, False, True]
    assert segments.last.tolist() == [2, 4]
    frames = torch.arange(8.0).view(2, 4, 1)
    packed = pack(frames, segments)
    assert packed.data.flatten().tolist() == [0, 5, 3, 4, 7, 1, 6, 2]
    assert torch.equal(unpack(packed, segments, 2), frames)

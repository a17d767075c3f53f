"""The transformer against attention written out frame by frame, with explicit angles between positions."""

from __future__ import annotations

import math
from typing import Any

import pytest
import torch
from torch import Tensor
from torch.utils.flop_counter import FlopCounterMode

from me3bev_plugins.temporal.rotary import rotate, rotation
from me3bev_plugins.temporal.transformer import Transformer


def angle(distance: int, half: int, base: float) -> Tensor:
    return distance * base ** (-torch.arange(half, dtype=torch.float64) / half)


def score(query: Tensor, key: Tensor, distance: int, base: float) -> Tensor:
    """The product of two vectors of which the first is turned by the angle of their distance, over sqrt(width)."""
    half = len(query) // 2
    turn = angle(distance, half, base)
    q, k = torch.complex(query[:half], query[half:]), torch.complex(key[:half], key[half:])
    turned = q * torch.complex(turn.cos(), turn.sin())
    return (turned * k.conj()).real.sum() / math.sqrt(len(query))


def reference(module: Transformer, x: Tensor, starts: Tensor) -> Tensor:
    """Every frame looks at those of the last `context` that belong to its episode; (B, T, D)."""
    config = module.config
    episode = starts.cumsum(1)
    for block in module.blocks:
        b: Any = block
        queries, keys, values = b.query_key_value(b.attention_norm(x)).chunk(3, dim=-1)
        out = torch.zeros_like(x)
        for row in range(len(x)):
            for t in range(x.shape[1]):
                past = [s for s in range(max(0, t - config.context + 1), t + 1) if episode[row, s] == episode[row, t]]
                parts = []
                for head in torch.arange(module.width).chunk(config.heads):
                    scores = [score(queries[row, t, head], keys[row, s, head], t - s, config.base) for s in past]
                    weights = torch.stack(scores).softmax(0)
                    parts.append(weights @ torch.stack([values[row, s, head] for s in past]))
                out[row, t] = torch.cat(parts)
        x = x + b.attention_out(out)
        x = x + b.feed(x)
    result: Tensor = module.norm(x)
    return result


@pytest.mark.parametrize("context", [1, 3, 20])
def test_outputs_and_gradients_equal_naive_attention(context: int) -> None:
    torch.manual_seed(0)
    module = Transformer(Transformer.Config(layers=2, heads=2, context=context), 8).double()
    x = torch.randn(2, 9, 8, dtype=torch.float64, requires_grad=True)
    starts = torch.rand(2, 9) < 0.2
    y, _ = module(x, module.initial_state(2), starts)
    expected = reference(module, x, starts)
    torch.testing.assert_close(y, expected, rtol=1e-6, atol=1e-7)
    weights = torch.randn_like(y)
    wanted = [x, *module.parameters()]
    ours = torch.autograd.grad((y * weights).sum(), wanted)
    theirs = torch.autograd.grad((expected * weights).sum(), wanted)
    for given, right in zip(ours, theirs, strict=True):
        torch.testing.assert_close(given, right, rtol=1e-5, atol=1e-6)


def test_streaming_slides_far_beyond_the_context() -> None:
    """After many more frames than the cache holds, each step is still the same as over the whole sequence."""
    torch.manual_seed(1)
    module = Transformer(Transformer.Config(layers=2, heads=2, context=8), 8).double()
    x, starts = torch.randn(2, 100, 8, dtype=torch.float64), torch.zeros(2, 100, dtype=torch.bool)
    starts[1, 77] = True
    expected = reference(module, x, starts)
    state, ys = module.initial_state(2), []
    for t in range(100):
        y, state = module(x[:, t : t + 1], state, starts[:, t : t + 1])
        ys.append(y)
        assert state["keys"].shape == (2, 2, 7, 8)
    torch.testing.assert_close(torch.cat(ys, 1), expected, rtol=1e-6, atol=1e-7)
    assert state["count"].tolist() == [7, 7]


def test_the_cost_of_a_step_is_bounded_by_the_context() -> None:
    module = Transformer(Transformer.Config(heads=2, context=8), 8)
    x, none, state = torch.randn(1, 1, 8), torch.zeros(1, 1, dtype=torch.bool), module.initial_state(1)
    costs = []
    for _ in range(40):
        with torch.no_grad(), FlopCounterMode(display=False) as counter:
            _, state = module(x, state, none)
        costs.append(counter.get_total_flops())
    assert costs[7:] == [costs[7]] * 33
    assert max(costs) == costs[7]


def test_a_frame_beyond_the_context_is_forgotten() -> None:
    module = Transformer(Transformer.Config(heads=2, context=4), 8)
    x = torch.randn(1, 6, 8, requires_grad=True)
    y, _ = module(x, module.initial_state(1), torch.zeros(1, 6, dtype=torch.bool))
    (grad,) = torch.autograd.grad(y[0, 5].square().sum(), x)
    assert [bool(g.abs().max() > 0) for g in grad[0]] == [False, False, True, True, True, True]


def test_rotation_depends_on_distance_alone() -> None:
    query, key = torch.randn(2, 1, 6, dtype=torch.float64)
    products = []
    for first in (0, 5):
        cosine, sine = rotation(torch.tensor([first, first + 3]), 6, 10000.0)
        products.append(rotate(query, cosine[1:], sine[1:]) @ rotate(key, cosine[:1], sine[:1]).T)
    torch.testing.assert_close(products[0], products[1], rtol=1e-5, atol=1e-6)


def test_a_width_that_does_not_divide_is_refused() -> None:
    with pytest.raises(ValueError, match="4 heads with rotary positions need a multiple of 8 as width, not 12"):
        Transformer.check(Transformer.Config(heads=4), 12)

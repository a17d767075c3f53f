"""What a stage costs, against numbers worked out by hand."""

from __future__ import annotations

import pytest
import torch
from torch import nn

from me3bev_cli.bench.flops import Counter, cost, nbytes


def test_a_linear_layer() -> None:
    layer, x = nn.Linear(5, 7), torch.randn(3, 5)
    y, found = cost(layer, [x], [layer])
    torch.testing.assert_close(y, layer(x))
    assert found.flops == 2 * 3 * 5 * 7
    assert found.parameters == 5 * 7 + 7
    assert found.read_bytes == 4 * (5 * 7 + 7) + 4 * 3 * 5
    assert found.peak_bytes == 4 * 3 * 7


@pytest.mark.parametrize(("kind", "gates"), [(nn.GRU, 3), (nn.LSTM, 4)])
@pytest.mark.parametrize("frames", [1, 6])
def test_recurrent_layers(kind: type[nn.RNNBase], gates: int, frames: int) -> None:
    """Per frame the input's and the state's weights once each, whether torch fuses them or not."""
    layer = kind(8, 16, batch_first=True)
    with torch.no_grad():
        _, found = cost(layer, [torch.randn(2, frames, 8)], [layer])
    assert found.flops == 2 * 2 * frames * gates * 16 * (8 + 16)


def test_a_convolution_and_attention() -> None:
    conv = nn.Conv2d(3, 4, 3, bias=False)
    assert cost(conv, [torch.randn(2, 3, 10, 12)], [conv])[1].flops == 2 * 2 * 4 * 8 * 10 * 3 * 9
    q, k = torch.randn(2, 4, 5, 8), torch.randn(2, 4, 9, 8)
    _, found = cost(nn.functional.scaled_dot_product_attention, [q, k, k], [])
    assert found.flops == 2 * 2 * (2 * 4 * 5 * 9 * 8)


def test_weighted_sums_over_an_index() -> None:
    table, rows, offsets = torch.randn(10, 6), torch.tensor([1, 2, 2, 9]), torch.tensor([0, 3])

    def pool(table: torch.Tensor, weights: torch.Tensor) -> torch.Tensor:
        return nn.functional.embedding_bag(rows, table, offsets, mode="sum", per_sample_weights=weights)

    assert cost(pool, [table, torch.rand(4)], [])[1].flops == 2 * 4 * 6


def test_shared_weights_count_once() -> None:
    layer = nn.Linear(4, 4)
    assert cost(layer, [torch.randn(1, 4)], [nn.Sequential(layer, layer), layer, None])[1].parameters == 20


def test_the_most_that_is_alive_at_once() -> None:
    """1000 numbers are made, views of them cost nothing; 2000 are alive together, then 1000 go and 500 come."""
    given = torch.ones(1000)
    with Counter() as live:
        a = given + 1
        b = a.view(10, 100).T[2:5]
        given.mul_(2)
        c = a * 2
        del a, b
        d = c[:500] + 1
    assert live.peak == 4 * 2000
    assert live.now == 4 * 1500
    del c, d
    assert live.now == 0


def test_bytes_of_a_tree() -> None:
    assert nbytes({"a": torch.zeros(3), "b": (torch.zeros(2, dtype=torch.bool), None, "x")}) == 14

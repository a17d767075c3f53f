"""The losses of perception against hand-worked numbers and naive loops."""

from __future__ import annotations

import math

import pytest
import torch

from me3bev_cli.perception.losses import balanced_weights, cell_weights, depth_loss, likeliest, segmentation_losses


def naive(scores: torch.Tensor, truth: torch.Tensor, classes: torch.Tensor, cells: torch.Tensor) -> tuple[float, float]:
    """Cell by cell."""
    n, k, x, y = scores.shape
    total = weight = 0.0
    hit, given, wanted = [0.0] * k, [0.0] * k, [0.0] * k
    for i in range(n):
        for r in range(x):
            for c in range(y):
                powers = [math.exp(float(value)) for value in scores[i, :, r, c]]
                share = [power / sum(powers) for power in powers]
                own, w = int(truth[i, r, c]), float(cells[i, r, c])
                total -= float(classes[own]) * w * math.log(share[own])
                weight += float(classes[own]) * w
                hit[own] += w * share[own]
                wanted[own] += w
                given = [g + w * s for g, s in zip(given, share, strict=True)]
    overlaps = [(2 * h + 1) / (g + w + 1) for h, g, w in zip(hit, given, wanted, strict=True) if w > 0]
    return total / weight, 1 - sum(overlaps) / len(overlaps)


def test_segmentation_losses_are_those_of_a_loop() -> None:
    generator = torch.Generator().manual_seed(0)
    scores = torch.randn(2, 4, 5, 6, generator=generator, dtype=torch.float64)
    truth = torch.randint(0, 3, (2, 5, 6), generator=generator)  # the last class is not there
    cells = torch.rand(2, 5, 6, generator=generator, dtype=torch.float64)
    classes = torch.tensor([0.5, 1.0, 3.0, 9.0], dtype=torch.float64)
    found = segmentation_losses(scores, truth, classes, cells)
    assert [float(loss) for loss in found] == pytest.approx(naive(scores, truth, classes, cells), rel=1e-12)


def test_losses_of_two_cells_by_hand() -> None:
    """Shares 3/4 and 1/4 in one cell, 1/2 each in the other; both are of the first class."""
    scores = torch.tensor([[[[math.log(3.0), 0.0]], [[0.0, 0.0]]]], dtype=torch.float64)
    truth = torch.zeros(1, 1, 2, dtype=torch.long)
    entropy, dice = segmentation_losses(scores, truth, torch.ones(2).double(), torch.ones(1, 1, 2).double())
    assert float(entropy) == pytest.approx(-(math.log(0.75) + math.log(0.5)) / 2)
    assert float(dice) == pytest.approx(1 - (2 * 1.25 + 1) / (1.25 + 2 + 1))


def test_depth_is_judged_where_it_lies_in_the_bins() -> None:
    """Three feature cells: all pixels in the first bin; half in each of two; none in any."""
    logits = torch.log(torch.tensor([[0.5, 0.25, 0.25], [0.5, 0.25, 0.25], [0.9, 0.05, 0.05]])).T.double()
    shares = torch.tensor([[1.0, 0.0, 0.0], [0.0, 0.5, 0.5], [0.0, 0.0, 0.0]]).T.double()
    found = depth_loss(logits[None, None, :, None], shares[None, None, :, None])
    assert float(found) == pytest.approx((math.log(2) + math.log(4)) / 2)


def test_rare_classes_weigh_more_and_the_mean_over_cells_is_one() -> None:
    weights = balanced_weights(torch.tensor([90, 10, 0]), 0.5)
    assert float(weights[1] / weights[0]) == pytest.approx(3.0)
    assert float(0.9 * weights[0] + 0.1 * weights[1]) == pytest.approx(1.0)
    assert weights[2] == weights[1]
    assert balanced_weights(torch.tensor([90, 10]), 0.0).tolist() == [1.0, 1.0]


def test_far_cells_out_of_sight_count_less() -> None:
    seen = torch.zeros(1, 6, 6, dtype=torch.bool)
    seen[0, 0, 0] = True
    weights = cell_weights(seen, 0.25, slice(2, 4))
    assert weights[0, 0].tolist() == [1.0, *[0.25] * 5]
    assert weights[0, 2].tolist() == [0.25, 0.25, 1.0, 1.0, 0.25, 0.25]
    assert not seen[0, 2, 2]


def test_weights_that_were_learned_with_are_taken_back() -> None:
    """Learned with weights w, the softmax of a cell is p w / sum(p w) where p is what is really likely."""
    likely = torch.tensor([0.5, 0.3, 0.2], dtype=torch.float64)
    weights = torch.tensor([0.5, 1.0, 4.0], dtype=torch.float64)
    learned = (likely * weights / (likely * weights).sum()).log()[None, :, None, None]
    assert learned.argmax(1).item() == 2
    assert likeliest(learned, weights).item() == 0

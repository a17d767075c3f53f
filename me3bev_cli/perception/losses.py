"""Losses of segmentation and depth. N frames, K classes, X x Y cells."""

from __future__ import annotations

import torch
from torch import Tensor


def segmentation_losses(
    scores: Tensor, truth: Tensor, class_weights: Tensor, cell_weights: Tensor
) -> tuple[Tensor, Tensor]:
    """Class-balanced cross entropy, the mean over cells by weight; and the Dice loss, over the whole minibatch.

    The latter is 1 - the soft overlap 2 |A and B| / (|A| + |B|), averaged over the classes that the minibatch holds.

    Args:
        scores: (N, K, X, Y), before the softmax.
        truth: (N, X, Y) int64.
        class_weights: (K,), of the cross entropy.
        cell_weights: (N, X, Y), how much a cell counts.
    """
    logs = scores.log_softmax(1)
    own = logs.gather(1, truth[:, None])[:, 0]
    weights = class_weights[truth] * cell_weights
    entropy = -(own * weights).sum() / weights.sum().clamp(min=1e-6)
    flat, classes = truth.flatten(), scores.shape[1]
    hit = own.new_zeros(classes).index_add(0, flat, (own.exp() * cell_weights).flatten())
    wanted = own.new_zeros(classes).index_add(0, flat, cell_weights.flatten())
    # A product of matrices, so that the weighted shares themselves are never made.
    given = (logs.exp().flatten(2) @ cell_weights.flatten(1)[:, :, None]).sum((0, 2))
    overlap = (2 * hit + 1) / (given + wanted + 1)
    return entropy, 1 - overlap[wanted > 0].mean()


def depth_loss(logits: Tensor, shares: Tensor) -> Tensor:
    """Cross entropy of the predicted depth against how each feature cell's pixels spread over the bins.

    Args:
        logits: (N, C, bins, h, w).
        shares: (N, C, bins, h, w) in 0..1; what is missing to 1 lies outside the bins and does not count.
    """
    surprise = -(shares * logits.log_softmax(2)).sum()
    return surprise / shares.sum().clamp(min=1e-6)


def balanced_weights(counts: Tensor, power: float) -> Tensor:
    """Weights (K,) of the classes: frequency to the power of -`power`, of mean 1 over all cells.

    Args:
        counts: (K,) cells of each class; a class that there is none of is given the greatest weight found.
    """
    share = counts.double() / counts.sum()
    lifted = share.clamp(min=1e-12) ** -power
    lifted[counts == 0] = lifted[counts > 0].max()
    return (lifted / (lifted * share).sum()).float()


def likeliest(scores: Tensor, class_weights: Tensor) -> Tensor:
    """The likeliest class of each cell, (N, X, Y) int64.

    Scores that were learned with weights on the classes say what would be likely if rare classes were so much more
    frequent; here that is taken back.

    Args:
        scores: (N, K, X, Y).
        class_weights: (K,), of the cross entropy that they were learned by.
    """
    return (scores - class_weights.to(scores.dtype).log()[:, None, None]).argmax(1)


def cell_weights(seen: Tensor, hidden: float, near: slice) -> Tensor:
    """1 for the cells in sight or near, `hidden` for the others; `seen` is (N, X, Y) bool."""
    clear = seen.clone()
    clear[:, near, near] = True
    return torch.where(clear, 1.0, hidden)

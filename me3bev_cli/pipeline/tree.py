"""Plain trees (dict, list, tuple) of tensors: how temporal memory is stored, moved and reset."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from torch import Tensor


def map_tree(function: Callable[..., Any], tree: Any, *others: Any) -> Any:
    """Apply `function` to the leaves that stand at the same place in every tree; None stays None."""
    if tree is None:
        return None
    if isinstance(tree, dict):
        return {key: map_tree(function, value, *(other[key] for other in others)) for key, value in tree.items()}
    if isinstance(tree, tuple | list):
        parts = [map_tree(function, *values) for values in zip(tree, *others, strict=True)]
        return type(tree)(parts) if isinstance(tree, list) else tuple(parts)
    return function(tree, *others)


def fold(x: Tensor) -> Tensor:
    """(B, T, K, D) -> (B K, T, D): each token becomes a sequence of its own."""
    b, t, k, d = x.shape
    return x.transpose(1, 2).reshape(b * k, t, d)


def unfold(x: Tensor, tokens: int) -> Tensor:
    """(B K, T, D) -> (B, T, K, D): the inverse of `fold`."""
    bk, t, d = x.shape
    return x.reshape(bk // tokens, tokens, t, d).transpose(1, 2)


def split_batch(tree: Any, tokens: int) -> Any:
    """Leaves (B K, ...) -> (B, K, ...), so that the first axis counts environments."""
    return map_tree(lambda leaf: leaf.reshape(leaf.shape[0] // tokens, tokens, *leaf.shape[1:]), tree)


def join_batch(tree: Any) -> Any:
    """Leaves (B, K, ...) -> (B K, ...): the inverse of `split_batch`."""
    return map_tree(lambda leaf: leaf.reshape(-1, *leaf.shape[2:]), tree)

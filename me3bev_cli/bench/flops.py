"""What a stage costs beside time: floating-point operations, parameters, bytes to be read, memory.

Operations are those of matrix products, convolutions, attention, recurrent layers and weighted sums over an index, a
multiply-add counted as two; element by element ones are not counted.
"""

from __future__ import annotations

import weakref
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import nn
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves
from torch.utils.flop_counter import FlopCounterMode

Shape = Sequence[int]


@dataclass(frozen=True)
class Cost:
    """Of one call of a stage."""

    flops: int
    parameters: int
    parameter_bytes: int
    input_bytes: int
    peak_bytes: int
    """Largest sum of tensors that the call made and held at once."""

    @property
    def read_bytes(self) -> int:
        """What must be read at least."""
        return self.parameter_bytes + self.input_bytes


def cost(function: Callable[..., Any], inputs: Sequence[Any], modules: Iterable[nn.Module | None]) -> tuple[Any, Cost]:
    """Call `function(*inputs)`; its result and what it cost. Parameters are those of `modules`."""
    weights = {id(p): p for module in modules if module is not None for p in module.parameters()}
    tensors = [leaf for leaf in tree_leaves(list(inputs)) if isinstance(leaf, torch.Tensor)]
    cuda = any(t.device.type == "cuda" for t in (*weights.values(), *tensors))
    # Under inference mode composite operations would reach the counter whole.
    with torch.no_grad(), FlopCounterMode(display=False, custom_mapping=FORMULAS) as flops:
        if cuda:
            torch.cuda.synchronize()
            torch.cuda.reset_peak_memory_stats()
            before = torch.cuda.memory_allocated()
            result = function(*inputs)
            torch.cuda.synchronize()
            peak = torch.cuda.max_memory_allocated() - before
        else:
            with LiveTensors() as live:
                result = function(*inputs)
            peak = live.peak
    count = sum(p.numel() for p in weights.values())
    sizes = nbytes(list(weights.values())), nbytes(tensors)
    return result, Cost(int(flops.get_total_flops()), count, *sizes, peak)


def nbytes(tree: Any) -> int:
    """Bytes of all tensors in a tree."""
    return sum(leaf.numel() * leaf.element_size() for leaf in tree_leaves(tree) if isinstance(leaf, torch.Tensor))


class LiveTensors(TorchDispatchMode):
    """Counts the bytes of tensors made while it is active; `peak` is the most that were alive at once."""

    def __init__(self) -> None:
        super().__init__()  # type: ignore[no-untyped-call]
        self.now = self.peak = 0
        self._known: set[int] = set()

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: dict[str, Any] | None = None) -> Any:
        given = {
            leaf.untyped_storage()._cdata for leaf in tree_leaves((args, kwargs)) if isinstance(leaf, torch.Tensor)
        }
        result = func(*args, **(kwargs or {}))
        for leaf in tree_leaves(result):
            if isinstance(leaf, torch.Tensor):
                self._count(leaf.untyped_storage(), given)
        return result

    def _count(self, storage: Any, given: set[int]) -> None:
        """A view shares the storage that it was given, which is counted already or was there before."""
        key = storage._cdata
        if key in self._known or key in given:
            return
        size = storage.nbytes()
        self._known.add(key)
        self.now += size
        self.peak = max(self.peak, self.now)
        weakref.finalize(storage, self._forget, key, size)

    def _forget(self, key: int, size: int) -> None:
        self._known.discard(key)
        self.now -= size


def _recurrent(x: Shape, *weights: Shape) -> int:
    """A fused recurrent layer on x (T, B, D) or (B, T, D): each weight matrix once per frame."""
    return 2 * x[0] * x[1] * sum(w[0] * w[1] for w in weights if len(w) == 2)


def _mkldnn_rnn(x: Shape, w_in: Shape, w_state: Shape, *_: Any, **__: Any) -> int:
    return _recurrent(x, w_in, w_state)


def _cudnn_rnn(x: Shape, weights: Sequence[Shape], *_: Any, **__: Any) -> int:
    return _recurrent(x, *weights)


def _embedding_bag(table: Shape, indices: Shape, *_: Any, **__: Any) -> int:
    return 2 * indices[0] * table[1]


_ATEN = torch.ops.aten
FORMULAS: dict[Any, Callable[..., int]] = {
    _ATEN.mkldnn_rnn_layer: _mkldnn_rnn,
    _ATEN._cudnn_rnn: _cudnn_rnn,
    _ATEN._embedding_bag: _embedding_bag,
    _ATEN._embedding_bag_forward_only: _embedding_bag,
}
"""For operations that torch's counter does not know."""

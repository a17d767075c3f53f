"""What a stage costs beside time: floating-point operations, parameters, bytes to be read, memory.

Operations are those of matrix products, convolutions, attention, recurrent layers and weighted sums over an index, a
multiply-add counted as two; element by element ones are not counted.
"""

from __future__ import annotations

import weakref
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor, nn
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils.flop_counter import flop_registry


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
    tensors = list(_tensors(inputs))
    cuda = any(t.device.type == "cuda" for t in (*weights.values(), *tensors))
    if cuda:
        torch.cuda.synchronize()
        torch.cuda.reset_peak_memory_stats()
        before = torch.cuda.memory_allocated()
    # Under inference mode composite operations would reach the counter whole.
    with torch.no_grad(), Counter() as counter:
        result = function(*inputs)
    peak = counter.peak
    if cuda:
        torch.cuda.synchronize()
        peak = torch.cuda.max_memory_allocated() - before
    count = sum(p.numel() for p in weights.values())
    return result, Cost(counter.flops, count, nbytes(list(weights.values())), nbytes(tensors), peak)


def nbytes(tree: Any) -> int:
    """Bytes of all tensors in a tree."""
    return sum(leaf.numel() * leaf.element_size() for leaf in _tensors(tree))


def _tensors(tree: Any) -> Iterator[Tensor]:
    if isinstance(tree, Tensor):
        yield tree
    elif isinstance(tree, list | tuple):
        for item in tree:
            yield from _tensors(item)
    elif isinstance(tree, dict):
        yield from _tensors(list(tree.values()))


class Counter(TorchDispatchMode):
    """Adds up operations while it is active, and the bytes of tensors made; `peak` is the most alive at once."""

    def __init__(self) -> None:
        super().__init__()  # type: ignore[no-untyped-call]
        self.flops = self.now = self.peak = 0
        self._known: set[int] = set()

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: dict[str, Any] | None = None) -> Any:
        kwargs = kwargs or {}
        given = {leaf.untyped_storage()._cdata for leaf in _tensors([args, kwargs])}
        result = func(*args, **kwargs)
        packet = func._overloadpacket
        if packet in FORMULAS:
            self.flops += FORMULAS[packet](*args)
        elif packet in flop_registry:
            self.flops += int(flop_registry[packet](*args, **kwargs, out_val=result))
        for leaf in _tensors(result):
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


def _recurrent(x: Tensor, weights: Sequence[Tensor]) -> int:
    """A fused recurrent layer on x (T, B, D) or (B, T, D): each weight matrix once per frame."""
    return 2 * x.shape[0] * x.shape[1] * sum(w.numel() for w in weights if w.dim() == 2)


def _embedding_bag(table: Tensor, indices: Tensor, *_: Any) -> int:
    return 2 * len(indices) * table.shape[1]


_ATEN = torch.ops.aten
FORMULAS: dict[Any, Callable[..., int]] = {
    _ATEN.mkldnn_rnn_layer: lambda x, w_in, w_state, *_: _recurrent(x, [w_in, w_state]),
    _ATEN._cudnn_rnn: lambda x, weights, *_: _recurrent(x, weights),
    _ATEN._embedding_bag: _embedding_bag,
    _ATEN._embedding_bag_forward_only: _embedding_bag,
}
"""For operations that torch's own table of formulas does not know."""

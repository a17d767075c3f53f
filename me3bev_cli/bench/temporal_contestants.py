"""What `bench/temporal.py` compares: the Mamba plugin by backend, mambapy's block, a transformer on a window."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from me3bev_cli import registry
from me3bev_cli.errors import UserError

MODALITIES = 3
ROWS, FRAMES = 64, 16
"""Shape of the batch that is trained on."""
STARTS = 0.05
"""Share of its frames that start an episode."""

Callables = dict[str, Callable[[], Any]]


def temporal(name: str, width: int, **keys: Any) -> nn.Module:
    """A plugin's module by its name, always the same one."""
    torch.manual_seed(0)
    cls = registry.load("temporal", name)
    module: nn.Module = cls(cls.Config(**keys), width)
    return module


def backends() -> dict[str, str]:
    """Name of a contestant -> the backend it takes; without the native one where that cannot be had."""
    try:
        temporal("mamba", 16, backend="native")
    except UserError:
        return {"torch": "torch"}
    return {"native": "native", "torch": "torch"}


def mambapy_blocks(width: int, count: int) -> list[Any]:
    """Blocks of the same size with norm and residual; none where mambapy is not installed."""
    try:
        from mambapy.mamba import MambaConfig, ResidualBlock
    except ImportError:
        return []
    torch.manual_seed(0)
    return [ResidualBlock(MambaConfig(d_model=width, n_layers=1)) for _ in range(count)]


class Stream:
    """A few modules, each with its state, that take one frame at a time."""

    def __init__(self, modules: list[Any], width: int, frames: int = 8) -> None:
        self.modules = modules
        self.x = torch.randn(1, 1, width)
        self.none = torch.zeros(1, 1, dtype=torch.bool)
        self.states = [module.initial_state(1) for module in modules]
        for _ in range(frames):
            self()

    def __call__(self) -> None:
        """One step of all."""
        with torch.no_grad():
            for index, module in enumerate(self.modules):
                _, self.states[index] = module(self.x, self.states[index], self.none)


class MambapyStream:
    """As `Stream`, in mambapy's way: a cache of the state and of the convolution's inputs."""

    def __init__(self, blocks: list[Any], width: int) -> None:
        self.blocks = blocks
        self.x = torch.randn(1, width)
        self.caches: list[Any] = []
        for block in blocks:
            config = block.mixer.config
            self.caches.append((None, torch.zeros(1, config.d_inner, config.d_conv - 1)))

    def __call__(self) -> None:
        """One step of all."""
        with torch.no_grad():
            for index, block in enumerate(self.blocks):
                _, self.caches[index] = block.step(self.x, self.caches[index])


def steps(width: int) -> Callables:
    """One streaming step of three modalities; and the products of matrices alone, which all of them contain."""
    result: Callables = {}
    for name, backend in backends().items():
        result[name] = Stream([temporal("mamba", width, backend=backend) for _ in range(MODALITIES)], width)
    blocks = mambapy_blocks(width, MODALITIES)
    if blocks:
        result["mambapy"] = MambapyStream(blocks, width)
    result["products"] = _products(width)
    return result


def _products(width: int) -> Callable[[], None]:
    layers = [
        [
            parameter.detach()
            for name, parameter in temporal("mamba", width).named_parameters()
            if "_proj.weight" in name
        ]
        for _ in range(MODALITIES)
    ]
    inputs = {weight.shape[1]: torch.randn(1, weight.shape[1]) for weights in layers for weight in weights}

    def run() -> None:
        with torch.no_grad():
            for weights in layers:
                for weight in weights:
                    F.linear(inputs[weight.shape[1]], weight)

    return run


def trainings(width: int) -> Callables:
    """Forward and backward of one block over a batch of sequences; ours with episode starts inside."""
    torch.manual_seed(1)
    x, starts = torch.randn(ROWS, FRAMES, width), torch.rand(ROWS, FRAMES) < STARTS
    result: Callables = {}
    for name, backend in backends().items():
        result[name] = _training(_with_starts(temporal("mamba", width, backend=backend), starts), x)
    for block in mambapy_blocks(width, 1):
        result["mambapy"] = _training(block, x)
    return result


def _with_starts(module: Any, starts: Tensor) -> Callable[[Tensor], Tensor]:
    state = module.initial_state(len(starts))
    return lambda x: module(x, state, starts)[0]


def _training(function: Callable[[Tensor], Tensor], x: Tensor) -> Callable[[], None]:
    weight = torch.randn_like(x)

    def run() -> None:
        y = function(x.detach().requires_grad_())
        torch.autograd.backward(y, weight)

    return run


def contexts(width: int, short: int, long: int) -> Callables:
    """A step of one Mamba block after a short and after a long context, and a transformer's pass over the long one."""
    window = temporal("transformer", width, context=long)
    x, none = torch.randn(1, long, width), torch.zeros(1, long, dtype=torch.bool)

    def again() -> None:
        with torch.no_grad():
            window(x, window.initial_state(1), none)  # type: ignore[operator]

    # The same module for both: what differs is the state alone.
    module = temporal("mamba", width)
    return {
        "step_short": Stream([module], width, short),
        "step_long": Stream([module], width, long),
        "transformer_window": again,
    }

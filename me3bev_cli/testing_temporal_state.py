"""Checks of a temporal plugin's state as something that is stored: its form, windows, and what a call may touch."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from me3bev_cli.testing import require
from me3bev_cli.testing_models import Outputs, leaves, require_equal

WINDOW = 4
"""Frames of a window, as in the paper."""


def form(tree: Any) -> dict[str, tuple[tuple[int, ...], torch.dtype, str]]:
    """Shape, dtype and device of every leaf."""
    return {name: (tuple(leaf.shape), leaf.dtype, leaf.device.type) for name, leaf in leaves(tree).items()}


def copied(tree: Any) -> Outputs:
    """The leaves as they are now."""
    return {name: leaf.detach().clone() for name, leaf in leaves(tree).items()}


def check_stored_state(cls: type, module: Any, x: Tensor, state: Any, starts: Tensor) -> None:
    """A state keeps its form, is not changed by a call, and can be detached and stored.

    Args:
        x: (B, T, D).
        state: of B sequences, not empty.
        starts: (B, T) bool.
    """
    wanted = form(module.initial_state(len(x)))
    before = {"x": x.clone(), **copied(state)}
    for frames in (1, x.shape[1]):
        for guard in (torch.enable_grad, torch.no_grad, torch.inference_mode):
            with guard():
                _, after = module(x[:, :frames], state, starts[:, :frames])
            given = form(after)
            seen = next(
                (f"{n}: {given.get(n)} for {wanted.get(n)}" for n in wanted if given.get(n) != wanted[n]), given
            )
            require(cls, given == wanted, "the state keeps its form: shapes, dtypes, device", seen)
            now = {"x": x, **copied(state)}
            require_equal(cls, "a call leaves its input and the given state as they were", now, before, 0.0)


def check_windows(cls: type, module: Any, x: Tensor, starts: Tensor) -> None:
    """Windows of four frames, run together, equal each window alone, starts inside them included."""
    width = x.shape[-1]
    windows = x.unfold(1, WINDOW, 1).transpose(2, 3).reshape(-1, WINDOW, width)
    flags = starts.unfold(1, WINDOW, 1).reshape(-1, WINDOW)
    with torch.no_grad():
        together, _ = module(windows, module.initial_state(len(windows)), flags)
        for index in range(0, len(windows), 3):
            alone, _ = module(windows[index : index + 1], module.initial_state(1), flags[index : index + 1])
            among = together[index : index + 1]
            require_equal(cls, f"windows of {WINDOW} equal each window alone", {"y": alone}, {"y": among})


def check_double(cls: type, build: Any, module: Any, x: Tensor, starts: Tensor) -> None:
    """The module in float64 computes in float64, and the same."""
    twin = build()
    twin.load_state_dict(module.state_dict())
    twin.double()
    with torch.no_grad():
        y, state = twin(x.double(), twin.initial_state(len(x)), starts)
        single, _ = module(x, module.initial_state(len(x)), starts)
    require(cls, y.dtype == torch.float64, "float64 in, float64 out", f"y is {y.dtype}")
    for name, leaf in leaves(state).items():
        fits = not leaf.is_floating_point() or leaf.dtype == torch.float64
        require(cls, fits, "a float64 module's state is float64", f"{name} is {leaf.dtype}")
    require_equal(cls, "float64 and float32 compute the same", {"y": single.double()}, {"y": y}, 1e-4)


def check_dense_starts(cls: type, module: Any, x: Tensor) -> None:
    """Where every frame starts an episode, each frame is alone."""
    rows, frames, width = x.shape
    every = torch.ones(rows, frames, dtype=torch.bool, device=x.device)
    with torch.no_grad():
        y, _ = module(x, module.initial_state(rows), every)
        alone, _ = module(x.reshape(-1, 1, width), module.initial_state(rows * frames), every.reshape(-1, 1))
    require_equal(cls, "where every frame starts, each is alone", {"y": y}, {"y": alone.reshape(y.shape)})

"""Checks of a temporal plugin's memory: streaming equals the sequence, resets clear, nothing looks ahead."""

from __future__ import annotations

import copy
from typing import Any, NamedTuple

import torch
from torch import Tensor

from me3bev_cli.testing import broken, require
from me3bev_cli.testing_models import Outputs, leaves, noise, require_equal, seeded
from me3bev_cli.testing_temporal_state import check_dense_starts, check_stored_state, check_windows

BATCH, FRAMES = 4, 11


class _Case(NamedTuple):
    x: Tensor
    starts: Tensor
    state: Any


def check_memory(cls: type, module: Any, width: int, seed: int) -> None:
    """All of it, on sequences with starts at random places and a memory that is not empty."""
    case = _case(module, width, seed)
    _check_streaming(cls, module, case)
    _check_resets(cls, module, case)
    _check_causal(cls, module, case)
    _check_rows(cls, module, case)
    check_stored_state(cls, module, case.x, case.state, case.starts)
    check_windows(cls, module, case.x, case.starts)
    check_dense_starts(cls, module, case.x)


def _case(module: Any, width: int, seed: int) -> _Case:
    def draw() -> tuple[Tensor, Tensor, Tensor]:
        starts = torch.rand(BATCH, FRAMES) < 0.25
        # Four rows: none, at the first frame, next to each other and at the end, and at random.
        starts[0] = False
        starts[1] = torch.arange(FRAMES) == 0
        starts[2] = torch.isin(torch.arange(FRAMES), torch.tensor([0, 4, 5, FRAMES - 1]))
        return torch.randn(BATCH, FRAMES, width), starts, torch.randn(BATCH, 7, width)

    x, starts, earlier = seeded(seed, draw)
    with torch.no_grad():
        _, state = module(earlier, module.initial_state(BATCH), torch.zeros(BATCH, 7, dtype=torch.bool))
    return _Case(x, starts, state)


def check_state(cls: type, module: Any) -> None:
    """The form of the empty memory: a plain tree, the batch first, where the module is."""
    parameter = next(iter(module.parameters()), torch.zeros(()))
    try:
        found = leaves(module.initial_state(BATCH))
    except TypeError as error:
        raise broken(cls, "the state is a plain tree of tensors", str(error)) from error
    for name, leaf in found.items():
        require(cls, leaf.ndim > 0 and leaf.shape[0] == BATCH, "the state has the batch as first axis", leaf.shape)
        require(cls, leaf.device == parameter.device, "the state is on the module's device", f"{name}: {leaf.device}")
        if leaf.is_floating_point():
            require(cls, leaf.dtype == parameter.dtype, "the state has the module's dtype", f"{name}: {leaf.dtype}")
    # A double on a device without memory shows, on any machine, whether the state follows its module.
    double = copy.deepcopy(module).to("meta", torch.float64)
    for name, leaf in leaves(double.initial_state(2)).items():
        require(
            cls, leaf.device.type == "meta", "the state follows the module across devices", f"{name}: {leaf.device}"
        )
        fits = not leaf.is_floating_point() or leaf.dtype == torch.float64
        require(cls, fits, "the state follows the module's dtype", f"{name}: {leaf.dtype}")


def _run(module: Any, case: _Case, pieces: list[int]) -> tuple[Tensor, Any]:
    """The sequence in pieces of the given lengths, the state carried from one to the next."""
    ys, state = [], case.state
    for x, starts in zip(torch.split(case.x, pieces, 1), torch.split(case.starts, pieces, 1), strict=True):
        y, state = module(x, state, starts)
        ys.append(y)
    return torch.cat(ys, 1), state


def _with_gradients(module: Any, case: _Case, pieces: list[int]) -> Outputs:
    """Outputs, final state and the gradients of input, initial state and parameters."""
    case = _Case(case.x.clone().requires_grad_(), case.starts, _differentiable(case.state))
    y, state = _run(module, case, pieces)
    results = {"y": y, **leaves(state)}
    loss = torch.zeros(())
    for index, value in enumerate(results.values()):
        if value.is_floating_point():
            loss = loss + (value * noise(value, index)).sum()
    wanted = {"x": case.x, **{n: v for n, v in leaves(case.state, "initial").items() if v.is_floating_point()}}
    wanted |= dict(module.named_parameters())
    grads = torch.autograd.grad(loss, list(wanted.values()), allow_unused=True, materialize_grads=True)
    return {**results, **{f"gradient of {name}": grad for name, grad in zip(wanted, grads, strict=True)}}


def _differentiable(tree: Any) -> Any:
    if isinstance(tree, Tensor):
        return tree.detach().clone().requires_grad_(tree.is_floating_point())
    if isinstance(tree, dict):
        return {key: _differentiable(value) for key, value in tree.items()}
    parts = [_differentiable(value) for value in tree]
    return parts if isinstance(tree, list) else tuple(parts)


def _check_streaming(cls: type, module: Any, case: _Case) -> None:
    whole = _with_gradients(module, case, [FRAMES])
    for name, pieces in (("frame by frame", [1] * FRAMES), ("in pieces", [3, 1, FRAMES - 4])):
        require_equal(cls, f"a sequence {name} equals the whole", _with_gradients(module, case, pieces), whole)
    with torch.no_grad():
        y, state = _run(module, case, [1] * FRAMES)
    outputs = {name: value for name, value in whole.items() if not name.startswith("gradient")}
    require_equal(cls, "without gradients frame by frame equals the whole", {"y": y, **leaves(state)}, outputs)


def _check_resets(cls: type, module: Any, case: _Case) -> None:
    """After a start everything equals a new sequence, whatever was before."""
    cut = FRAMES // 2
    starts = case.starts.clone()
    starts[:, cut] = True
    x = case.x.clone().requires_grad_()
    y, _ = module(x, case.state, starts)
    fresh, _ = module(x[:, cut:], module.initial_state(BATCH), starts[:, cut:])
    require_equal(cls, "a start clears the memory inside a sequence", {"y": y[:, cut:]}, {"y": fresh})
    (grad,) = torch.autograd.grad(y[:, cut:].square().sum(), x)
    leak = float(grad[:, :cut].abs().max())
    require(cls, leak == 0.0, "no gradient passes a start", f"{leak:.1e} to an earlier frame")
    first = torch.ones(BATCH, 1, dtype=torch.bool)
    for grads in (True, False):
        with torch.set_grad_enabled(grads):
            carried, _ = module(x[:, :1], case.state, first)
            empty, _ = module(x[:, :1], module.initial_state(BATCH), ~first)
        require_equal(cls, "a start at the first frame clears the carried state", {"y": carried}, {"y": empty})


def _check_causal(cls: type, module: Any, case: _Case) -> None:
    cut = FRAMES // 2
    with torch.no_grad():
        y, _ = module(case.x, case.state, case.starts)
        later = case.x.clone()
        later[:, cut:] += 1.0
        changed, _ = module(later, case.state, case.starts)
    require_equal(cls, "no frame sees a later one", {"y": changed[:, :cut]}, {"y": y[:, :cut]})
    require(cls, not torch.equal(changed[:, cut:], y[:, cut:]), "the output depends on the input", "it does not")


def _check_rows(cls: type, module: Any, case: _Case) -> None:
    """One row alone, from its slice of the state, equals the same row in the batch."""
    with torch.no_grad():
        y, _ = module(case.x, case.state, case.starts)
        for row in range(BATCH):
            alone, _ = module(case.x[row : row + 1], _row(case.state, row), case.starts[row : row + 1])
            require_equal(cls, "sequences are independent of each other", {"y": alone}, {"y": y[row : row + 1]})


def _row(tree: Any, row: int) -> Any:
    if isinstance(tree, Tensor):
        return tree[row : row + 1]
    if isinstance(tree, dict):
        return {key: _row(value, row) for key, value in tree.items()}
    parts = [_row(value, row) for value in tree]
    return parts if isinstance(tree, list) else tuple(parts)

"""A Mamba block on native kernels: where they can run, one streaming step, and sequences with gradients.

The kernels are compiled by numba for the machine at hand when they are first needed (seconds, then kept on disk).
They take float32 on a CPU; whatever they cannot take, the torch path computes, to the same numbers within rounding.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import Any, NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
import torch
from torch import Tensor, nn
from torch.autograd.function import once_differentiable

STEP_NUMBERS = 2048
"""Up to so many numbers of input (sequences x width) a streaming step is one call; for more, matrix products pay."""


class Kernels(NamedTuple):
    """The compiled functions."""

    step: Any
    convolve: Any
    convolve_backward: Any
    recur: Any
    recur_backward: Any
    block: int


class Weights(NamedTuple):
    """A block's parameters, as `Mamba` has them."""

    in_proj: Tensor
    conv_weight: Tensor
    conv_bias: Tensor
    x_proj: Tensor
    dt_proj: Tensor
    dt_bias: Tensor
    A_log: Tensor
    D: Tensor
    out_proj: Tensor


@cache
def kernels() -> Kernels | None:
    """The kernels, or None where numba is missing or cannot compile here."""
    try:
        from me3bev_plugins.temporal.native_backward import recur_backward
        from me3bev_plugins.temporal.native_sequence import BLOCK, convolve, convolve_backward, recur
        from me3bev_plugins.temporal.native_step import step
    except Exception:  # Whatever hinders numba, torch can do the work.
        return None
    return Kernels(step, convolve, convolve_backward, recur, recur_backward, BLOCK)


def check_shapes(weights: Weights, x: Tensor, conv: Tensor, ssm: Tensor, starts: Tensor) -> None:
    """Kernels believe what they are told of sizes.

    Raises:
        ValueError: for tensors that do not belong to each other.
    """
    rows, frames, width = x.shape
    inner, states = weights.A_log.shape
    wanted = ((rows, weights.conv_weight.shape[2] - 1, inner), (rows, states, inner), (rows, frames), torch.bool)
    given = (conv.shape, ssm.shape, starts.shape, starts.dtype)
    if width != weights.in_proj.shape[1] or given != wanted:
        raise ValueError(f"x {tuple(x.shape)} with conv, ssm, starts and its dtype {given} instead of {wanted}")


def suits(x: Tensor, parameter: Tensor, conv: Tensor, ssm: Tensor) -> bool:
    """Whether the kernels can take these: float32 on a CPU, and nothing that rewrites or watches operators."""
    single = torch.float32
    return (
        (x.dtype is single and parameter.dtype is single and conv.dtype is single and ssm.dtype is single)
        and (x.is_cpu and parameter.is_cpu and conv.is_cpu and ssm.is_cpu)
        and x.numel() > 0
        and not torch.is_autocast_enabled("cpu")
        and not torch.compiler.is_compiling()
        and not _watched()
        and kernels() is not None
    )


def _watched() -> bool:
    """Whether someone counts, fakes or records torch's operators, which would not see a kernel's work."""
    depth = getattr(torch._C, "_len_torch_dispatch_stack", None)
    return depth is not None and depth() > 0


class _Plan:
    """What the steps of one module keep: addresses, and memory to work in."""

    def __init__(self, weights: Weights, width: int, flags: int) -> None:
        (inner, states), rank = weights.A_log.shape, weights.dt_proj.shape[1]
        self.sizes = width, inner, states, weights.conv_weight.shape[-1], rank, flags
        self.seen = np.full(inner * states, np.nan, np.float32)
        self.A = np.empty((states, inner), np.float32)
        self.work = np.empty(5 * inner + width + rank + 2 * states, np.float32)
        self.table = np.zeros(20, np.int64)
        self.table[17:] = self.seen.ctypes.data, self.A.ctypes.data, self.work.ctypes.data
        self.addresses: list[int] = []
        self.shapes: list[torch.Size] = []

    def aim(self, parameters: Sequence[Tensor]) -> bool:
        """Enter where the parameters are now, for they may have been replaced; whether the kernel can read them."""
        addresses = [parameter.data_ptr() for parameter in parameters]
        if addresses != self.addresses:
            shapes = [parameter.shape for parameter in parameters]
            if not all(parameter.is_contiguous() for parameter in parameters) or shapes != (self.shapes or shapes):
                return False
            self.shapes = shapes
            self.addresses = addresses
            self.table[7:17] = addresses
        return True


_plans: WeakKeyDictionary[nn.Module, _Plan] = WeakKeyDictionary()


def plan(module: Any, norm: Tensor | None, weights: Weights) -> _Plan | None:
    """What `step` needs for a module; None if its parameters do not lie in memory as the kernel reads them."""
    found = _plans.get(module)
    if found is None:
        flags = (norm is not None) + 2 * module.config.residual
        found = _plans[module] = _Plan(weights, module.width, flags)
    return found if found.aim((weights.D if norm is None else norm, *weights)) else None


def step(plan: _Plan, x: Tensor, conv: Tensor, ssm: Tensor, starts: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """One frame of a few sequences without gradients, the norm and the residual included.

    Args:
        plan: of the module.
        x: (B, 1, D).
        conv, ssm: the state.
        starts: (B, 1) bool.

    Returns:
        y (B, 1, D) and the new state.
    """
    x, conv, ssm, starts = x.contiguous(), conv.contiguous(), ssm.contiguous(), starts.contiguous()
    y, conv_after, ssm_after = torch.empty_like(x), torch.empty_like(conv), torch.empty_like(ssm)
    # A copy, since another thread may be between these lines; the work space is safe, as kernels hold the interpreter.
    table = plan.table.copy()
    table[:7] = [part.data_ptr() for part in (x, conv, ssm, y, conv_after, ssm_after, starts)]
    kernels().step(table, x.shape[0], *plan.sizes)  # type: ignore[union-attr]
    return y, conv_after, ssm_after


def sequence(weights: Weights, x: Tensor, conv: Tensor, ssm: Tensor, starts: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """A block without norm and residual over x (B, T, D): y and the new state, differentiable."""
    if torch.is_grad_enabled():
        y, conv_after, ssm_after = _Block.apply(x, conv, ssm, starts, *weights)
        return y, conv_after, ssm_after
    return _forward(x, conv, ssm, starts, weights)[0]


class _Middle(NamedTuple):
    """What the forward leaves for the backward."""

    both: Tensor
    u: Tensor
    selected: Tensor
    raw: Tensor
    gated: Tensor
    taps: Tensor
    A: Tensor


def _forward(
    x: Tensor, conv: Tensor, ssm: Tensor, starts: Tensor, weights: Weights
) -> tuple[tuple[Tensor, Tensor, Tensor], _Middle]:
    native = kernels()
    assert native is not None
    rows, frames, width = x.shape
    inner = len(weights.A_log)
    conv, ssm = conv.contiguous(), ssm.contiguous()
    both = torch.mm(x.reshape(-1, width), weights.in_proj.t())
    taps = weights.conv_weight[:, 0].t().contiguous()
    A = torch.exp(weights.A_log.t().contiguous()).neg_()
    u, conv_after = x.new_empty(rows, frames, inner), torch.empty_like(conv)
    three = both.view(rows, frames, 2 * inner)
    flags = starts.contiguous()
    native.convolve(*_arrays(three, conv, flags, taps, weights.conv_bias, u, conv_after))
    selected = torch.mm(u.view(-1, inner), weights.x_proj.t())
    raw = torch.mm(selected[:, : weights.dt_proj.shape[1]], weights.dt_proj.t())
    gated, ssm_after = torch.empty_like(u), torch.empty_like(ssm)
    middle = _Middle(three, u, selected.view(rows, frames, -1), raw.view_as(u), gated, taps, A)
    lines = x.new_empty(3, native.block)
    read = (u, middle.raw, weights.dt_bias, A, middle.selected, weights.D, three, ssm, flags)
    native.recur(*_arrays(*read, gated, ssm_after, lines))
    y = torch.mm(gated.view(-1, inner), weights.out_proj.t()).view(x.shape)
    return (y, conv_after, ssm_after), middle


def _arrays(*tensors: Tensor) -> list[Any]:
    """The tensors' memory as numpy sees it."""
    return [tensor.detach().contiguous().numpy() for tensor in tensors]


class _Block(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any, x: Tensor, conv: Tensor, ssm: Tensor, starts: Tensor, *parameters: Tensor
    ) -> tuple[Tensor, Tensor, Tensor]:
        results, middle = _forward(x, conv, ssm, starts, Weights(*parameters))
        ctx.save_for_backward(x, conv, ssm, starts, *parameters, *middle)
        return results

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor | None, ...]:
        x, conv, ssm, starts, *rest = ctx.saved_tensors
        count = len(Weights._fields)
        return _backward(x, conv, ssm, starts, Weights(*rest[:count]), _Middle(*rest[count:]), grads)


def _backward(
    x: Tensor, conv: Tensor, ssm: Tensor, starts: Tensor, weights: Weights, middle: _Middle, grads: tuple[Tensor, ...]
) -> tuple[Tensor | None, ...]:
    native = kernels()
    assert native is not None
    inner, states = weights.A_log.shape
    rank = weights.dt_proj.shape[1]
    grad_y, flat = grads[0].reshape(-1, x.shape[-1]), middle.u.view(-1, inner)
    grad_gated = torch.mm(grad_y, weights.out_proj)
    grad_u, grad_raw, grad_both = torch.empty_like(flat), torch.empty_like(flat), torch.empty_like(middle.both)
    grad_selected, grad_A = torch.zeros_like(middle.selected), torch.zeros_like(middle.A)
    grad_bias, grad_D, grad_ssm = torch.zeros_like(weights.D), torch.zeros_like(weights.D), torch.empty_like(ssm)
    frames = x.shape[1]
    read = (middle.u, middle.raw, weights.dt_bias, middle.A, middle.selected, weights.D, middle.both, ssm, starts)
    shaped = (grad_u.view_as(middle.u), grad_raw.view_as(middle.u))
    memory, lines = x.new_empty(3, frames, states, native.block), x.new_empty(3, frames + 1, native.block)
    native.recur_backward(
        *_arrays(*read, grad_gated.view_as(middle.u), grads[2], *shaped, grad_bias, grad_A, grad_selected, grad_D),
        *_arrays(grad_both, grad_ssm, memory, lines),
    )
    low = grad_selected.view(-1, grad_selected.shape[-1])
    low[:, :rank] = torch.mm(grad_raw, weights.dt_proj)
    grad_u.addmm_(low, weights.x_proj)
    grad_taps, grad_conv_bias, grad_conv = (
        torch.zeros_like(middle.taps),
        torch.zeros_like(weights.D),
        torch.empty_like(conv),
    )
    native.convolve_backward(
        *_arrays(middle.both, conv, starts, middle.taps, weights.conv_bias, shaped[0], grads[1]),
        *_arrays(grad_both, grad_conv, grad_taps, grad_conv_bias, torch.empty_like(weights.D)),
    )
    wide = grad_both.view(-1, 2 * inner)
    return (
        torch.mm(wide, weights.in_proj).view(x.shape),
        grad_conv,
        grad_ssm,
        None,
        torch.mm(wide.t(), x.reshape(-1, x.shape[-1])),
        grad_taps.t().unsqueeze(1),
        grad_conv_bias,
        torch.mm(low.t(), flat),
        torch.mm(grad_raw.t(), middle.selected.view_as(low)[:, :rank]),
        grad_bias,
        grad_A.mul_(middle.A).t(),
        grad_D,
        torch.mm(grad_y.t(), middle.gated.view(-1, inner)),
    )

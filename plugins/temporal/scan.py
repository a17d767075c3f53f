"""The selective scan of Mamba: one recurrence over time, exact at episode starts, with its own backward.

    h_t = exp(delta_t A) h_{t-1} + (delta_t x_t) B_t        y_t = C_t h_t

Shapes: B batch, T time, E inner width, N state size. States are kept as (B, N, E), so that the long axis
is the innermost one and each step is a single fused multiply-add over contiguous memory. Nothing of size
T x B x N x E outlives a call: on a CPU the rows pass a few at a time through work tensors that stay in the
cache, and the backward computes the states again.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from me3bev_plugins.temporal import cuda_scan

_CHUNK_ELEMENTS = 1 << 18
"""Elements of one (T, rows, N, E) work tensor on a CPU: small enough for the cache, large enough for few calls."""


class _Inputs(NamedTuple):
    """What the recurrence reads. A is (N, E); the others are per row."""

    x: Tensor
    delta: Tensor
    A: Tensor
    B: Tensor
    C: Tensor
    state: Tensor
    starts: Tensor


def selective_scan(
    x: Tensor, delta: Tensor, A: Tensor, B: Tensor, C: Tensor, state: Tensor, starts: Tensor
) -> tuple[Tensor, Tensor]:
    """Run the recurrence over T frames.

    Args:
        x, delta: (B, T, E); delta positive.
        A: (N, E), negative.
        B, C: (B, T, N).
        state: (B, N, E), the memory before the first frame.
        starts: (B, T) bool; where true the memory is cleared before the frame is read.

    Returns:
        y (B, T, E) and the state after the last frame (B, N, E). Differentiable in all but `starts`.
    """
    state = cleared(state, starts[:, 0])
    if cuda_scan.suits(x, starts):
        return cuda_scan.fused_scan(x, delta, A, B, C, state)
    y, last = _Scan.apply(x, delta, A, B, C, state, starts)
    return y, last


def cleared(state: Tensor, starts: Tensor) -> Tensor:
    """The memory (B, ..., E), zero in the rows where `starts` (B,) is true, whatever was in them."""
    if starts.device.type == "cpu" and not bool(starts.any()):
        return state
    return state.masked_fill(starts.view(-1, *(1 for _ in state.shape[1:])), 0.0)


def scan_step(x: Tensor, delta: Tensor, A: Tensor, B: Tensor, C: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
    """One frame of `selective_scan` without gradients and starts: x, delta (B, E), B, C (B, N)."""
    delta, x = delta[:, None, :], x[:, None, :]
    state = (delta * A).exp_().mul_(state)
    state.baddbmm_(B[:, :, None], delta * x)
    return torch.bmm(C[:, None, :], state)[:, 0], state


class _Scan(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, *args: Tensor) -> tuple[Tensor, Tensor]:
        inputs = _Inputs(*args)
        ctx.save_for_backward(*args)
        ctx.set_materialize_grads(False)
        y, last = torch.empty_like(inputs.x), torch.empty_like(inputs.state)
        for rows, (decay, states) in _chunks(inputs, 2):
            part = _rows(inputs, rows)
            _run(part, decay, states)
            y[rows] = torch.matmul(part.C.transpose(0, 1).unsqueeze(-2), states).squeeze(-2).transpose(0, 1)
            last[rows] = states[-1]
        return y, last

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor | None, ...]:
        inputs = _Inputs(*ctx.saved_tensors)
        grad_y, grad_last = grads
        if grad_y is None:
            grad_y = torch.zeros_like(inputs.x)
        wants_state = ctx.needs_input_grad[5]
        grad = _Inputs(
            *(
                tensor.new_empty(tensor.shape if name != "state" or wants_state else 0)
                for name, tensor in inputs._asdict().items()
            )
        )
        grad.A.zero_()
        for rows, work in _chunks(inputs, 3):
            last = None if grad_last is None else grad_last[rows]
            _chunk_backward(_rows(inputs, rows), grad_y[rows], last, _rows(grad, rows), work)
        return (*grad[:5], grad.state if wants_state else None, None)


def _chunk_backward(
    inputs: _Inputs, grad_y: Tensor, grad_last: Tensor | None, grad: _Inputs, work: tuple[Tensor, ...]
) -> None:
    """Write the gradients of some rows into `grad`, and add their share to A's."""
    decay, states, g = work
    _run(inputs, decay, states)
    grad_y, C, B = grad_y.transpose(0, 1), inputs.C.transpose(0, 1), inputs.B.transpose(0, 1)
    # g_t, the gradient of h_t, flows back through the decay of the frame after it.
    torch.mul(C.unsqueeze(-1), grad_y.unsqueeze(-2), out=g)
    if grad_last is not None:
        g[-1] += grad_last
    later = g[-1]
    for g_t, decay_after in zip(reversed(g.unbind(0)[:-1]), reversed(decay.unbind(0)[1:]), strict=True):
        later = g_t.addcmul_(decay_after, later)
    if grad.state.numel():
        torch.mul(decay[0], g[0], out=grad.state)
    grad.C.copy_(torch.matmul(states, grad_y.unsqueeze(-1)).squeeze(-1).transpose(0, 1))
    drive = inputs.delta * inputs.x
    grad.B.copy_(torch.matmul(g, drive.transpose(0, 1).unsqueeze(-1)).squeeze(-1).transpose(0, 1))
    grad_drive = torch.matmul(B.unsqueeze(-2), g).squeeze(-2).transpose(0, 1)
    torch.mul(grad_drive, inputs.delta, out=grad.x)
    # The gradient of (delta A), in the memory of the decay.
    decay.mul_(g)
    decay[0].mul_(inputs.state)
    decay[1:].mul_(states[:-1])
    grad.A.add_(torch.mul(decay, inputs.delta.transpose(0, 1).unsqueeze(-2), out=states).sum((0, 1)))
    torch.mul(grad_drive, inputs.x, out=grad.delta)
    grad.delta.add_(decay.mul_(inputs.A).sum(-2).transpose(0, 1))


def _run(inputs: _Inputs, decay: Tensor, states: Tensor) -> None:
    """Write the decays (zero at starts) and the states after each frame, both (T, B, N, E)."""
    delta, starts = inputs.delta.transpose(0, 1), inputs.starts.transpose(0, 1)
    torch.mul(delta.unsqueeze(-2), inputs.A, out=decay)
    decay.exp_().mul_(~starts[:, :, None, None])
    drive = (inputs.delta * inputs.x).transpose(0, 1)
    torch.mul(inputs.B.transpose(0, 1).unsqueeze(-1), drive.unsqueeze(-2), out=states)
    before = inputs.state
    for decay_t, state_t in zip(decay.unbind(0), states.unbind(0), strict=True):
        before = state_t.addcmul_(decay_t, before)


def _rows(inputs: _Inputs, rows: slice) -> _Inputs:
    """Views of some rows; A is common to all."""
    return _Inputs(*(part if name == "A" else part[rows] for name, part in inputs._asdict().items()))


def _chunks(inputs: _Inputs, count: int) -> Iterator[tuple[slice, tuple[Tensor, ...]]]:
    """Slices of rows, each with `count` work tensors (T, rows, N, E) whose memory is used again for the next."""
    batch, frames = inputs.x.shape[:2]
    size = inputs.A.numel() * frames
    most = batch if inputs.x.device.type != "cpu" else max(1, _CHUNK_ELEMENTS // max(size, 1))
    memory = inputs.x.new_empty(count, min(most, batch) * size)
    for first in range(0, batch, max(most, 1)):
        rows = slice(first, min(first + most, batch))
        number = rows.stop - first
        yield rows, tuple(part[: number * size].view(frames, number, *inputs.A.shape) for part in memory)

"""The selective scan of Mamba: one recurrence over time, exact at episode starts, with its own backward.

    h_t = exp(delta_t A) h_{t-1} + (delta_t x_t) B_t        y_t = C_t h_t

Shapes: B batch, T time, E inner width, N state size. States are kept as (B, N, E), so that the long axis
is the innermost one and each step is a single fused multiply-add over contiguous memory. Nothing of size
T x B x N x E outlives a call: the backward computes the states again, a few rows at a time, in cache.
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

_CHUNK_ELEMENTS = 1 << 18
"""Elements of one (T, rows, N, E) work tensor on a CPU: a few of them fit the second-level cache."""


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
    state = state.masked_fill(starts[:, :1, None], 0.0)
    y, last = _Scan.apply(x, delta, A, B, C, state, starts)
    return y, last


def scan_step(
    x: Tensor, delta: Tensor, A: Tensor, B: Tensor, C: Tensor, state: Tensor, starts: Tensor
) -> tuple[Tensor, Tensor]:
    """One frame of `selective_scan` without gradients: x, delta (B, E), B, C (B, N), starts (B,)."""
    state = state.masked_fill(starts[:, None, None], 0.0)
    state.mul_((delta[:, None, :] * A).exp_())
    state.baddbmm_(B[:, :, None], (delta * x)[:, None, :])
    return torch.bmm(C[:, None, :], state)[:, 0], state


class _Scan(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any, x: Tensor, delta: Tensor, A: Tensor, B: Tensor, C: Tensor, state: Tensor, starts: Tensor
    ) -> tuple[Tensor, Tensor]:
        y, last = torch.empty_like(x), torch.empty_like(state)
        for rows in _row_chunks(x, A):
            _, states = _states(x[rows], delta[rows], A, B[rows], state[rows], starts[rows])
            y[rows] = _read(C[rows], states)
            last[rows] = states[-1]
        ctx.save_for_backward(x, delta, A, B, C, state, starts)
        return y, last

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor | None, ...]:
        grad_y, grad_last = grads
        x, delta, A, B, C, state, starts = ctx.saved_tensors
        grad_A = torch.zeros_like(A)
        per_row = [torch.empty_like(t) for t in (x, delta, B, C, state)]
        for rows in _row_chunks(x, A):
            inputs = (x[rows], delta[rows], A, B[rows], C[rows], state[rows], starts[rows])
            *parts, grad_A_rows = _chunk_backward(*inputs, grad_y[rows], grad_last[rows])
            for whole, part in zip(per_row, parts, strict=True):
                whole[rows] = part
            grad_A += grad_A_rows
        grad_x, grad_delta, grad_B, grad_C, grad_state = per_row
        return grad_x, grad_delta, grad_A, grad_B, grad_C, grad_state, None


def _chunk_backward(
    x: Tensor,
    delta: Tensor,
    A: Tensor,
    B: Tensor,
    C: Tensor,
    state: Tensor,
    starts: Tensor,
    grad_y: Tensor,
    grad_last: Tensor,
) -> tuple[Tensor, ...]:
    """Gradients of x, delta, B, C, state for some rows, and their share of A's."""
    decay, states = _states(x, delta, A, B, state, starts)
    grad_yt, Ct, Bt = grad_y.transpose(0, 1), C.transpose(0, 1), B.transpose(0, 1)
    # g_t, the gradient of h_t, flows back through the decay of the frame after it.
    g = Ct.unsqueeze(-1) * grad_yt.unsqueeze(-2)
    g[-1] += grad_last
    for t in range(len(g) - 2, -1, -1):
        g[t].addcmul_(decay[t + 1], g[t + 1])
    grad_state = decay[0] * g[0]
    grad_C = torch.matmul(states, grad_yt.unsqueeze(-1)).squeeze(-1).transpose(0, 1)
    drive = (delta * x).transpose(0, 1)
    grad_B = torch.matmul(g, drive.unsqueeze(-1)).squeeze(-1).transpose(0, 1)
    grad_drive = torch.matmul(Bt.unsqueeze(-2), g).squeeze(-2).transpose(0, 1)
    # The gradient of (delta A), in the memory of the decay.
    decay.mul_(g)
    decay[0].mul_(state)
    decay[1:].mul_(states[:-1])
    grad_A = torch.mul(decay, delta.transpose(0, 1).unsqueeze(-2), out=states).sum((0, 1))
    grad_delta = decay.mul_(A).sum(-2).transpose(0, 1)
    return grad_drive * delta, grad_delta + grad_drive * x, grad_B, grad_C, grad_state, grad_A


def _states(x: Tensor, delta: Tensor, A: Tensor, B: Tensor, state: Tensor, starts: Tensor) -> tuple[Tensor, Tensor]:
    """The decays (zero at starts) and the states after each frame, both (T, B, N, E)."""
    decay = delta.transpose(0, 1).unsqueeze(-2) * A
    decay.exp_()
    decay.masked_fill_(starts.transpose(0, 1)[:, :, None, None], 0.0)
    states = B.transpose(0, 1).unsqueeze(-1) * (delta * x).transpose(0, 1).unsqueeze(-2)
    before = state
    for decay_t, state_t in zip(decay.unbind(0), states.unbind(0), strict=True):
        before = state_t.addcmul_(decay_t, before)
    return decay, states


def _read(C: Tensor, states: Tensor) -> Tensor:
    """y = C h: (B, T, N) and (T, B, N, E) -> (B, T, E)."""
    return torch.matmul(C.transpose(0, 1).unsqueeze(-2), states).squeeze(-2).transpose(0, 1)


def _row_chunks(x: Tensor, A: Tensor) -> list[slice]:
    batch, frames = x.shape[:2]
    rows = batch if x.device.type != "cpu" else max(1, _CHUNK_ELEMENTS // (frames * A.numel()))
    return [slice(i, i + rows) for i in range(0, batch, max(rows, 1))]

"""The selective scan on mamba-ssm's CUDA kernel, where that package is installed.

The kernel begins with an empty memory, knows no episode starts, and its last state has no gradient. The first and the
last are made good here, exactly, since the recurrence is linear in the state; sequences with starts inside go the
other way (`scan.selective_scan`).
"""

from __future__ import annotations

from functools import cache
from typing import Any

import torch
from torch import Tensor


@cache
def kernel() -> Any:
    """mamba-ssm's `selective_scan_fn`, or None."""
    try:
        from mamba_ssm.ops.selective_scan_interface import selective_scan_fn
    except Exception:  # An installation that does not fit the CUDA at hand fails in many ways.
        return None
    return selective_scan_fn


def suits(x: Tensor, starts: Tensor) -> bool:
    """Whether the kernel is there for x (B, T, E), and no episode starts after the first frame."""
    return (
        on_cuda(x)
        and x.shape[1] > 1
        and x.dtype == torch.float32
        and kernel() is not None
        and not bool(starts[:, 1:].any())
    )


def on_cuda(x: Tensor) -> bool:
    """Whether x is where the kernel works."""
    return x.is_cuda


def fused_scan(x: Tensor, delta: Tensor, A: Tensor, B: Tensor, C: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
    """As `scan.selective_scan` without starts: y (B, T, E) and the last state (B, N, E), both with gradients.

    N more frames of step size zero let the state stand as it is; each observes one of its numbers. So the last state
    comes out as an output, and the kernel's own backward carries its gradient.
    """
    rows, frames, channels = x.shape
    states = len(A)
    idle = x.new_zeros(rows, states, channels)
    x, delta = torch.cat([x, idle], 1), torch.cat([delta, idle], 1)
    B = torch.cat([B, B.new_zeros(rows, states, states)], 1)
    C = torch.cat([C, torch.eye(states, dtype=C.dtype, device=C.device).expand(rows, -1, -1)], 1)
    lines = (part.transpose(1, 2).contiguous() for part in (x, delta))
    y = kernel()(*lines, A.t().contiguous(), *(part.transpose(1, 2).contiguous() for part in (B, C)))
    y = y.transpose(1, 2)
    if state.requires_grad or bool(state.any()):
        elapsed = delta.cumsum(1)
        for n in range(states):
            y = y + C[:, :, n, None] * torch.exp(elapsed * A[n]) * state[:, None, n]
    return y[:, :frames], y[:, frames:]

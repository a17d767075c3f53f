"""Mamba's equations written out frame by frame, to test against."""

from __future__ import annotations

from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor


def recurrence(module: Any, x: Tensor, state: dict[str, Tensor], starts: Tensor) -> tuple[Tensor, dict[str, Tensor]]:
    """eqs. 11-13 for every row and frame by itself: y (B, T, D) and the last state."""
    rows, finals, pasts = [], [], []
    for b in range(len(x)):
        h, past = state["ssm"][b], list(state["conv"][b])
        ys = []
        for t in range(x.shape[1]):
            if starts[b, t]:
                h, past = torch.zeros_like(h), [torch.zeros_like(p) for p in past]
            y, h, past = _step(module, x[b, t], h, past)
            ys.append(y)
        rows.append(torch.stack(ys))
        finals.append(h)
        pasts.append(torch.stack(past) if past else h.new_zeros(0, h.shape[1]))
    return torch.stack(rows), {"conv": torch.stack(pasts), "ssm": torch.stack(finals)}


def _step(module: Any, x: Tensor, h: Tensor, past: list[Tensor]) -> tuple[Tensor, Tensor, list[Tensor]]:
    normed = x / torch.sqrt((x * x).mean() + 1e-5) * module.norm.weight
    both = module.in_proj.weight @ normed
    inner, gate = both[: module.inner], both[module.inner :]
    past = [*past, inner]
    kernel, bias = module.conv1d.weight[:, 0], module.conv1d.bias
    mixed = bias + sum(kernel[:, k] * past[k] for k in range(kernel.shape[1]))
    u = mixed * torch.sigmoid(mixed)
    n, r = module.config.d_state, module.rank
    selected = module.x_proj.weight @ u
    raw = module.dt_proj.weight @ selected[:r] + module.dt_proj.bias
    delta, B, C = F.softplus(raw), selected[r : r + n], selected[r + n :]
    h = torch.exp(delta * -torch.exp(module.A_log).T) * h + B[:, None] * (delta * u)
    y = (C @ h + module.D * u) * gate * torch.sigmoid(gate)
    return x + module.out_proj.weight @ y, h, past[1:]

"""The backward of `native_sequence.recur`."""

from __future__ import annotations

from typing import Any

import numpy as np

from me3bev_plugins.temporal.native_math import assign, clear, ordered, sigmoid, summing
from me3bev_plugins.temporal.native_sequence import BLOCK, _advance, _begin, _prepare

_ZERO, _ONE = np.float32(0.0), np.float32(1.0)


@ordered
def _forward(
    u: Any, raw: Any, bias: Any, A: Any, selected: Any, D: Any, state: Any, starts: Any,
    memory: Any, lines: Any, b: int, low: int, high: int,
) -> None:  # fmt: skip
    """The states of a block of channels after every frame, their decays, and what the gate was given."""
    states, rank, w = len(A), selected.shape[2] - 2 * len(A), high - low
    for t in range(u.shape[1]):
        delta, drive, y = lines[0, t, :w], lines[1, t, :w], lines[2, t, :w]
        _prepare(raw[b, t, low:high], bias[low:high], u[b, t, low:high], D[low:high], delta, drive, y)
        for n in range(states):
            B, C, decay, h = (
                selected[b, t, rank + n],
                selected[b, t, rank + states + n],
                memory[0, t, n],
                memory[1, t, n],
            )
            if starts[b, t]:
                _begin(drive, B, C, h, y)
            elif t > 0:
                _advance(delta, drive, A[n, low:high], memory[1, t - 1, n], B, C, decay, h, y)
            else:
                _advance(delta, drive, A[n, low:high], state[b, n, low:high], B, C, decay, h, y)


@ordered
def _ungate(grad_out: Any, y: Any, z: Any, u: Any, D: Any, grad_z: Any, grad_y: Any, grad_u: Any, grad_D: Any) -> None:
    for e in range(len(y)):
        s = sigmoid(z[e])
        grad_z[e] = grad_out[e] * y[e] * (s * (_ONE + z[e] * (_ONE - s)))
        grad_y[e] = grad_out[e] * z[e] * s
        grad_u[e] = grad_y[e] * D[e]
        grad_D[e] += grad_y[e] * u[e]


@summing
def _observe(grad_y: Any, h: Any, drive: Any, c: float, b: float, g: Any, grad_drive: Any) -> Any:
    """Take in what the observation passes back; the gradients of B and C for one state."""
    grad_b, grad_c = _ZERO, _ZERO
    for e in range(len(g)):
        g[e] += c * grad_y[e]
        grad_c += grad_y[e] * h[e]
        grad_b += g[e] * drive[e]
        grad_drive[e] += g[e] * b
    return grad_b, grad_c


@ordered
def _retreat(decay: Any, before: Any, A: Any, delta: Any, g: Any, grad_delta: Any, grad_A: Any) -> None:
    """Through the decay, to the state one frame before."""
    for e in range(len(g)):
        g[e] *= decay[e]
        exponent = g[e] * before[e]
        grad_delta[e] += exponent * A[e]
        grad_A[e] += exponent * delta[e]


@ordered
def _finish(
    raw: Any,
    bias: Any,
    u: Any,
    delta: Any,
    grad_drive: Any,
    grad_delta: Any,
    grad_u: Any,
    grad_raw: Any,
    grad_bias: Any,
) -> None:
    for e in range(len(u)):
        grad_u[e] += grad_drive[e] * delta[e]
        grad_raw[e] = (grad_delta[e] + grad_drive[e] * u[e]) * sigmoid(raw[e] + bias[e])
        grad_bias[e] += grad_raw[e]


@ordered
def _states_back(
    A: Any, selected: Any, state: Any, starts: Any, grad_selected: Any, grad_A: Any, memory: Any,
    delta: Any, drive: Any, grad_y: Any, grad_drive: Any, grad_delta: Any, b: int, t: int, low: int, high: int,
) -> None:  # fmt: skip
    """All states of a block of channels at frame t, and on to the frame before it."""
    states, rank = len(A), selected.shape[2] - 2 * len(A)
    for n in range(states):
        B, C = selected[b, t, rank + n], selected[b, t, rank + states + n]
        g, decay, rates = memory[2, 0, n, : high - low], memory[0, t, n], A[n, low:high]
        of_b, of_c = _observe(grad_y, memory[1, t, n], drive, C, B, g, grad_drive)
        grad_selected[b, t, rank + n] += of_b
        grad_selected[b, t, rank + states + n] += of_c
        if starts[b, t]:
            clear(g)
        elif t > 0:
            _retreat(decay, memory[1, t - 1, n], rates, delta, g, grad_delta, grad_A[n, low:high])
        else:
            _retreat(decay, state[b, n, low:high], rates, delta, g, grad_delta, grad_A[n, low:high])


@ordered
def recur_backward(
    u: Any, raw: Any, bias: Any, A: Any, selected: Any, D: Any, both: Any, state: Any, starts: Any,
    grad_out: Any, grad_last: Any,
    grad_u: Any, grad_raw: Any, grad_bias: Any, grad_A: Any, grad_selected: Any, grad_D: Any, grad_both: Any,
    grad_state: Any, memory: Any, lines: Any,
) -> None:  # fmt: skip
    """Gradients of all that `recur` reads.

    Overwritten: those of u, raw, the gate's half of `both` and the state (given as that of the last state,
    `grad_last`, which may be the same memory). Added to: those of the parameters and of `selected`. To work in:
    `memory` (3, T, N, BLOCK) and `lines` (3, T + 1, BLOCK).
    """
    rows, frames, channels = u.shape
    states = len(A)
    for b in range(rows):
        for low in range(0, channels, BLOCK):
            high = min(low + BLOCK, channels)
            _forward(u, raw, bias, A, selected, D, state, starts, memory, lines, b, low, high)
            for n in range(states):
                assign(memory[2, 0, n, : high - low], grad_last[b, n, low:high])
            for t in range(frames - 1, -1, -1):
                delta, drive, y = lines[0, t, : high - low], lines[1, t, : high - low], lines[2, t, : high - low]
                grad_y, grad_drive, grad_delta = (
                    lines[0, frames, : high - low], lines[1, frames, : high - low], lines[2, frames, : high - low]
                )  # fmt: skip
                _ungate(
                    grad_out[b, t, low:high], y, both[b, t, channels + low : channels + high], u[b, t, low:high],
                    D[low:high], grad_both[b, t, channels + low : channels + high], grad_y, grad_u[b, t, low:high],
                    grad_D[low:high],
                )  # fmt: skip
                clear(grad_drive)
                clear(grad_delta)
                _states_back(
                    A, selected, state, starts, grad_selected, grad_A, memory, delta, drive, grad_y, grad_drive,
                    grad_delta, b, t, low, high,
                )  # fmt: skip
                _finish(
                    raw[b, t, low:high], bias[low:high], u[b, t, low:high], delta, grad_drive, grad_delta,
                    grad_u[b, t, low:high], grad_raw[b, t, low:high], grad_bias[low:high],
                )  # fmt: skip
            for n in range(states):
                assign(grad_state[b, n, low:high], memory[2, 0, n, : high - low])

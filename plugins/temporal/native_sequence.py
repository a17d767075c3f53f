"""What of a Mamba block is not a product of matrices, over sequences, as native kernels: convolution, recurrence, gate.

Shapes: B rows, T frames, E channels, N states, K taps, R the rank of the step size. `both` (B, T, 2 E) is the input
projection, its first half for the recurrence and its second for the gate; `selected` (B, T, R + 2 N) holds the step
size's low-rank part, the input matrix and the observation matrix. Channels pass in blocks whose states over all frames
stay in the cache; the backward computes states again rather than fetching them from memory.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from me3bev_plugins.temporal.native_math import add, assign, clear, exp, ordered, sigmoid, softplus

_ZERO, _ONE = np.float32(0.0), np.float32(1.0)
BLOCK = 128
"""Channels that are worked on at a time."""


@ordered
def _tap(weight: Any, x: Any, out: Any) -> None:
    for e in range(len(out)):
        out[e] += weight[e] * x[e]


@ordered
def _silu(x: Any) -> None:
    for e in range(len(x)):
        x[e] *= sigmoid(x[e])


@ordered
def convolve(both: Any, past: Any, starts: Any, weight: Any, bias: Any, u: Any, after: Any) -> None:
    """u (B, T, E) = silu(causal convolution), and the last K - 1 frames of the running episode in `after`.

    Args:
        past: (B, K - 1, E), the frames before.
        starts: (B, T) bool.
        weight: (K, E), the last tap for the present frame.
        bias: (E,).
    """
    rows, frames, channels = u.shape
    taps = len(weight)
    for b in range(rows):
        age = taps
        for t in range(frames):
            age = 0 if starts[b, t] else age + 1
            _preactivation(both[b], past[b], weight, bias, t, age, u[b, t])
            _silu(u[b, t])
        for k in range(taps - 1):
            lag = taps - 2 - k
            if lag > age:
                clear(after[b, k])
            elif lag < frames:
                assign(after[b, k], both[b, frames - 1 - lag, :channels])
            else:
                assign(after[b, k], past[b, taps - 2 + frames - lag])


@ordered
def _preactivation(both: Any, past: Any, weight: Any, bias: Any, t: int, age: int, out: Any) -> None:
    """The convolution at frame t, which has `age` frames of its episode before it."""
    taps, channels = weight.shape
    assign(out, bias)
    for lag in range(min(taps - 1, age), -1, -1):
        source = both[t - lag, :channels] if t >= lag else past[taps - 1 + t - lag]
        _tap(weight[taps - 1 - lag], source, out)


@ordered
def _tap_backward(g: Any, weight: Any, source: Any, grad_source: Any, grad_weight: Any) -> None:
    for e in range(len(g)):
        grad_source[e] += g[e] * weight[e]
        grad_weight[e] += g[e] * source[e]


@ordered
def convolve_backward(
    both: Any, past: Any, starts: Any, weight: Any, bias: Any, grad_u: Any, grad_after: Any,
    grad_both: Any, grad_past: Any, grad_weight: Any, grad_bias: Any, c: Any,
) -> None:  # fmt: skip
    """The gradients of `convolve`: adds to those of weight and bias, overwrites those of inputs and past."""
    rows, frames, channels = grad_u.shape
    taps = len(weight)
    for b in range(rows):
        for t in range(frames):
            clear(grad_both[b, t, :channels])
        for k in range(taps - 1):
            clear(grad_past[b, k])
        age = taps
        for t in range(frames):
            age = 0 if starts[b, t] else age + 1
            _preactivation(both[b], past[b], weight, bias, t, age, c)
            for e in range(channels):
                s = sigmoid(c[e])
                c[e] = grad_u[b, t, e] * (s * (_ONE + c[e] * (_ONE - s)))
                grad_bias[e] += c[e]
            for lag in range(min(taps - 1, age) + 1):
                k = taps - 1 - lag
                if t >= lag:
                    source, grad = both[b, t - lag, :channels], grad_both[b, t - lag, :channels]
                else:
                    source, grad = past[b, taps - 1 + t - lag], grad_past[b, taps - 1 + t - lag]
                _tap_backward(c, weight[k], source, grad, grad_weight[k])
        for k in range(taps - 1):
            lag = taps - 2 - k
            if lag <= age:
                if lag < frames:
                    add(grad_both[b, frames - 1 - lag, :channels], grad_after[b, k])
                else:
                    add(grad_past[b, taps - 2 + frames - lag], grad_after[b, k])


@ordered
def _advance(
    delta: Any, drive: Any, rates: Any, before: Any, b: float, c: float, decay: Any, after: Any, y: Any
) -> None:
    """One state of a block of channels, one frame on; the decay is kept."""
    for e in range(len(y)):
        decay[e] = exp(delta[e] * rates[e])
        after[e] = decay[e] * before[e] + drive[e] * b
        y[e] += c * after[e]


@ordered
def _begin(drive: Any, b: float, c: float, after: Any, y: Any) -> None:
    """As `_advance` where an episode starts."""
    for e in range(len(y)):
        after[e] = drive[e] * b
        y[e] += c * after[e]


@ordered
def _go_on(delta: Any, drive: Any, rates: Any, h: Any, b: float, c: float, y: Any) -> None:
    """As `_advance`, keeping nothing."""
    for e in range(len(y)):
        h[e] = exp(delta[e] * rates[e]) * h[e] + drive[e] * b
        y[e] += c * h[e]


@ordered
def _prepare(raw: Any, bias: Any, u: Any, D: Any, delta: Any, drive: Any, y: Any) -> None:
    for e in range(len(y)):
        delta[e] = softplus(raw[e] + bias[e])
        drive[e] = delta[e] * u[e]
        y[e] = D[e] * u[e]


@ordered
def _gate(y: Any, z: Any, out: Any) -> None:
    for e in range(len(y)):
        out[e] = y[e] * z[e] * sigmoid(z[e])


@ordered
def recur(
    u: Any, raw: Any, bias: Any, A: Any, selected: Any, D: Any, both: Any, state: Any, starts: Any,
    out: Any, last: Any, lines: Any,
) -> None:  # fmt: skip
    """out (B, T, E) = the gated recurrence, and the state (B, N, E) after the last frame in `last`.

    Args:
        u: (B, T, E), what `convolve` gives.
        raw: (B, T, E), the step size before its bias and softplus.
        A: (N, E), negative.
        state: (B, N, E).
        lines: (3, BLOCK) to work in.
    """
    rows, frames, channels = u.shape
    states = len(A)
    rank = selected.shape[2] - 2 * states
    for b in range(rows):
        for low in range(0, channels, BLOCK):
            high = min(low + BLOCK, channels)
            delta, drive, y = lines[0, : high - low], lines[1, : high - low], lines[2, : high - low]
            if not starts[b, 0]:
                for n in range(states):
                    assign(last[b, n, low:high], state[b, n, low:high])
            for t in range(frames):
                _prepare(raw[b, t, low:high], bias[low:high], u[b, t, low:high], D[low:high], delta, drive, y)
                for n in range(states):
                    B, C, h = selected[b, t, rank + n], selected[b, t, rank + states + n], last[b, n, low:high]
                    if starts[b, t]:
                        _begin(drive, B, C, h, y)
                    else:
                        _go_on(delta, drive, A[n, low:high], h, B, C, y)
                _gate(y, both[b, t, channels + low : channels + high], out[b, t, low:high])

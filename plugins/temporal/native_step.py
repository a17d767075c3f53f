"""One streaming frame of a Mamba block as one native call: norm, projections, convolution, recurrence, gate, residual.

At this size the work is reading the weights once, and calls of operators cost as much again. So the kernel gets plain
addresses of contiguous float32 memory, and makes no objects.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from llvmlite import ir
from numba import carray, njit, types
from numba.extending import intrinsic

from me3bev_plugins.temporal.native_math import assign, exp, ordered, sigmoid, softplus, summing

_with_arrays: Any = njit(cache=True, error_model="numpy")
_ZERO, _ONE = np.float32(0.0), np.float32(1.0)
_EPSILON = np.float32(1e-5)


@intrinsic
def _typed(context: Any, address: Any) -> Any:
    """The address of a float32 as a typed pointer."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.inttoptr(args[0], ir.FloatType().as_pointer())

    return types.CPointer(types.float32)(address), generate


@intrinsic
def _typed_flags(context: Any, address: Any) -> Any:
    """The address of a bool as a typed pointer."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.inttoptr(args[0], ir.IntType(8).as_pointer())

    return types.CPointer(types.uint8)(address), generate


_pointer: Any = _typed
_flags: Any = _typed_flags


@summing
def _multiply(weight: Any, x: Any, out: Any) -> None:
    """out = weight @ x, four rows at a time so that x is read once for all of them."""
    rows, columns = weight.shape
    four = rows - rows % 4
    for o in range(0, four, 4):
        a, b, c, d = _ZERO, _ZERO, _ZERO, _ZERO
        for i in range(columns):
            a += weight[o, i] * x[i]
            b += weight[o + 1, i] * x[i]
            c += weight[o + 2, i] * x[i]
            d += weight[o + 3, i] * x[i]
        out[o], out[o + 1], out[o + 2], out[o + 3] = a, b, c, d
    for o in range(four, rows):
        a = _ZERO
        for i in range(columns):
            a += weight[o, i] * x[i]
        out[o] = a


@summing
def _normalise(x: Any, weight: Any, out: Any) -> None:
    """x over its root mean square, times the weight."""
    total = _ZERO
    for i in range(len(x)):
        total += x[i] * x[i]
    scale = _ONE / np.sqrt(total / np.float32(len(x)) + _EPSILON)
    for i in range(len(x)):
        out[i] = x[i] * scale * weight[i]


@ordered
def _decay_rates(A_log: Any, seen: Any, A: Any) -> None:
    """A (N, E) = -exp(A_log (E N)), worked out again only if A_log is no longer what was `seen`."""
    states, channels = A.shape
    changed = 0
    for i in range(len(A_log)):
        changed |= A_log[i] != seen[i]
    if changed:
        for e in range(channels):
            for n in range(states):
                A[n, e] = -exp(A_log[e * states + n])
        assign(seen, A_log)


@ordered
def _convolve(inner: Any, past: Any, weight: Any, bias: Any, after: Any, u: Any, clear: bool) -> None:
    """u = silu(conv over the past (K - 1, E) and this frame), and the past of the next frame."""
    taps = len(past)
    for e in range(len(inner)):
        u[e] = bias[e] + weight[e, taps] * inner[e]
    for k in range(taps):
        if not clear:
            for e in range(len(inner)):
                u[e] += weight[e, k] * past[k, e]
        if k > 0:
            for e in range(len(inner)):
                after[k - 1, e] = _ZERO if clear else past[k, e]
    if taps:
        assign(after[taps - 1], inner)
    for e in range(len(inner)):
        u[e] *= sigmoid(u[e])


@ordered
def _recur(A: Any, B: Any, C: Any, delta: Any, u: Any, h: Any, after: Any, y: Any, clear: bool) -> None:
    """h = exp(delta A) h + delta u B and y += C h, over N states of E channels."""
    for n in range(len(A)):
        rates, old, new, b, c = A[n], h[n], after[n], B[n], C[n]
        if clear:
            for e in range(len(u)):
                new[e] = delta[e] * u[e] * b
        else:
            for e in range(len(u)):
                new[e] = exp(delta[e] * rates[e]) * old[e] + delta[e] * u[e] * b
        for e in range(len(u)):
            y[e] += c * new[e]


@ordered
def _row(
    x: Any, conv: Any, ssm: Any, y: Any, conv_after: Any, ssm_after: Any, clear: bool,
    norm: Any, in_proj: Any, conv_weight: Any, conv_bias: Any, x_proj: Any, dt_proj: Any, dt_bias: Any,
    D: Any, out_proj: Any, A: Any, work: Any, flags: int,
) -> None:  # fmt: skip
    """One frame of one sequence; `work` holds 5 E + D + R + 2 N numbers."""
    states, inner = A.shape
    width, rank = len(x), dt_proj.shape[1]
    both, u, delta, out = (
        work[: 2 * inner],
        work[2 * inner : 3 * inner],
        work[3 * inner : 4 * inner],
        work[4 * inner : 5 * inner],
    )
    normed, selected = work[5 * inner : 5 * inner + width], work[5 * inner + width :]
    if flags & 1:
        _normalise(x, norm, normed)
    else:
        assign(normed, x)
    _multiply(in_proj, normed, both)
    _convolve(both[:inner], conv, conv_weight, conv_bias, conv_after, u, clear)
    _multiply(x_proj, u, selected)
    _multiply(dt_proj, selected[:rank], delta)
    for e in range(inner):
        delta[e] = softplus(delta[e] + dt_bias[e])
        out[e] = D[e] * u[e]
    B, C = selected[rank : rank + states], selected[rank + states :]
    _recur(A, B, C, delta, u, ssm, ssm_after, out, clear)
    gate = both[inner:]
    for e in range(inner):
        out[e] *= gate[e] * sigmoid(gate[e])
    _multiply(out_proj, out, y)
    if flags & 2:
        for i in range(width):
            y[i] += x[i]


@_with_arrays
def step(table: Any, rows: int, width: int, inner: int, states: int, taps: int, rank: int, flags: int) -> None:
    """`rows` frames, each of a sequence of its own, through one block.

    Args:
        table: int64 addresses of x, conv, ssm, y, the new conv and ssm, starts (bool); of the weights of norm, in_proj,
            conv1d and its bias, x_proj, dt_proj and its bias, A_log, D, out_proj; of work space: A_log as last seen, A,
            and `_row`'s.
        flags: 1 for a norm, 2 for a residual.
    """
    x, y = carray(_pointer(table[0]), (rows, width)), carray(_pointer(table[3]), (rows, width))
    starts = carray(_flags(table[6]), (rows,))
    past = (rows, taps - 1, inner)
    conv, conv_after = carray(_pointer(table[1]), past), carray(_pointer(table[4]), past)
    memory = (rows, states, inner)
    ssm, ssm_after = carray(_pointer(table[2]), memory), carray(_pointer(table[5]), memory)
    A = carray(_pointer(table[18]), (states, inner))
    _decay_rates(carray(_pointer(table[14]), (inner * states,)), carray(_pointer(table[17]), (inner * states,)), A)
    for row in range(rows):
        _row(
            x[row],
            conv[row],
            ssm[row],
            y[row],
            conv_after[row],
            ssm_after[row],
            starts[row] != 0,
            carray(_pointer(table[7]), (width,)),
            carray(_pointer(table[8]), (2 * inner, width)),
            carray(_pointer(table[9]), (inner, taps)),
            carray(_pointer(table[10]), (inner,)),
            carray(_pointer(table[11]), (rank + 2 * states, inner)),
            carray(_pointer(table[12]), (inner, rank)),
            carray(_pointer(table[13]), (inner,)),
            carray(_pointer(table[15]), (inner,)),
            carray(_pointer(table[16]), (width, inner)),
            A,
            carray(_pointer(table[19]), (5 * inner + width + rank + 2 * states,)),
            flags,
        )

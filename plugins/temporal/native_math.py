"""Exponentials in single precision that a compiler can put into vector registers, for the native kernels.

LLVM calls the C library once per number for `exp`. These are polynomials (near-minimax fits of this project's own)
between operations that every vector unit has; errors stay below 3e-7, relative. NaN goes in and comes out.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, TypeVar, cast

import numpy as np
from llvmlite import ir
from numba import njit, types
from numba.extending import intrinsic

F = TypeVar("F", bound=Callable[..., Any])


def _compiler(fastmath: set[str]) -> Callable[[F], F]:
    """A decorator for kernels that allocate nothing: without it numba counts references to each array at each call."""
    jit: Any = njit  # Its stubs do not know the option.
    options = {"cache": True, "error_model": "numpy", "fastmath": fastmath}

    def compiled(function: F) -> F:
        try:
            return cast(F, jit(_nrt=False, **options)(function))
        except (KeyError, TypeError, ValueError):
            return cast(F, jit(**options)(function))

    return compiled


ordered = _compiler({"contract"})
"""Products may be fused into sums, but sums keep their order: ln 2 comes off in two pieces, neither to be lost."""
summing = _compiler({"contract", "reassoc", "nsz"})
"""Long sums are taken in several parts at a time; which parts is settled when the kernel is compiled."""

_LOG2_E = np.float32(1.4426950408889634)
_LN2_HIGH = np.float32(0.693359375)
_LN2_LOW = np.float32(-2.1219444005469057e-4)
_LOWEST, _HIGHEST = np.float32(-87.33), np.float32(88.37)
_HALF, _ONE, _TWO, _ZERO = np.float32(0.5), np.float32(1.0), np.float32(2.0), np.float32(0.0)
_E2, _E3, _E4 = np.float32(0.5000000014291086), np.float32(0.16666573358081635), np.float32(0.04166645677792329)
_E5, _E6 = np.float32(0.008363776466630597), np.float32(0.0013934544520075329)
_L3, _L5 = np.float32(0.3333331977566408), np.float32(0.2000384777781245)
_L7, _L9 = np.float32(0.14116607681968008), np.float32(0.1343643951641734)


def _discard_stale(folder: Path) -> None:
    """Delete compiled kernels that are older than a source: numba looks at a kernel's own file, not at its callees'."""
    with suppress(OSError):
        newest = max(source.stat().st_mtime for source in folder.glob("native_*.py"))
        for index in (folder / "__pycache__").glob("native_*.nbi"):
            if index.stat().st_mtime < newest:
                index.unlink(missing_ok=True)


_discard_stale(Path(__file__).parent)


@intrinsic
def _power_of_two(context: Any, exponent: Any) -> Any:
    """2 ** exponent for a whole float32 between -126 and 127, by writing its exponent bits."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        bits = ir.IntType(32)
        whole = builder.fptosi(args[0], bits)
        shifted = builder.shl(builder.add(whole, ir.Constant(bits, 127)), ir.Constant(bits, 23))
        return builder.bitcast(shifted, ir.FloatType())

    return types.float32(types.float32), generate


@intrinsic
def _rounded(context: Any, value: Any) -> Any:
    """The nearest whole number, as one instruction."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        single = ir.FloatType()
        function = builder.module.declare_intrinsic("llvm.rint", [single])
        return builder.call(function, [args[0]])

    return types.float32(types.float32), generate


power_of_two: Any = _power_of_two
rounded: Any = _rounded


@ordered
def exp(x: Any) -> Any:
    """e ** x, between the smallest normal number and 2.4e38; 0 below."""
    held = _LOWEST if x < _LOWEST else (_HIGHEST if x > _HIGHEST else x)
    whole = rounded(held * _LOG2_E)
    r = (held - whole * _LN2_HIGH) - whole * _LN2_LOW
    tail = _E2 + r * (_E3 + r * (_E4 + r * (_E5 + r * _E6)))
    result = (_ONE + (r + (r * r) * tail)) * power_of_two(whole)
    return _ZERO if x < _LOWEST else result


@ordered
def sigmoid(x: Any) -> Any:
    """1 / (1 + e ** -x)."""
    return _ONE / (_ONE + exp(-x))


@ordered
def softplus(x: Any) -> Any:
    """log(1 + e ** x), relative to its own size also where it is tiny."""
    u = exp(x if x < _ZERO else -x)
    s = u / (_TWO + u)
    z = s * s
    tail = _TWO * s * (_ONE + z * (_L3 + z * (_L5 + z * (_L7 + z * _L9))))
    return tail + (_ZERO if x < _ZERO else x)


@ordered
def assign(out: Any, x: Any) -> None:
    """out = x, number by number: an assignment of slices would want to allocate."""
    for i in range(len(out)):
        out[i] = x[i]


@ordered
def clear(out: Any) -> None:
    """out = 0."""
    for i in range(len(out)):
        out[i] = _ZERO


@ordered
def add(out: Any, x: Any) -> None:
    """out += x."""
    for i in range(len(out)):
        out[i] += x[i]

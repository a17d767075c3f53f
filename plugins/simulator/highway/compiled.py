"""How kernels are compiled."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

from numba import njit

F = TypeVar("F", bound=Callable[..., Any])


def kernel(function: F) -> F:
    """Compile a function that allocates no arrays.

    Numba counts references to every array of every tuple that is handed to a function, with atomic instructions;
    kernels that call many small functions spend nine tenths of their time on that. Where nothing is allocated
    nothing needs counting. A numba that does not know the option compiles the same code, only slower.
    """
    try:
        compiled = njit(cache=True, _nrt=False)(function)
    except (KeyError, TypeError, ValueError):
        compiled = njit(cache=True)(function)
    return compiled  # type: ignore[no-any-return]

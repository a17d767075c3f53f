"""How kernels are compiled, and when compiled ones are thrown away."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, TypeVar

from numba import njit

F = TypeVar("F", bound=Callable[..., Any])


def kernel(function: F) -> F:
    """Compile a function that allocates no arrays.

    Numba counts references to every array of every tuple that is handed to a function, with atomic instructions;
    kernels that call many small functions spend nine tenths of their time on that. Where nothing is allocated
    nothing needs counting. A numba that does not know the option compiles the same code, only slower.
    """
    compile_with: Any = njit  # Its stubs do not know the option.
    try:
        compiled: F = compile_with(cache=True, error_model="numpy", _nrt=False)(function)
    except (KeyError, TypeError, ValueError):
        compiled = compile_with(cache=True, error_model="numpy")(function)
    return compiled


def discard_stale(folder: Path) -> bool:
    """Delete the compiled kernels of a folder if any of its sources has changed since; whether they were.

    Numba looks at a kernel's own file only, but the machine code holds that of the kernels it calls, which are in
    other files. Nothing is deleted where nothing can be: an installed package changes as a whole.
    """
    cache = folder / "__pycache__"
    digest = hashlib.blake2b(digest_size=16)
    with suppress(OSError):
        for source in sorted(folder.glob("*.py")):
            digest.update(f"{source.name} {source.stat().st_size} {source.stat().st_mtime_ns}\n".encode())
        stamp = cache / "kernels.stamp"
        if stamp.exists() and stamp.read_text() == digest.hexdigest():
            return False
        cache.mkdir(exist_ok=True)
        for index in cache.glob("*.nbi"):
            index.unlink(missing_ok=True)
        stamp.write_text(digest.hexdigest())
        return True
    return False


discard_stale(Path(__file__).parent)

"""The C library's allocator, told to keep what is freed instead of giving it back to the system.

Every step of a network takes and frees the same large tensors; by default glibc gets each from the system anew, and the
page faults take a quarter of the step.
"""

from __future__ import annotations

import ctypes

_TRIM_THRESHOLD, _TOP_PAD, _MMAP_THRESHOLD = -1, -2, -3
"""Parameters of glibc's mallopt."""


def keep_freed_memory() -> bool:
    """Let this process keep its freed memory; False where the C library cannot."""
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (OSError, AttributeError, TypeError):  # macOS's library has no such function, Windows no such handle.
        return False
    settings = ((_MMAP_THRESHOLD, 1 << 30), (_TRIM_THRESHOLD, 2_000_000_000), (_TOP_PAD, 64 << 20))
    taken = [mallopt(name, value) for name, value in settings]
    return all(result == 1 for result in taken)

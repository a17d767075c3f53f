"""Whether a network that is being built will be given all its weights afterwards, as from a checkpoint.

A plugin whose config names pretrained weights then need not have them: the file may be gone, the machine offline.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

_FOLLOW: ContextVar[bool] = ContextVar("weights_follow", default=False)


@contextmanager
def weights_follow() -> Iterator[None]:
    """What is built inside is given all its weights later."""
    token = _FOLLOW.set(True)
    try:
        yield
    finally:
        _FOLLOW.reset(token)


def need_weights() -> bool:
    """Whether a plugin has to find its pretrained weights itself; its structure must not depend on the answer."""
    return not _FOLLOW.get()

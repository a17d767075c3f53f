"""One source of randomness: every episode's seed comes from what names the episode."""

from __future__ import annotations

import hashlib


def derive_seed(*names: str | int) -> int:
    """A 31-bit seed from the parts that name what is seeded.

    The same parts give the same seed in every process, so a result does not depend on how many
    workers ran or in which order they finished.

    Args:
        names: for an episode `(run seed, map, density, episode index)`; any parts will do.
    """
    text = "\x1f".join(f"{type(name).__name__}:{name}" for name in names)
    digest = hashlib.blake2b(text.encode(), digest_size=8).digest()
    return int.from_bytes(digest, "little") & 0x7FFFFFFF

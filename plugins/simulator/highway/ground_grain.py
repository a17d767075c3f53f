"""The grain of the ground: soft patches of brightness that keep large surfaces from looking flat."""

from __future__ import annotations

import numpy as np

from me3bev_plugins.simulator.highway.ground_tiles import (
    BASES,
    LEVELS,
    OFFSETS,
    PAINTED,
    PATTERN,
    RECORD,
    SHADES,
    TILE,
    Bytes,
    Floats,
    Paint,
)


def grain() -> tuple[Bytes, ...]:
    """Brightness steps at each mip level: fine speckle over soft patches; no seams."""
    rng = np.random.default_rng(20240607)
    side = PATTERN * TILE
    total: Floats = np.zeros((side, side))
    for size, weight in ((128, 0.9), (64, 0.6), (32, 0.6), (16, 0.7), (8, 0.6)):
        noise = rng.standard_normal((size, size))
        factor = side // size
        wide = np.kron(noise, np.ones((factor, factor)))
        for axis in (0, 1):
            wide = np.mean([np.roll(wide, k, axis) for k in range(-(factor // 2), factor - factor // 2)], axis=0)
        total += weight * wide / max(wide.std(), 1e-9)
    total = np.argsort(np.argsort(total.ravel())).reshape(total.shape) / total.size
    levels = []
    for level in range(LEVELS):
        if level:
            total = 0.25 * (total[::2, ::2] + total[1::2, ::2] + total[::2, 1::2] + total[1::2, 1::2])
        levels.append(np.clip(total * SHADES, 0, SHADES - 1).astype(np.uint8))
    return tuple(levels)


def plain_tiles() -> Bytes:
    """The records of all tiles of one class, by class, then by row and column in the pattern of shades."""
    out = np.zeros((BASES, PATTERN, PATTERN, RECORD), np.uint8)
    for level, shades in enumerate(grain()):
        side = TILE >> level
        blocks = shades.reshape(PATTERN, side, PATTERN, side).transpose(0, 2, 1, 3).reshape(PATTERN, PATTERN, -1)
        for base in range(BASES):
            out[base, :, :, OFFSETS[level] : OFFSETS[level] + side * side] = base * SHADES + blocks
    for base in (Paint.WHITE, Paint.YELLOW, Paint.ZEBRA, Paint.ZEBRA_GAP):
        out[base, :, :, PAINTED] = 1
    return out.reshape(-1)

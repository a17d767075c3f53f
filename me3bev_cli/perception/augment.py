"""Frames made different from what was drawn, so that one town's colours and widths are not learned by heart.

A town has lanes of one width, sidewalks of another and asphalt of one grey: a network that is shown nothing else tells
where a sidewalk ends from where the lane does. So the grid and its truth are stretched here and pressed there, along
the ego's axes, and the colours of the pictures are shifted.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from me3bev_cli.perception.truth import CELL, CELLS

Bytes = NDArray[np.uint8]
Floats = NDArray[np.float64]

STRETCH = 3.0
"""A piece of the map becomes at most so many times as long, or as short."""
PIECE = (2.0, 14.0)
"""Metres of the changed map that are stretched alike, at least and at most."""
GAIN, BIAS, GAMMA = 0.25, 0.06, 0.3
"""Each colour is multiplied by up to 1 + this or divided by it, shifted by up to this, and raised to a power."""
COMMON = 0.7
"""Share of the change of colours that is the same in all three."""


class Stretch(NamedTuple):
    """Where the cells of a changed map are taken from, along the two axes."""

    rows: Floats
    """(CELLS + 1,): at the borders of the rows, borders of the true map's rows."""
    columns: Floats
    """(CELLS + 1,)"""

    def sources(self, cells: int) -> tuple[Floats, Floats]:
        """At the centres of the rows and columns of a map of `cells` per side: places from -1 to 1 if inside."""
        centres = (np.arange(cells) + 0.5) * CELLS / cells
        borders = np.arange(CELLS + 1)
        found = (np.interp(centres, borders, axis) for axis in self)
        rows, columns = (2 * axis / CELLS - 1 for axis in found)
        return rows, columns


class Change(NamedTuple):
    """What is done to a frame."""

    turned: bool
    """Left and right are exchanged."""
    colours: Bytes | None = None
    """(3, 256), what each value of each colour becomes."""
    stretch: Stretch | None = None


def draw_change(rng: np.random.Generator, mirror: bool, colours: float, stretch: float) -> Change:
    """A change by chance.

    Args:
        mirror: whether half of the frames are mirrored.
        colours: how strongly colours are shifted, 0 to 1.
        stretch: share of the frames that are stretched.
    """
    turned = bool(rng.random() < 0.5) and mirror
    table = _colours(rng, colours) if colours else None
    stretched = Stretch(_axis(rng), _axis(rng)) if rng.random() < stretch else None
    return Change(turned, table, stretched)


def _colours(rng: np.random.Generator, strength: float) -> Bytes:
    share = np.sqrt(COMMON), np.sqrt(1 - COMMON)
    gain, bias, gamma = (
        strength * most * (share[0] * rng.uniform(-1, 1) + share[1] * rng.uniform(-1, 1, 3))
        for most in (GAIN, BIAS, GAMMA)
    )
    values = np.linspace(0, 1, 256)[None] ** np.exp(gamma)[:, None]
    shifted = values * (1 + GAIN) ** (gain / GAIN)[:, None] + bias[:, None]
    return (np.clip(shifted, 0, 1) * 255).round().astype(np.uint8)


def _axis(rng: np.random.Generator) -> Floats:
    """Borders along one axis: piece by piece at another scale, the middle (the ego) where it was."""
    general = rng.uniform(-0.4, 0.4)
    step = np.empty(CELLS)
    at = 0
    while at < CELLS:
        length = max(1, round(rng.uniform(*PIECE) / CELL))
        step[at : at + length] = np.clip(general + rng.uniform(-0.8, 0.8), -1, 1)
        at += length
    borders = np.concatenate([[0.0], np.cumsum(STRETCH**step)])
    half: float = borders[CELLS // 2]
    return borders - half + CELLS / 2


def changed(images: Bytes, maps: Bytes, depth: Bytes, change: Change, mirror: list[int]) -> tuple[Bytes, Bytes, Bytes]:
    """A frame after a change; of a stretch, only the map is: the grid is stretched where it is made.

    Args:
        images: (C, 3, H, W).
        maps: (200, 200), packed.
        depth: (C, bins, h, w).
        mirror: the camera that stands in for each one in a mirrored frame.
    """
    if change.turned:
        images, maps, depth = images[mirror, ..., ::-1], maps[..., ::-1], depth[mirror, ..., ::-1]
    if change.colours is not None:
        images = np.stack([table[images[:, i]] for i, table in enumerate(change.colours)], 1)
    if change.stretch is not None:
        rows, columns = change.stretch.sources(CELLS)
        maps = maps[_nearest(rows)[:, None], _nearest(columns)]
    return images, maps, depth


def outside(stretch: Stretch) -> NDArray[np.bool_]:
    """Cells (200, 200) of a stretched map that lie outside of the true one."""
    rows, columns = (np.abs(axis) >= 1 for axis in stretch.sources(CELLS))
    return rows[:, None] | columns


def _nearest(places: Floats) -> NDArray[np.int64]:
    return np.clip(np.floor((places + 1) / 2 * CELLS), 0, CELLS - 1).astype(np.int64)

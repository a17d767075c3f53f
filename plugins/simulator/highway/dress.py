"""A town's streets in other clothes: sidewalks, lines, houses and trees as they might be elsewhere.

One town has one way of building. Eyes that were trained there alone take its habits for laws: that a road ends
at a sidewalk of 2 m, that houses stand behind it. The lanes stay where they are, so traffic of the town fits.
"""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import replace
from typing import TypeVar

import numpy as np

from me3bev_plugins.simulator.highway.town import Building, Lane, Marking, Sidewalk, Town

DRESSES = 8
"""How many there are of each town, beside its own."""
BARE = 0.35
"""Share of the dresses without sidewalks."""
HABITS: tuple[Marking, ...] = ("none", "solid", "broken", "yellow_solid", "yellow_broken")
KEPT_LINES = 0.6
"""Share of a lane's lines that stay as they are."""
WIDTHS = (0.5, 2.5)
"""Sidewalks are so many times as wide, at least and at most."""

T = TypeVar("T")


def dressed(town: Town, number: int) -> Town:
    """One of the town's dresses.

    Args:
        number: 1 to `DRESSES`; 0 for the town as it is.
    """
    if number == 0:
        return town
    rng = np.random.default_rng([number, zlib.crc32(town.name.encode())])
    return replace(
        town,
        lanes=tuple(_lane(lane, rng) for lane in town.lanes),
        sidewalks=() if number % DRESSES < BARE * DRESSES else _sidewalks(town.sidewalks, rng),
        crosswalks=_some(town.crosswalks, 0.8, rng),
        buildings=_buildings(town.buildings, rng),
        props=_some(town.props, rng.choice([0.0, 0.3, 1.0]), rng),
    )


def _some(things: Sequence[T], share: float, rng: np.random.Generator) -> tuple[T, ...]:
    return tuple(thing for thing, stays in zip(things, rng.random(len(things)) < share, strict=True) if stays)


def _lane(lane: Lane, rng: np.random.Generator) -> Lane:
    left, right = (
        mark if mark == "none" or rng.random() < KEPT_LINES else HABITS[rng.integers(len(HABITS))]
        for mark in (lane.left_marking, lane.right_marking)
    )
    return replace(lane, left_marking=left, right_marking=right)


def _sidewalks(walks: Sequence[Sidewalk], rng: np.random.Generator) -> tuple[Sidewalk, ...]:
    wider = rng.uniform(*WIDTHS)
    kept = _some(walks, 0.85, rng)
    return tuple(replace(walk, width=walk.width * wider, paved=walk.paved and rng.random() < 0.85) for walk in kept)


def _buildings(buildings: Sequence[Building], rng: np.random.Generator) -> tuple[Building, ...]:
    kept = _some(buildings, rng.choice([0.0, 0.2, 0.6, 1.0]), rng)
    changed = []
    for building in kept:
        length, width = np.array(building.size) * rng.uniform(0.6, 1.1, 2)
        red, green, blue = (int(value) for value in rng.integers(50, 220, 3))
        height = building.height * rng.uniform(0.4, 1.6)
        changed.append(replace(building, size=(length, width), height=height, colour=(red, green, blue)))
    return tuple(changed)

"""Houses, trees and poles beside the roads; a file says nothing of them, so they grow from the town's name."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from me3bev_cli.seeding import derive_seed
from me3bev_plugins.simulator.highway.opendrive.footprint import Footprint, rectangle
from me3bev_plugins.simulator.highway.opendrive.roadside import SPACING, Roadside
from me3bev_plugins.simulator.highway.town import Building, Floats, Prop

COLOURS = (
    (176, 128, 104),
    (196, 178, 150),
    (150, 152, 158),
    (122, 92, 78),
    (206, 198, 184),
    (134, 146, 160),
    (168, 104, 84),
    (110, 114, 120),
    (188, 160, 120),
    (222, 214, 196),
)
"""Render, brick, stone, glass."""
STYLES = 4
ISLAND = 1500.0
"""Square metres; nobody builds on a smaller patch between lanes."""
DOORSTEP = 6.0
"""Metres from the road's edge that are inside any house of a row."""
CLEAR = 1.0
"""Metres kept free around a building."""


def grow_scenery(
    name: str, roadsides: Iterable[Roadside], ground: Footprint
) -> tuple[tuple[Building, ...], tuple[Prop, ...]]:
    """Buildings and props that touch nothing.

    Args:
        name: of the town, from which everything grows.
        ground: lanes, surfaces, sidewalks and crosswalks taken; the buildings are added to it.
    """
    sides = list(roadsides)
    rng = np.random.default_rng(derive_seed("scenery", name))
    islands = ground.islands(ISLAND)
    ground.taken[islands] = 1
    buildings: list[Building] = []
    for side in sides:
        if side.urban:
            buildings += _row(side, rng, ground)
        elif not side.highway:
            buildings += _scattered(side, rng, ground)
    ground.taken[islands] = 0
    room = ground.clearance()
    props: list[Prop] = []
    for side in sides:
        poles = _poles(side)
        trees, crowns = _trees(side, rng)
        free = ground.sample(room, trees) > crowns + 0.3
        heights = rng.uniform(2.8, 4.2, len(trees)) * crowns
        props += [
            Prop("tree", (float(x), float(y)), float(h), float(r))
            for (x, y), h, r in zip(trees[free], heights[free], crowns[free], strict=True)
        ]
        tall = 10.0 if side.highway else 8.0
        props += [Prop("pole", (float(x), float(y)), tall, 0.12) for x, y in poles[ground.sample(room, poles) > 0.3]]
    return tuple(buildings), tuple(props)


def _row(side: Roadside, rng: np.random.Generator, ground: Footprint) -> list[Building]:
    """Houses one after another, 2 to 5 m behind the sidewalk."""
    row: list[Building] = []
    at = float(rng.uniform(0.0, 6.0))
    room = np.flatnonzero(ground.is_free(side.points + DOORSTEP * side.outward)) * SPACING
    while at < side.length:
        width, depth = float(rng.uniform(9.0, 24.0)), float(rng.uniform(8.0, 18.0))
        ahead = room[np.searchsorted(room, at + width / 2) :]
        if not len(ahead):
            break
        at = max(at, float(ahead[0]) - width / 2)
        house = _house(side, at + width / 2, (width, depth), float(rng.uniform(2.0, 5.0)), rng, ground)
        if house is None:
            at += 4.0
            continue
        row.append(house)
        at += width + float(rng.choice([1.5, 3.0, 8.0, 16.0], p=[0.4, 0.3, 0.2, 0.1]))
    return row


def _scattered(side: Roadside, rng: np.random.Generator, ground: Footprint) -> list[Building]:
    """Single houses well back from a country road."""
    houses: list[Building] = []
    at = float(rng.uniform(10.0, 90.0))
    while at < side.length:
        size = float(rng.uniform(8.0, 14.0)), float(rng.uniform(7.0, 11.0))
        house = _house(side, at, size, float(rng.uniform(8.0, 16.0)), rng, ground)
        if house is not None:
            houses.append(house)
        at += float(rng.uniform(60.0, 150.0))
    return houses


def _house(
    side: Roadside, at: float, size: tuple[float, float], setback: float, rng: np.random.Generator, ground: Footprint
) -> Building | None:
    """A house that fronts the road `at` metres along it, or None where there is no room."""
    index = min(int(at / SPACING), len(side.points) - 1)
    normal = side.outward[index]
    centre = side.points[index] + normal * (setback + size[1] / 2)
    heading = float(np.arctan2(normal[1], normal[0]) - np.pi / 2)
    outline = (size[0] + 2 * CLEAR, size[1] + 2 * CLEAR)
    if not bool(ground.is_free(_grid(centre, outline, heading)).all()):
        return None
    ground.add_polygons([rectangle(centre, outline, heading)])
    height = float(np.clip(rng.gamma(3.0, 3.2) + 4.0, 6.0, 25.0)) if side.urban else float(rng.uniform(6.0, 9.0))
    shade = rng.uniform(0.85, 1.1)
    red, green, blue = (int(np.clip(c * shade, 0, 255)) for c in COLOURS[int(rng.integers(len(COLOURS)))])
    place = (float(centre[0]), float(centre[1]))
    return Building(place, size, heading, height, (red, green, blue), int(rng.integers(STYLES)))


def _grid(centre: Floats, size: tuple[float, float], heading: float) -> Floats:
    """(P, 2) points over a box, no further apart than a metre."""
    u, v = (np.linspace(-n / 2, n / 2, int(np.ceil(n)) + 1) for n in size)
    cos, sin = np.cos(heading), np.sin(heading)
    local = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)
    return centre + local @ np.array([[cos, sin], [-sin, cos]])


def _along(side: Roadside, at: Floats, out: Floats) -> Floats:
    """(P, 2) points some metres along a roadside and some metres out from it."""
    index = np.minimum((at / SPACING).astype(np.int64), len(side.points) - 1)
    return side.points[index] + out[:, None] * side.outward[index]


def _trees(side: Roadside, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Places (P, 2) and crown radii (P,)."""
    nearest, furthest, spacing = (1.9, 4.0, 6.0) if side.urban else (7.0, 22.0, 16.0) if side.highway else (3, 12, 9.0)
    at = np.arange(float(rng.uniform(0.0, spacing)), side.length, spacing)
    at = at + rng.uniform(-0.3, 0.3, len(at)) * spacing
    at = np.clip(at[rng.random(len(at)) < 0.75], 0.0, None)
    crowns = rng.uniform(0.9, 1.7, len(at)) if side.urban else rng.uniform(1.2, 2.8, len(at))
    return _along(side, at, rng.uniform(nearest, furthest, len(at))), crowns


def _poles(side: Roadside) -> Floats:
    """Places (P, 2) of street lights in towns and on motorways, of wires in the country."""
    out, spacing = (0.8, 30.0) if side.urban else (1.8, 50.0) if side.highway else (2.4, 45.0)
    at = np.arange(spacing / 2, side.length, spacing)
    return _along(side, at, np.full(len(at), out))

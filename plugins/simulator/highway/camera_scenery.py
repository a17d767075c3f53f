"""A town's scenery for the cameras: houses, trees, poles, lights and signs, packed once and shared."""

from __future__ import annotations

import weakref
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from me3bev_cli.api import BEV_CLASSES
from me3bev_plugins.simulator.highway.camera_bridges import bridge_parts
from me3bev_plugins.simulator.highway.geometry import Shape
from me3bev_plugins.simulator.highway.ground import ground_of
from me3bev_plugins.simulator.highway.ground_tiles import Paint, Tiles, lookup
from me3bev_plugins.simulator.highway.raster_buffers import LABELS, NUMBERS, SHAPE, X, Y
from me3bev_plugins.simulator.highway.town import Building, Prop, Signal, Town

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

BLOCK = 32.0
"""Side of the grid's squares, metres."""
REPEATER = 2.6
"""Height of the second, lower head of a signal: who waits at a stop line does not see the upper one, metres."""
BUILDING = BEV_CLASSES.index("building")
_HEAD = (0.4, 0.62, 1.5)
"""Size of a signal head, metres."""
_RANGE = {
    Shape.BUILDING: 220.0,
    Shape.HOUSE: 220.0,
    Shape.TREE: 130.0,
    Shape.CONIFER: 130.0,
    Shape.POPLAR: 130.0,
    Shape.LAMP: 90.0,
    Shape.POLE: 90.0,
    Shape.SIGNAL: 120.0,
    Shape.BOX: 140.0,
}
LOW_HOUSE = 9.6
"""Houses up to this height have gabled roofs, metres."""
ARM = 2.2
"""Length of a street lamp's arm, metres."""
_ROOFS = ((142, 74, 56), (96, 88, 86), (120, 84, 66), (84, 92, 104))
_LEAVES = np.array([(70, 104, 48), (84, 116, 52), (60, 94, 54), (98, 118, 50)], np.float64)
_NEEDLES = np.array([(44, 78, 52), (52, 86, 54)], np.float64)


class Scenery(NamedTuple):
    """Things that stand still, in the world frame, sorted by square of a grid."""

    number: Floats
    label: Ints
    reach: Floats
    """(N,) farthest distance at which each is drawn."""
    side: NDArray[np.int8]
    """(N,) the ground level from which each is seen, -1 for both."""
    start: Ints
    """(rows * columns + 1,) first thing of each square."""
    rows: int
    columns: int
    origin: tuple[float, float]


_cache: weakref.WeakKeyDictionary[Town, Scenery] = weakref.WeakKeyDictionary()


def scenery_of(town: Town) -> Scenery:
    """The town's scenery; packed at the first call, then shared."""
    scenery = _cache.get(town)
    if scenery is None:
        scenery = _cache[town] = build_scenery(town)
    return scenery


class _Packer:
    """Collects rows of things."""

    def __init__(self) -> None:
        self.numbers: list[list[float]] = []
        self.labels: list[list[int]] = []
        self.sides: list[int] = []

    def add(
        self,
        shape: Shape,
        at: tuple[float, float],
        heading: float,
        size: tuple[float, float, float],
        colour: tuple[float, float, float] = (0, 0, 0),
        second: tuple[int, int, int] = (0, 0, 0),
        base: float = 0.0,
        semantic: int = 0,
        identity: int = -1,
        state: int = 0,
        side: int = -1,
    ) -> None:
        radius = 0.5 * float(np.sqrt(size[0] ** 2 + size[1] ** 2 + size[2] ** 2))
        packed = 65536 * second[0] + 256 * second[1] + second[2]
        pose = [at[0], at[1], float(np.cos(heading)), float(np.sin(heading))]
        self.numbers.append([*pose, *size, *colour, float(packed), base, radius])
        self.labels.append([int(shape), semantic, identity, state])
        self.sides.append(side)


def build_scenery(town: Town) -> Scenery:
    """Buildings, trees, lamps, signal heads with what carries them, signs, and bridges."""
    packer = _Packer()
    for k, building in enumerate(town.buildings):
        _add_building(packer, k, building)
    roads = town.arrays.xyz[:, :2]
    for k, prop in enumerate(town.props):
        _add_prop(packer, k, prop, roads)
    for signal in town.signals:
        _add_signal(packer, town, signal)
    for sign in town.signs:
        packer.add(Shape.POLE, sign.position[:2], sign.heading, (0.1, 0.1, 2.6))
        shape = Shape.STOP if sign.kind == "stop" else Shape.YIELD
        ahead = np.array(sign.position[:2]) - 0.08 * np.array([np.cos(sign.heading), np.sin(sign.heading)])
        packer.add(shape, (float(ahead[0]), float(ahead[1])), sign.heading, (0.8, 0.8, 0.8), base=1.9)
    for part in bridge_parts(town, ground_of(town)):
        packer.add(Shape.BOX, part.at, part.heading, part.size, part.colour, base=part.base, side=part.side)
    return _sorted(packer, town)


def _add_building(packer: _Packer, k: int, building: Building) -> None:
    red, green, blue = building.colour
    low = building.height <= LOW_HOUSE
    roof = _ROOFS[k % len(_ROOFS)] if low else (red // 3 + 50, green // 3 + 50, blue // 3 + 50)
    shape, size = Shape.HOUSE if low else Shape.BUILDING, (*building.size, building.height)
    colour = (red, green, blue)
    packer.add(
        shape, building.centre, building.heading, size, colour, roof, semantic=BUILDING, state=building.style % 4
    )


def _add_prop(packer: _Packer, k: int, prop: Prop, roads: Floats) -> None:
    """A tree of one of three kinds, or a street lamp whose arm reaches over the road."""
    if prop.kind == "pole":
        nearest = roads[np.argmin(((roads - np.array(prop.position)) ** 2).sum(1))]
        turn = float(np.arctan2(nearest[1] - prop.position[1], nearest[0] - prop.position[0]))
        packer.add(Shape.LAMP, prop.position, turn, (2 * ARM, 0.4, prop.height))
        return
    shape = (Shape.CONIFER, Shape.TREE, Shape.TREE, Shape.POPLAR, Shape.TREE)[k % 5]
    table = _NEEDLES if shape is Shape.CONIFER else _LEAVES
    leaf = table[(k * 7) % len(table)]
    spread = 2 * prop.radius
    packer.add(shape, prop.position, 2.4 * k, (spread, spread, prop.height), (leaf[0], leaf[1], leaf[2]))


def _add_signal(packer: _Packer, town: Town, signal: Signal) -> None:
    """The head, a post off the road with an arm to the head where that hangs over asphalt, and a lower head."""
    head, ahead = np.array(signal.position[:2]), np.array([np.cos(signal.heading), np.sin(signal.heading)])
    ground = float(town.lanes[signal.lanes[0]].points[-1, 2]) if signal.lanes else 0.0
    height = float(np.clip(signal.position[2] - ground, 2.4, 7.5))
    foot = _free_spot(ground_of(town).tiles, head + 0.35 * ahead, signal.heading)
    _add_head(packer, signal, head, height)
    if height > REPEATER + _HEAD[2]:
        _add_head(packer, signal, foot - 0.35 * ahead, REPEATER)
    packer.add(Shape.POLE, (float(foot[0]), float(foot[1])), 0.0, (0.2, 0.2, height + 0.6))
    arm = head + 0.35 * ahead - foot
    length = float(np.hypot(*arm))
    if length > 0.3:
        middle, turn = foot + 0.5 * arm, float(np.arctan2(arm[1], arm[0]))
        place = (float(middle[0]), float(middle[1]))
        packer.add(Shape.BOX, place, turn, (length, 0.12, 0.12), (96, 99, 104), base=height + 0.1)


def _add_head(packer: _Packer, signal: Signal, at: Floats, height: float) -> None:
    place, base = (float(at[0]), float(at[1])), height - 0.5 * _HEAD[2]
    packer.add(Shape.SIGNAL, place, signal.heading, _HEAD, base=base, identity=signal.id)


def _free_spot(tiles: Tiles, at: Floats, heading: float) -> Floats:
    """The nearest place off the road for a post, to the right of traffic or ahead if possible; else `at` itself."""
    for radius in np.arange(0.0, 26.0, 0.5):
        for turn in np.radians([-90.0, -60.0, -30.0, 0.0, 90.0, 45.0]):
            spot = at + radius * np.array([np.cos(heading + turn), np.sin(heading + turn)])
            if _paint_at(tiles, spot) in (Paint.GRASS, Paint.SIDEWALK, Paint.PATH, Paint.KERB):
                return np.asarray(spot)
    return at


def _paint_at(tiles: Tiles, spot: Floats) -> int:
    column, row = (spot - np.array(tiles.origin)) / tiles.cell
    return int(lookup(tiles.table[0], tiles.data, int(row), int(column)))


def _sorted(packer: _Packer, town: Town) -> Scenery:
    number = np.array(packer.numbers, np.float64).reshape(-1, NUMBERS)
    label = np.array(packer.labels, np.int64).reshape(-1, LABELS)
    at = number[:, [X, Y]]
    low = at.min(0) if len(at) else np.zeros(2)
    high = at.max(0) if len(at) else np.zeros(2)
    columns, rows = (int(n) + 1 for n in (high - low) / BLOCK)
    square = ((at[:, 1] - low[1]) // BLOCK).astype(np.int64) * columns + ((at[:, 0] - low[0]) // BLOCK).astype(np.int64)
    order = np.argsort(square, kind="stable")
    reach = np.array([_RANGE.get(Shape(shape), 90.0) for shape in label[order, SHAPE]], np.float64)
    return Scenery(
        number=np.ascontiguousarray(number[order]),
        label=np.ascontiguousarray(label[order]),
        reach=reach,
        side=np.array(packer.sides, np.int8)[order],
        start=np.searchsorted(square[order], np.arange(rows * columns + 1)).astype(np.int64),
        rows=rows,
        columns=columns,
        origin=(float(low[0]), float(low[1])),
    )

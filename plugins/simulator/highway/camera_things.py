"""What stands or moves in a town, as rows of `raster.Things`: scenery packed once, actors at every frame."""

from __future__ import annotations

import weakref
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from me3bev_cli.api import BEV_CLASSES
from me3bev_plugins.simulator.highway.geometry import Shape
from me3bev_plugins.simulator.highway.ground import ground_of
from me3bev_plugins.simulator.highway.ground_levels import Levels, hidden, level_of
from me3bev_plugins.simulator.highway.ground_tiles import Paint, Tiles, lookup
from me3bev_plugins.simulator.highway.raster import (
    BASE,
    BLUE,
    COS,
    GREEN,
    HEIGHT,
    IDENTITY,
    LABELS,
    LENGTH,
    NUMBERS,
    RADIUS,
    RED,
    SECOND,
    SEMANTIC,
    SHAPE,
    SIN,
    STATE,
    WIDTH,
    Things,
    X,
    Y,
)
from me3bev_plugins.simulator.highway.scene import Kind, Scene
from me3bev_plugins.simulator.highway.town import Signal, Town

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

BLOCK = 32.0
"""Side of the grid's squares, metres."""
ACTOR_RANGE = 140.0
REPEATER = 2.6
"""Height of the second, lower head of a signal: who waits at a stop line does not see the upper one, metres."""
BUILDING, VEHICLE, PEDESTRIAN = (BEV_CLASSES.index(name) for name in ("building", "vehicle", "pedestrian"))
_KIND_MOTORCYCLE, _KIND_TRUCK, _KIND_PEDESTRIAN = int(Kind.MOTORCYCLE), int(Kind.TRUCK), int(Kind.PEDESTRIAN)
_SHAPE_STRIDE, _SHAPE_SIGNAL = int(Shape.STRIDE), int(Shape.SIGNAL)
_RANGE = {Shape.BUILDING: 220.0, Shape.TREE: 130.0, Shape.CONIFER: 130.0, Shape.POLE: 90.0, Shape.SIGNAL: 120.0}
_LEAVES = np.array([(70, 104, 48), (84, 116, 52), (60, 94, 54), (98, 118, 50)], np.float64)
_NEEDLES = np.array([(44, 78, 52), (52, 86, 54)], np.float64)


class Scenery(NamedTuple):
    """Things that stand still, in the world frame, sorted by square of a grid."""

    number: Floats
    label: Ints
    reach: Floats
    """(N,) farthest distance at which each is drawn."""
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
    ) -> None:
        radius = 0.5 * float(np.sqrt(size[0] ** 2 + size[1] ** 2 + size[2] ** 2))
        packed = 65536 * second[0] + 256 * second[1] + second[2]
        pose = [at[0], at[1], float(np.cos(heading)), float(np.sin(heading))]
        self.numbers.append([*pose, *size, *colour, float(packed), base, radius])
        self.labels.append([int(shape), semantic, identity, state])


def build_scenery(town: Town) -> Scenery:
    """Buildings, trees, poles, signal heads with what carries them, and signs."""
    packer = _Packer()
    for building in town.buildings:
        red, green, blue = building.colour
        roof = (red // 3 + 50, green // 3 + 50, blue // 3 + 50)
        size = (*building.size, building.height)
        packer.add(Shape.BUILDING, building.centre, building.heading, size, (red, green, blue), roof, semantic=BUILDING)
    for k, prop in enumerate(town.props):
        turn = 2.4 * k
        if prop.kind == "tree":
            conifer = k % 5 == 0
            table = _NEEDLES if conifer else _LEAVES
            spread = 2 * prop.radius
            leaf = table[(k * 7) % len(table)]
            shape = Shape.CONIFER if conifer else Shape.TREE
            packer.add(shape, prop.position, turn, (spread, spread, prop.height), (leaf[0], leaf[1], leaf[2]))
        else:
            packer.add(Shape.POLE, prop.position, turn, (0.22, 0.22, prop.height))
    for signal in town.signals:
        _add_signal(packer, town, signal)
    for sign in town.signs:
        packer.add(Shape.POLE, sign.position[:2], sign.heading, (0.1, 0.1, 2.6))
        shape = Shape.STOP if sign.kind == "stop" else Shape.YIELD
        ahead = np.array(sign.position[:2]) - 0.08 * np.array([np.cos(sign.heading), np.sin(sign.heading)])
        packer.add(shape, (float(ahead[0]), float(ahead[1])), sign.heading, (0.8, 0.8, 0.8), base=1.9)
    return _sorted(packer, town)


def _add_signal(packer: _Packer, town: Town, signal: Signal) -> None:
    """The head, and a post beside the road with an arm where the head hangs over the asphalt."""
    forward = np.array([np.cos(signal.heading), np.sin(signal.heading)])
    right = np.array([forward[1], -forward[0]])
    head = np.array(signal.position[:2])
    ground = float(town.lanes[signal.lanes[0]].points[-1, 2]) if signal.lanes else 0.0
    height = float(np.clip(signal.position[2] - ground, 2.4, 7.5))
    size = (0.4, 0.62, 1.5)
    for level in (height, REPEATER) if height > REPEATER + size[2] else (height,):
        place = (float(head[0]), float(head[1]))
        packer.add(Shape.SIGNAL, place, signal.heading, size, base=level - 0.5 * size[2], identity=signal.id)
    tiles = ground_of(town).tiles
    foot = head + 0.35 * forward
    for step in np.arange(0.0, 16.0, 0.5):
        spots = [head + 0.35 * forward + side * step * right for side in (1.0, -1.0)]
        free = [spot for spot in spots if _paint_at(tiles, spot) in (Paint.GRASS, Paint.SIDEWALK, Paint.PATH)]
        if free:
            foot = free[0]
            break
    packer.add(Shape.POLE, (float(foot[0]), float(foot[1])), 0.0, (0.2, 0.2, height + 0.6))
    arm = head + 0.35 * forward - foot
    length = float(np.hypot(*arm))
    if length > 0.3:
        middle = foot + 0.5 * arm
        packer.add(
            Shape.BOX,
            (float(middle[0]), float(middle[1])),
            float(np.arctan2(arm[1], arm[0])),
            (length, 0.12, 0.12),
            (96, 99, 104),
            base=height + 0.1,
        )


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
        start=np.searchsorted(square[order], np.arange(rows * columns + 1)).astype(np.int64),
        rows=rows,
        columns=columns,
        origin=(float(low[0]), float(low[1])),
    )


class Gathering:
    """Room for what is near the ego in one town, filled anew for every scene.

    Args:
        town: the world's fixed part.
    """

    def __init__(self, town: Town) -> None:
        self.ground = ground_of(town)
        self.scenery = scenery_of(town)
        self.things = _things(256 + len(self.scenery.number))

    def collect(self, scene: Scene, sight: float) -> tuple[Floats, int, int]:
        """Fills `things` with what is within `sight` metres.

        Returns:
            The ego's pose (x, y, cosine and sine of heading), the number of things and the ground level.
        """
        ego, actors = scene.ego, scene.actors
        level = level_of(self.ground.levels, ego.x, ego.y, ego.z)
        pose = np.array([ego.x, ego.y, np.cos(ego.heading), np.sin(ego.heading)])
        if len(self.scenery.number) + len(actors) > len(self.things.number):
            self.things = _things(2 * len(actors) + len(self.scenery.number))
        lights = np.ascontiguousarray(scene.lights, np.int32)
        count = gather_scenery(self.scenery, pose, sight, lights, self.things)
        columns = (actors.x, actors.y, actors.z, actors.heading, actors.speed)
        place = np.stack([*columns, actors.length, actors.width, actors.height], axis=1).astype(np.float64)
        state = (actors.kind, actors.colour, actors.braking)
        count = gather_actors(place, *state, pose, self.ground.levels, level, count, self.things)
        return pose, count, level


def _things(rows: int) -> Things:
    return Things(number=np.zeros((rows, NUMBERS)), label=np.zeros((rows, LABELS), np.int64))


@njit(cache=True, error_model="numpy")
def gather_scenery(scenery: Scenery, pose: Floats, farthest: float, lights: NDArray[np.int32], things: Things) -> int:
    """Copies what is near into `things`, in the ego frame; returns how many."""
    count = 0
    c0 = max(0, int((pose[0] - farthest - scenery.origin[0]) // BLOCK))
    c1 = min(scenery.columns - 1, int((pose[0] + farthest - scenery.origin[0]) // BLOCK))
    r0 = max(0, int((pose[1] - farthest - scenery.origin[1]) // BLOCK))
    r1 = min(scenery.rows - 1, int((pose[1] + farthest - scenery.origin[1]) // BLOCK))
    for row in range(r0, r1 + 1):
        if c1 < c0:
            break
        for i in range(scenery.start[row * scenery.columns + c0], scenery.start[row * scenery.columns + c1 + 1]):
            n = scenery.number[i]
            dx, dy = n[X] - pose[0], n[Y] - pose[1]
            if dx * dx + dy * dy > (scenery.reach[i] + n[RADIUS]) ** 2:
                continue
            things.number[count] = n
            things.label[count] = scenery.label[i]
            _to_ego(things.number[count], dx, dy, pose)
            if scenery.label[i, SHAPE] == _SHAPE_SIGNAL:
                things.label[count, STATE] = lights[scenery.label[i, IDENTITY]]
                things.label[count, IDENTITY] = -1
            count += 1
    return count


@njit(cache=True, error_model="numpy")
def _to_ego(number: Floats, dx: float, dy: float, pose: Floats) -> None:
    """Turns a row's pose from the world into the ego frame."""
    cos, sin = number[COS], number[SIN]
    number[X], number[Y] = pose[2] * dx + pose[3] * dy, pose[2] * dy - pose[3] * dx
    number[COS], number[SIN] = cos * pose[2] + sin * pose[3], sin * pose[2] - cos * pose[3]


@njit(cache=True, error_model="numpy")
def gather_actors(
    place: Floats,
    kind: NDArray[np.int32],
    colour: NDArray[np.uint8],
    braking: NDArray[np.bool_],
    pose: Floats,
    levels: Levels,
    level: int,
    count: int,
    things: Things,
) -> int:
    """Appends the actors near the ego that its ground level shows; `place` (A, 8) is x, y, z, heading, speed, length,
    width, height. Returns the new count."""
    for i in range(len(kind)):
        dx, dy = place[i, 0] - pose[0], place[i, 1] - pose[1]
        if dx * dx + dy * dy > ACTOR_RANGE**2 or hidden(levels, level, place[i, 0], place[i, 1], place[i, 2]):
            continue
        n, label = things.number[count], things.label[count]
        n[COS], n[SIN] = np.cos(place[i, 3]), np.sin(place[i, 3])
        _to_ego(n, dx, dy, pose)
        n[LENGTH], n[WIDTH], n[HEIGHT] = place[i, 5], place[i, 6], place[i, 7]
        n[RED], n[GREEN], n[BLUE] = colour[i, 0], colour[i, 1], colour[i, 2]
        n[BASE] = 0.0
        n[RADIUS] = 0.6 * np.sqrt(n[LENGTH] ** 2 + n[WIDTH] ** 2 + n[HEIGHT] ** 2)
        label[SHAPE], label[IDENTITY], label[STATE] = kind[i], i, 1 if braking[i] else 0
        label[SEMANTIC] = VEHICLE
        tone = (i * 37) % 64
        n[SECOND] = 65536.0 * (36 + tone) + 256.0 * (38 + tone // 2) + (52 + tone // 3)
        if kind[i] == _KIND_TRUCK:
            n[SECOND] = 65536.0 * (216 - tone) + 256.0 * (216 - tone) + (212 - tone // 2)
        elif kind[i] == _KIND_PEDESTRIAN:
            label[SEMANTIC] = PEDESTRIAN
            if abs(place[i, 4]) > 0.1 and int(np.floor((place[i, 0] + place[i, 1]) / 0.45)) % 2 == 0:
                label[SHAPE] = _SHAPE_STRIDE
        count += 1
    return count

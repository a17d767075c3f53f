"""What is near the ego, as rows of `raster.Things` in its frame: scenery and actors, gathered at every frame."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from me3bev_cli.api import BEV_CLASSES
from me3bev_plugins.simulator.highway.camera_scenery import BLOCK, BUILDING, Scenery, scenery_of
from me3bev_plugins.simulator.highway.compiled import kernel
from me3bev_plugins.simulator.highway.geometry import BODIES, Shape
from me3bev_plugins.simulator.highway.ground import ground_of
from me3bev_plugins.simulator.highway.ground_levels import Levels, hidden, level_of
from me3bev_plugins.simulator.highway.raster import sort_things
from me3bev_plugins.simulator.highway.raster_buffers import (
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
    make_things,
)
from me3bev_plugins.simulator.highway.scene import Kind, Scene
from me3bev_plugins.simulator.highway.town import Town

__all__ = ["BUILDING", "PEDESTRIAN", "VEHICLE", "Gathering"]

Floats = NDArray[np.float64]

ACTOR_RANGE = 140.0
"""Actors are drawn up to here, metres."""
VEHICLE, PEDESTRIAN = BEV_CLASSES.index("vehicle"), BEV_CLASSES.index("pedestrian")
_KIND_CAR, _KIND_TRUCK, _KIND_PEDESTRIAN = int(Kind.CAR), int(Kind.TRUCK), int(Kind.PEDESTRIAN)
_BODIES = np.array(BODIES, np.int64)
_SHAPE_STRIDE, _SHAPE_SIGNAL = int(Shape.STRIDE), int(Shape.SIGNAL)


class Gathering:
    """Room for what is near the ego in one town, filled anew for every scene.

    Args:
        town: the world's fixed part.
    """

    def __init__(self, town: Town) -> None:
        self.ground = ground_of(town)
        self.scenery = scenery_of(town)
        self.things = make_things(256 + len(self.scenery.number))

    def collect(self, scene: Scene, sight: float) -> tuple[Floats, int, int]:
        """Fills `things` with what is within `sight` metres.

        Returns:
            The ego's pose (x, y, cosine and sine of heading), the number of things and the ground level.
        """
        ego, actors = scene.ego, scene.actors
        level = level_of(self.ground.levels, ego.x, ego.y, ego.z)
        pose = np.array([ego.x, ego.y, np.cos(ego.heading), np.sin(ego.heading)])
        if len(self.scenery.number) + len(actors) > len(self.things.number):
            self.things = make_things(2 * len(actors) + len(self.scenery.number))
        lights = np.ascontiguousarray(scene.lights, np.int32)
        count = gather_scenery(self.scenery, pose, sight, level, lights, self.things)
        columns = (actors.x, actors.y, actors.z, actors.heading, actors.speed)
        place = np.stack([*columns, actors.length, actors.width, actors.height], axis=1).astype(np.float64)
        state = (actors.kind.astype(np.int32), actors.colour.astype(np.uint8), actors.braking.astype(np.bool_))
        count = gather_actors(place, *state, pose, self.ground.levels, level, count, self.things)
        sort_things(self.things, count)
        return pose, count, level


@kernel
def gather_scenery(
    scenery: Scenery, pose: Floats, farthest: float, level: int, lights: NDArray[np.int32], things: Things
) -> int:
    """Copies what is near and seen from a ground level into `things`, in the ego frame; returns how many."""
    count = 0
    c0 = max(0, int((pose[0] - farthest - scenery.origin[0]) // BLOCK))
    c1 = min(scenery.columns - 1, int((pose[0] + farthest - scenery.origin[0]) // BLOCK))
    r0 = max(0, int((pose[1] - farthest - scenery.origin[1]) // BLOCK))
    r1 = min(scenery.rows - 1, int((pose[1] + farthest - scenery.origin[1]) // BLOCK))
    for row in range(r0, r1 + 1):
        if c1 < c0:
            break
        for i in range(scenery.start[row * scenery.columns + c0], scenery.start[row * scenery.columns + c1 + 1]):
            if scenery.side[i] >= 0 and scenery.side[i] != level:
                continue
            n = scenery.number[i]
            dx, dy = n[X] - pose[0], n[Y] - pose[1]
            if dx * dx + dy * dy > (scenery.reach[i] + n[RADIUS]) ** 2:
                continue
            for k in range(NUMBERS):
                things.number[count, k] = n[k]
            for k in range(LABELS):
                things.label[count, k] = scenery.label[i, k]
            _to_ego(things.number[count], dx, dy, pose)
            if scenery.label[i, SHAPE] == _SHAPE_SIGNAL:
                signal = scenery.label[i, IDENTITY]
                things.label[count, STATE] = lights[signal] if signal < len(lights) else 0
                things.label[count, IDENTITY] = -1
            count += 1
    return count


@kernel
def _to_ego(number: Floats, dx: float, dy: float, pose: Floats) -> None:
    """Turns a row's pose from the world into the ego frame."""
    cos, sin = number[COS], number[SIN]
    number[X], number[Y] = pose[2] * dx + pose[3] * dy, pose[2] * dy - pose[3] * dx
    number[COS], number[SIN] = cos * pose[2] + sin * pose[3], sin * pose[2] - cos * pose[3]


@kernel
def shape_of(kind: int, i: int) -> int:
    """The mesh of the actor in row `i`; cars have several bodies."""
    return _BODIES[i % len(_BODIES)] if kind == _KIND_CAR else kind


@kernel
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
        label[SHAPE], label[IDENTITY], label[STATE] = shape_of(kind[i], i), i, 1 if braking[i] else 0
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

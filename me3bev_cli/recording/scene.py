"""Other road users and the route as `foxglove.SceneUpdate`: boxes and a line, as viewers draw them."""

from __future__ import annotations

import struct
from functools import cache
from typing import Any

import numpy as np
from foxglove_schemas_protobuf.CubePrimitive_pb2 import CubePrimitive
from foxglove_schemas_protobuf.LinePrimitive_pb2 import LinePrimitive
from foxglove_schemas_protobuf.SceneEntity_pb2 import SceneEntity
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from numpy.typing import NDArray

from me3bev_cli.api import Actors
from me3bev_cli.recording.messages import stamp

REACH = 100.0
"""Metres around the ego beyond which nobody is recorded."""
COLOURS = np.array(
    [
        (0.25, 0.53, 1.0),  # car
        (0.16, 0.66, 0.82),  # van
        (0.42, 0.36, 0.90),  # truck
        (0.10, 0.80, 0.55),  # motorcycle
        (0.94, 0.24, 0.27),  # pedestrian
    ]
)
"""(5, 3) r, g, b of each of `api.ACTOR_KINDS`."""
_NUMBERS = 12
"""Of a box: position, z and w of the orientation, size, colour."""


def _cube(n: list[float]) -> CubePrimitive:
    cube = CubePrimitive()
    place, turn, size, colour = cube.pose.position, cube.pose.orientation, cube.size, cube.color
    place.x, place.y, place.z, turn.z, turn.w = n[:5]
    size.x, size.y, size.z = n[5:8]
    colour.r, colour.g, colour.b, colour.a = n[8:]
    return cube


@cache
def _template() -> tuple[NDArray[np.uint8], tuple[int, ...]]:
    """One box of an entity as bytes, and where its numbers are in them.

    Doubles have a fixed width in protobuf, so that all boxes look alike but for their numbers: a hundred of them are
    filled in at once, which is many times faster than a hundred messages.
    """
    marks = [1.5 + 0.001 * i for i in range(_NUMBERS)]
    data = SceneEntity(cubes=[_cube(marks)]).SerializeToString()
    return np.frombuffer(data, np.uint8), tuple(data.index(struct.pack("<d", mark)) for mark in marks)


def _boxes(numbers: NDArray[np.float64]) -> bytes:
    """The field `cubes` of an entity, from (A, 12)."""
    template, places = _template()
    out = np.tile(template, (len(numbers), 1))
    raw = np.ascontiguousarray(numbers, "<f8").view(np.uint8).reshape(len(numbers), _NUMBERS, 8)
    for i, place in enumerate(places):
        out[:, place : place + 8] = raw[:, i]
    return out.tobytes()


def actors_data(actors: Actors, around: tuple[float, float], time: int) -> bytes:
    """A serialised SceneUpdate of the actors near a place of the world."""
    boxes = actors.boxes
    near = np.hypot(boxes[:, 0] - around[0], boxes[:, 1] - around[1]) <= REACH
    boxes, kinds = boxes[near], actors.kinds[near]
    numbers = np.empty((len(boxes), _NUMBERS))
    numbers[:, :3], numbers[:, 5:8] = boxes[:, :3], boxes[:, 4:7]
    numbers[:, 2] += 0.5 * boxes[:, 6]  # A cube's place is its middle.
    half = 0.5 * boxes[:, 3]
    numbers[:, 3], numbers[:, 4] = np.sin(half), np.cos(half)
    numbers[:, 8:11], numbers[:, 11] = COLOURS[kinds], 0.85
    entity = SceneEntity(timestamp=stamp(time), frame_id="map", id="actors").SerializeToString() + _boxes(numbers)
    return _wrapped(entity)


def _wrapped(entity: bytes) -> bytes:
    """A SceneUpdate of one entity that is serialised already."""
    head = SceneUpdate.DESCRIPTOR.fields_by_name["entities"].number << 3 | 2
    length, varint = len(entity), bytearray([head])
    while length > 127:
        varint.append(length & 127 | 128)
        length >>= 7
    varint.append(length)
    return bytes(varint) + entity


def route_message(line: NDArray[np.float64], time: int) -> SceneUpdate:
    """The route (P, 3), world, as a line that stays."""
    entity = SceneEntity(timestamp=stamp(time), frame_id="map", id="route")
    drawn = entity.lines.add(type=LinePrimitive.LINE_STRIP, thickness=0.4)
    drawn.pose.orientation.w = 1.0
    for x, y, z in line.tolist():
        drawn.points.add(x=x, y=y, z=z + 0.1)
    drawn.color.r, drawn.color.g, drawn.color.b, drawn.color.a = 0.2, 0.85, 0.4, 0.9
    return SceneUpdate(entities=[entity])


def boxes_array(message: Any) -> NDArray[np.float64]:
    """The boxes of a SceneUpdate, (A, 7): x, y, z of the middle of the underside, heading, length, width, height."""
    rows = [
        (c.pose.position.x, c.pose.position.y, c.pose.position.z - 0.5 * c.size.z,
         2 * np.arctan2(c.pose.orientation.z, c.pose.orientation.w), c.size.x, c.size.y, c.size.z)
        for entity in message.entities for c in entity.cubes
    ]  # fmt: skip
    return np.array(rows, np.float64).reshape(-1, 7)

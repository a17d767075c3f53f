"""The messages of a frame's parts into arrays."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.Grid_pb2 import Grid
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from mcap.records import Schema
from numpy.typing import NDArray

from me3bev_cli.errors import LogError
from me3bev_cli.recording import topics
from me3bev_cli.recording.messages import decode_image, grid_array, raw_array
from me3bev_cli.recording.scene import boxes_array
from me3bev_cli.recording.writer import schema_bytes


class Form(NamedTuple):
    """How a part of a frame is stored and what it becomes."""

    schemas: tuple[str, ...]
    """Any of these."""
    decode: Callable[[Any, NDArray[Any] | None], Any]
    """Message, and an array that may be filled instead of a new one -> what it holds."""


def _image(message: Any, out: NDArray[np.uint8] | None) -> NDArray[np.uint8]:
    if isinstance(message, CompressedImage):
        return decode_image(message.data, out)
    if message.encoding not in ("rgb8", "bgr8") or len(message.data) != message.height * message.step:
        raise LogError(f"a foxglove.RawImage is encoded as '{message.encoding}'", allowed="rgb8, bgr8")
    rows = np.frombuffer(message.data, np.uint8).reshape(message.height, message.step)
    pixels = rows[:, : 3 * message.width].reshape(message.height, message.width, 3)
    return np.ascontiguousarray((pixels if message.encoding == "rgb8" else pixels[:, :, ::-1]).transpose(2, 0, 1))


def _raw(message: Any, _: Any) -> NDArray[Any]:
    return raw_array(message)


def _grid(message: Any, _: Any) -> NDArray[np.uint8]:
    return grid_array(message)


def _boxes(message: Any, _: Any) -> NDArray[np.float64]:
    return boxes_array(message)


def _pose(message: Any, _: Any) -> NDArray[np.float64]:
    turn = message.rotation
    heading = math.atan2(2 * (turn.w * turn.z + turn.x * turn.y), 1 - 2 * (turn.y**2 + turn.z**2))
    return np.array([message.translation.x, message.translation.y, heading])


def _fields(message: Any, _: Any) -> dict[str, Any]:
    return {field.name: getattr(message, field.name) for field in message.DESCRIPTOR.fields if field.number > 1}


def _vector(message: Any, _: Any) -> NDArray[np.float32]:
    return np.array(message.values, np.float32)


def _action(message: Any, _: Any) -> NDArray[np.float32]:
    return np.array([message.steering, message.longitudinal], np.float32)


def _number(message: Any, _: Any) -> float:
    return float(message.value)


FORMS: Mapping[str, Form] = {
    "images": Form(("foxglove.CompressedImage", "foxglove.RawImage"), _image),
    "depth": Form(("foxglove.RawImage",), _raw),
    "semantics": Form(("foxglove.RawImage",), _raw),
    "bev": Form(("foxglove.Grid",), _grid),
    "pose": Form(("foxglove.FrameTransform",), _pose),
    "actors": Form(("foxglove.SceneUpdate",), _boxes),
    **dict.fromkeys(topics.VECTORS, Form(("me3bev.Vector",), _vector)),
    "action": Form(("me3bev.Action",), _action),
    "reward": Form(("me3bev.Number",), _number),
    "speed": Form(("me3bev.Number",), _number),
    "infractions": Form(("me3bev.Infractions",), _fields),
    "state": Form(("me3bev.State",), _fields),
}
"""Part of a frame -> how it is read."""

_OURS = (topics.Vector, topics.Action, topics.Number, topics.Infractions, topics.State)
_CLASSES = {c.DESCRIPTOR.full_name: c for c in (CompressedImage, RawImage, Grid, FrameTransform, SceneUpdate, *_OURS)}


def check_schema(part: str, topic: str, schema: Schema | None, encoding: str, where: str) -> None:
    """Raises LogError when a topic's messages are not what the part is made of."""
    wanted = FORMS[part].schemas
    name = schema.name if schema is not None else "no schema"
    if schema is None or name not in wanted or encoding != "protobuf":
        raise LogError(
            f"topic {topic} holds {name} in {encoding or 'no encoding'}, which cannot be read as `{part}`",
            where=where,
            allowed=" or ".join(wanted) + " in protobuf",
        )


@lru_cache(maxsize=64)
def _class(name: str, definition: bytes) -> Any:
    """A message's class. Our own messages may have had other fields when the file was written, which says so itself."""
    known = _CLASSES[name]
    if not name.startswith("me3bev.") or definition == schema_bytes(known):
        return known
    pool = descriptor_pool.DescriptorPool()
    files = descriptor_pb2.FileDescriptorSet.FromString(definition)
    for file in files.file:
        pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(name))


def parse(schema: Schema, data: bytes) -> Any:
    """A protobuf message of a schema that `check_schema` has let pass."""
    return _class(schema.name, schema.data).FromString(data)

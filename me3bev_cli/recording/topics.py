"""Names of topics, and the messages of our own beside Foxglove's.

Of every step a log has one message on each of `STEP_TOPICS`, on each camera's image topic, on `/tf`, `/bev/truth` and
`/scene/actors`. All of them carry the time at which the observation was taken; `/state`, `/reward`, `/speed` and
`/infractions` tell what then came of the action, and the four of them are the step's `StepRecord`.
"""

from __future__ import annotations

from typing import Any, get_type_hints

from google.protobuf import descriptor_pb2, descriptor_pool, message_factory, timestamp_pb2

from me3bev_cli.api import StepRecord

BEV, TRANSFORM, ACTORS, ROUTE = "/bev/truth", "/tf", "/scene/actors", "/scene/route"
VECTORS = {"road": "/observation/road", "vehicle": "/observation/vehicle", "navigation": "/observation/navigation"}
ACTION, REWARD, SPEED, INFRACTIONS, STATE = "/action", "/reward", "/speed", "/infractions", "/state"
RECORD_TOPICS = (STATE, REWARD, SPEED, INFRACTIONS)
STEP_TOPICS = (*VECTORS.values(), ACTION, *RECORD_TOPICS)

_HINTS = get_type_hints(StepRecord)
INFRACTION_FIELDS = (
    "collision", "contact", "at_fault", "red_light", "stop_sign", "lane_departure", "off_road", "off_route",
)  # fmt: skip
STATE_FIELDS = tuple(name for name in _HINTS if name not in (*INFRACTION_FIELDS, "reward", "speed"))


def image_topic(camera: str) -> str:
    """Topic of a camera's images."""
    return f"/camera/{camera}/image"


def calibration_topic(camera: str) -> str:
    """Topic of a camera's calibration."""
    return f"/camera/{camera}/calibration"


def mount_topic(camera: str) -> str:
    """Topic that says where a camera sits on the ego. Each has its own: viewers remember a topic's last message."""
    return f"/camera/{camera}/transform"


def depth_topic(camera: str) -> str:
    """Topic of a camera's depth."""
    return f"/camera/{camera}/depth"


def semantics_topic(camera: str) -> str:
    """Topic of the classes of a camera's pixels."""
    return f"/camera/{camera}/semantics"


_Field = descriptor_pb2.FieldDescriptorProto
_KINDS = {float: _Field.TYPE_DOUBLE, bool: _Field.TYPE_BOOL, str: _Field.TYPE_STRING}
_FORMS: dict[str, tuple[tuple[str, int], ...]] = {
    "Action": (("steering", _Field.TYPE_FLOAT), ("longitudinal", _Field.TYPE_FLOAT)),
    "Number": (("value", _Field.TYPE_DOUBLE),),
    "Infractions": tuple((name, _KINDS[_HINTS[name]]) for name in INFRACTION_FIELDS),
    "State": tuple((name, _KINDS[_HINTS[name]]) for name in STATE_FIELDS),
}


def _file() -> descriptor_pb2.FileDescriptorProto:
    """The .proto of our messages. Each has a `timestamp` first, as Foxglove's have."""
    time = timestamp_pb2.Timestamp.DESCRIPTOR
    file = descriptor_pb2.FileDescriptorProto(
        name="me3bev/log.proto", package="me3bev", syntax="proto3", dependency=[time.file.name]
    )
    for name, fields in (("Vector", ()), *_FORMS.items()):
        form = file.message_type.add(name=name)
        form.field.add(
            name="timestamp", number=1, label=_Field.LABEL_OPTIONAL, type=_Field.TYPE_MESSAGE,
            type_name=f".{time.full_name}",
        )  # fmt: skip
        for number, (field, kind) in enumerate(fields, 2):
            form.field.add(name=field, number=number, label=_Field.LABEL_OPTIONAL, type=kind)
    vector = file.message_type[0]
    vector.field.add(name="values", number=2, label=_Field.LABEL_REPEATED, type=_Field.TYPE_FLOAT)
    return file


_POOL = descriptor_pool.Default()
_POOL.AddSerializedFile(_file().SerializeToString())


def _form(name: str) -> Any:
    return message_factory.GetMessageClass(_POOL.FindMessageTypeByName(f"me3bev.{name}"))


Vector, Action, Number, Infractions, State = (
    _form(name) for name in ("Vector", "Action", "Number", "Infractions", "State")
)
"""Classes of protobuf messages."""

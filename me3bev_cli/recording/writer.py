"""One episode to one MCAP file, which existing viewers open as it is."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, get_type_hints

import numpy as np
from mcap.well_known import MessageEncoding, SchemaEncoding
from mcap.writer import CompressionType, Writer
from mcap_protobuf.schema import register_schema
from numpy.typing import NDArray

from me3bev_cli.api import Rig, StepRecord
from me3bev_cli.recording import messages

STEP_TOPIC, BEV_TOPIC, TRANSFORM_TOPIC = "/step", "/bev/truth", "/tf"
BEV_CELL = 0.5
"""Metres per cell of the semantic truth."""

_NUMBERS = {"type": "array", "items": {"type": "number"}}
STEP_SCHEMA = {
    "title": "me3bev.Step",
    "type": "object",
    "properties": {
        "road": _NUMBERS,
        "vehicle": _NUMBERS,
        "navigation": _NUMBERS,
        "action": _NUMBERS,
        "record": {
            "type": "object",
            "properties": {
                name: {"type": {str: "string", bool: "boolean"}.get(kind, "number")}
                for name, kind in get_type_hints(StepRecord).items()
            },
        },
    },
}


def image_topic(camera: str) -> str:
    """Topic of a camera's images."""
    return f"/camera/{camera}/image"


def calibration_topic(camera: str) -> str:
    """Topic of a camera's calibration."""
    return f"/camera/{camera}/calibration"


class EpisodeWriter:
    """Writes to a temporary name; `finish` renames. Leaving the block by an exception leaves no file.

    Args:
        path: the file to make.
        rig: the cameras, in the order of the images.
        metadata: recipe, map, density, weather, seed, versions; kept in the file.
        quality: of JPEG, 1 to 100; 0 writes lossless PNG.
    """

    def __init__(self, path: Path, rig: Rig, metadata: Mapping[str, str], quality: int = 92) -> None:
        self.path, self.rig, self.quality = path, rig, quality
        self.temporary = path.with_name(f".{path.name}.part")
        self._file = open(self.temporary, "wb")  # noqa: SIM115 - closed by finish or __exit__
        self._writer = Writer(self._file, chunk_size=1 << 20, compression=CompressionType.ZSTD)
        self._writer.start(profile="", library="me3bev")
        self._writer.add_metadata("me3bev", dict(metadata))
        schema_text = json.dumps(STEP_SCHEMA).encode()
        schema = self._writer.register_schema("me3bev.Step", SchemaEncoding.JSONSchema, schema_text)
        self._step = self._writer.register_channel(STEP_TOPIC, MessageEncoding.JSON, schema)
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, int] = {}
        self._time = 0

    def _write(self, topic: str, message: Any) -> None:
        name = message.DESCRIPTOR.full_name
        if name not in self._schemas:
            self._schemas[name] = register_schema(self._writer, type(message))
        if topic not in self._channels:
            self._channels[topic] = self._writer.register_channel(topic, MessageEncoding.Protobuf, self._schemas[name])
        self._writer.add_message(self._channels[topic], self._time, message.SerializeToString(), self._time)

    def _calibrate(self) -> None:
        for camera in self.rig.cameras:
            self._write(calibration_topic(camera.name), messages.calibration_message(camera, self._time))
            self._write(TRANSFORM_TOPIC, messages.camera_transform(camera, self._time))

    def add(
        self,
        observation: Mapping[str, NDArray[Any]],
        action: NDArray[np.float32],
        record: StepRecord,
        bev: NDArray[np.uint8],
        pose: tuple[float, float, float],
    ) -> None:
        """One step: what was seen, the BEV truth and pose (x, y, heading) then, the action, and what came of it."""
        self._time = round((record["time"]) * 1e9)
        if not self._channels:
            self._calibrate()
        self._write(TRANSFORM_TOPIC, messages.ego_transform(*pose, self._time))
        for camera, image in zip(self.rig.cameras, observation["images"], strict=True):
            self._write(image_topic(camera.name), messages.image_message(image, camera.name, self._time, self.quality))
        self._write(BEV_TOPIC, messages.grid_message(bev, BEV_CELL, self._time))
        step = {
            **{key: observation[key].tolist() for key in ("road", "vehicle", "navigation")},
            "action": [float(value) for value in action],
            "record": {key: None if value != value else value for key, value in record.items()},
        }
        self._writer.add_message(self._step, self._time, json.dumps(step).encode(), self._time)

    def finish(self) -> None:
        """Write the index, close and rename."""
        self._writer.finish()  # type: ignore[no-untyped-call]
        self._file.close()
        self.temporary.rename(self.path)

    def __enter__(self) -> EpisodeWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is None:
            self.finish()
        else:
            self._file.close()
            self.temporary.unlink(missing_ok=True)

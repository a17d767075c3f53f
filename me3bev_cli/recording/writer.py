"""One episode to one MCAP file, which existing viewers open as it is."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple

import numpy as np
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from mcap.well_known import MessageEncoding, SchemaEncoding
from mcap_protobuf.schema import build_file_descriptor_set
from numpy.typing import NDArray

from me3bev_cli.api import Actors, Rig, StepRecord
from me3bev_cli.errors import LogError
from me3bev_cli.recording import messages, topics
from me3bev_cli.recording.container import LogWriter
from me3bev_cli.recording.scene import actors_data, route_message

METADATA, OUTCOME = "me3bev", "me3bev.outcome"
"""Names of the metadata that is written at the start, and at the end."""
BEV_CELL = 0.5
"""Metres per cell of the semantic truth."""


@dataclass(frozen=True)
class Options:
    """What is recorded, and how."""

    quality: int = 92
    """Of JPEG, 1 to 100; 0 writes lossless PNG."""
    depth: bool = False
    """Every camera's depth."""
    semantics: bool = False
    """The classes of every camera's pixels."""

    @property
    def images(self) -> str:
        """For the file's metadata."""
        return f"jpeg {self.quality}" if self.quality else "png"


class Truth(NamedTuple):
    """What the simulator knows of the moment of an observation."""

    bev: NDArray[np.uint8]
    """(X, Y), classes as `BEV_CLASSES`."""
    pose: tuple[float, float, float]
    """x, y, heading of the ego."""
    actors: Actors | None = None
    depth: NDArray[np.float32] | None = None
    """(C, H, W), metres."""
    semantics: NDArray[np.uint8] | None = None
    """(C, H, W)."""


@cache
def schema_bytes(message: Any) -> bytes:
    """The definition of a protobuf class, with all that it needs."""
    definition: FileDescriptorSet = build_file_descriptor_set(message)
    return definition.SerializeToString(deterministic=True)


class EpisodeWriter:
    """Writes to a temporary name; `finish` renames. Leaving the block by an exception leaves no file.

    Args:
        path: the file to make.
        rig: the cameras, in the order of the images.
        metadata: recipe, map, density, weather, seed, versions; kept in the file.
        options: what is recorded.
        route: the centre line (P, 3) that is to be driven, for viewers.

    Raises:
        LogError: the system refuses, as when the disk is full; so do `add` and `finish`.
    """

    def __init__(
        self,
        path: Path,
        rig: Rig,
        metadata: Mapping[str, str],
        options: Options | None = None,
        route: NDArray[np.float64] | None = None,
    ) -> None:
        self.path, self.rig, self.options = path, rig, options or Options()
        self.temporary = partial_path(path)
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, int] = {}
        self._time = 0
        self.steps = 0
        try:
            self._file = open(self.temporary, "wb")  # noqa: SIM115 - closed by finish or __exit__
            self._log = LogWriter(self._file)
            self._log.metadata(METADATA, {**metadata, "cameras": ",".join(camera.name for camera in rig.cameras)})
            self._begin(route)
        except OSError as error:
            self._discard()
            raise unwritable(path, error) from error

    def _begin(self, route: NDArray[np.float64] | None) -> None:
        """What holds for the whole episode."""
        for camera in self.rig.cameras:
            self._write(topics.calibration_topic(camera.name), messages.calibration_message(camera, 0))
            self._write(topics.mount_topic(camera.name), messages.camera_transform(camera, 0))
        if route is not None:
            self._write(topics.ROUTE, route_message(route, 0))

    def _channel(self, topic: str, message: Any) -> int:
        if topic not in self._channels:
            name = message.DESCRIPTOR.full_name
            if name not in self._schemas:
                self._schemas[name] = self._log.schema(name, SchemaEncoding.Protobuf, schema_bytes(message))
            self._channels[topic] = self._log.channel(topic, MessageEncoding.Protobuf, self._schemas[name])
        return self._channels[topic]

    def _write(self, topic: str, message: Any) -> None:
        self._log.message(self._channel(topic, type(message)), self._time, message.SerializeToString())

    def look(self, observation: Mapping[str, NDArray[Any]], truth: Truth) -> None:
        """The first half of a step: what is seen, and the truth of that moment."""
        try:
            self._write(topics.TRANSFORM, messages.ego_transform(*truth.pose, self._time))
            self._add_cameras(observation["images"], truth)
            self._write(topics.BEV, messages.grid_message(truth.bev, BEV_CELL, self._time))
            if truth.actors is not None:
                data = actors_data(truth.actors, truth.pose[:2], self._time)
                self._log.message(self._channel(topics.ACTORS, SceneUpdate), self._time, data)
            now = messages.stamp(self._time)
            for name, topic in topics.VECTORS.items():
                self._write(topic, topics.Vector(timestamp=now, values=observation[name].tolist()))
        except OSError as error:
            raise unwritable(self.path, error) from error

    def act(self, action: NDArray[np.float32], record: StepRecord) -> None:
        """The second half: what is done, and what came of it."""
        now, values = messages.stamp(self._time), dict(record)
        steering, longitudinal = (float(value) for value in action)
        broken = {name: values[name] for name in topics.INFRACTION_FIELDS}
        state = {name: values[name] for name in topics.STATE_FIELDS}
        try:
            self._write(topics.ACTION, topics.Action(timestamp=now, steering=steering, longitudinal=longitudinal))
            self._write(topics.STATE, topics.State(timestamp=now, **state))
            self._write(topics.REWARD, topics.Number(timestamp=now, value=values["reward"]))
            self._write(topics.SPEED, topics.Number(timestamp=now, value=values["speed"]))
            self._write(topics.INFRACTIONS, topics.Infractions(timestamp=now, **broken))
            self._log.end_step()
        except OSError as error:
            raise unwritable(self.path, error) from error
        # The next observation is taken when this step is over.
        self._time = round(record["time"] * 1e9)
        self.steps += 1

    def _add_cameras(self, images: NDArray[np.uint8], truth: Truth) -> None:
        time = self._time
        for i, (camera, image) in enumerate(zip(self.rig.cameras, images, strict=True)):
            name = camera.name
            self._write(topics.image_topic(name), messages.image_message(image, name, time, self.options.quality))
            if truth.depth is not None:
                self._write(topics.depth_topic(name), messages.raw_message(truth.depth[i], name, time))
            if truth.semantics is not None:
                self._write(topics.semantics_topic(name), messages.raw_message(truth.semantics[i], name, time))

    def finish(self, outcome: Mapping[str, str] | None = None) -> None:
        """Write how it ended and the index, close and rename."""
        try:
            self._log.end_chunk()
            self._log.metadata(OUTCOME, {"steps": str(self.steps), **(outcome or {})})
            self._log.finish()
            self._file.close()
            self.temporary.replace(self.path)
        except OSError as error:
            self._discard()
            raise unwritable(self.path, error) from error

    def _discard(self) -> None:
        with suppress(OSError, AttributeError):  # What could not be written is not wanted any more.
            self._file.close()
        self.temporary.unlink(missing_ok=True)

    def __enter__(self) -> EpisodeWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is not None:
            self._discard()
        elif not self._file.closed:
            self.finish()


def partial_path(path: Path) -> Path:
    """What a log is called until it is whole."""
    return path.with_name(f".{path.name}.part")


def unwritable(path: Path, error: OSError) -> LogError:
    """The error for a log that the system does not let us write."""
    return LogError(f"cannot be written: {error.strerror or error}", where=str(path))

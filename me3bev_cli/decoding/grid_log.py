"""Copies of logs with the decoded map beside the truth, for viewers."""

from __future__ import annotations

import os
import zlib
from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np
from foxglove_schemas_protobuf.Grid_pb2 import Grid
from mcap.opcode import Opcode
from mcap.well_known import MessageEncoding, SchemaEncoding
from numpy.typing import NDArray

from me3bev_cli.errors import LogError
from me3bev_cli.recording.container import LogWriter
from me3bev_cli.recording.frames import FrameLog
from me3bev_cli.recording.messages import grid_message
from me3bev_cli.recording.records import DAMAGE, MESSAGE_HEAD, walk
from me3bev_cli.recording.writer import BEV_CELL, partial_path, schema_bytes, unwritable

TOPIC = "/bev/decoded"
"""Of the decoded maps; a source that is not the only one has its name after it."""


class Maps:
    """The decoded maps of one log by topic and frame, packed: a map of a street is nearly nothing then."""

    def __init__(self) -> None:
        self._packed: dict[str, dict[int, bytes]] = {}

    def add(self, topic: str, frame: int, classes: NDArray[np.uint8]) -> None:
        """Enter the map (200, 200) of a frame."""
        self._packed.setdefault(topic, {})[frame] = zlib.compress(classes.tobytes(), 1)

    @property
    def topics(self) -> list[str]:
        """Those that have maps."""
        return list(self._packed)

    def get(self, topic: str, frame: int) -> NDArray[np.uint8] | None:
        """The map of a frame, if it has one."""
        data = self._packed[topic].get(frame)
        return None if data is None else np.frombuffer(zlib.decompress(data), np.uint8).reshape(200, 200)


def topics_of(sources: Iterable[str]) -> dict[str, str]:
    """Source -> topic: the first has the plain one."""
    return {source: TOPIC if number == 0 else f"{TOPIC}/{source}" for number, source in enumerate(sources)}


def copy_with_maps(log: FrameLog, maps: Maps, out: Path, about: Mapping[str, str]) -> int:
    """Write a copy of a log with decoded maps at their frames' times; how many were added.

    Args:
        about: kept in the copy as the metadata `me3bev.decoded`.

    Raises:
        LogError: the copy would replace a file, the log has such a topic or is damaged, or the system refuses.
    """
    if out.exists():
        raise LogError("there is such a file already", where=str(out))
    taken = [topic for topic in maps.topics if topic in log.file.channels]
    if taken:
        raise LogError(f"the log has a topic {taken[0]} already", where=str(log.path))
    temporary = partial_path(out)
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        with open(temporary, "wb") as file:
            added = _copy(log, maps, LogWriter(file), about)
        os.replace(temporary, out)
    except OSError as error:
        raise unwritable(out, error) from error
    except DAMAGE as error:
        raise log.file.damaged(error) from error
    finally:
        temporary.unlink(missing_ok=True)
    return added


def _copy(log: FrameLog, maps: Maps, writer: LogWriter, about: Mapping[str, str]) -> int:
    contents = log.file.contents
    for name, values in log.file.metadata.items():
        writer.metadata(name, values)
    writer.metadata("me3bev.decoded", about)
    schemas = {i: writer.schema(s.name, s.encoding, s.data) for i, s in contents.schemas.items()}
    channels = {
        i: writer.channel(c.topic, c.message_encoding, schemas.get(c.schema_id, 0))
        for i, c in contents.channels.items()
    }
    schema = writer.schema(Grid.DESCRIPTOR.full_name, SchemaEncoding.Protobuf, schema_bytes(Grid))
    own = {topic: writer.channel(topic, MessageEncoding.Protobuf, schema) for topic in maps.topics}
    added, frame = 0, 0
    for number in range(len(contents.chunks)):
        data, last = log.file.chunk(number), 0
        for opcode, place, length in walk(data):
            if opcode == Opcode.MESSAGE:
                channel, _, time, _ = MESSAGE_HEAD.unpack_from(data, place)
                writer.message(channels[channel], time, data[place + MESSAGE_HEAD.size : place + length])
                last = max(last, time)
        until = int(np.searchsorted(log.times, last, side="right"))
        added += _add(log, maps, writer, own, range(frame, until))
        frame = max(frame, until)
        writer.end_chunk()
    for (channel, time, offset), length in zip(contents.loose, contents.loose_lengths, strict=True):
        writer.message(channels[channel], time, os.pread(log.file.descriptor, length, offset))
    added += _add(log, maps, writer, own, range(frame, len(log)))
    writer.finish()
    return added


def _add(log: FrameLog, maps: Maps, writer: LogWriter, own: Mapping[str, int], frames: range) -> int:
    added = 0
    for frame in frames:
        time = int(log.times[frame])
        for topic, channel in own.items():
            classes = maps.get(topic, frame)
            if classes is not None:
                writer.message(channel, time, grid_message(classes, BEV_CELL, time).SerializeToString())
                added += 1
    return added

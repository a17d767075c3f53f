"""Whether logs are what they should be: bytes, schemas, times, calibration, every frame."""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from google.protobuf.message import DecodeError
from mcap.opcode import Opcode
from mcap.records import Statistics
from mcap.writer import MCAP0_MAGIC

from me3bev_cli.errors import LogError, UserError
from me3bev_cli.recording.calibration import cameras_of, refuse_mixed
from me3bev_cli.recording.decode import FORMS, check_schema, parse
from me3bev_cli.recording.frames import PARTS, FrameLog
from me3bev_cli.recording.mapping import TopicMapping
from me3bev_cli.recording.messages import NANOSECONDS
from me3bev_cli.recording.reader import read_episode
from me3bev_cli.recording.records import DAMAGE, walk
from me3bev_cli.recording.records import parse as parse_record
from me3bev_cli.recording.writer import METADATA

FOOTER = struct.Struct("<BQQQI")
OPTIONAL = ("depth", "semantics", "actors")


def check_log(path: Path, mapping: TopicMapping | None = None) -> list[str]:
    """What is wrong with a log; nothing when it is sound. Every byte is read and every image decoded."""
    faults: list[str] = []
    try:
        log = FrameLog(path, _parts(path, mapping), mapping)
        if log.note is not None:
            faults.append(log.note)
        else:
            faults += _summary_faults(log)
        faults += _time_faults(log, mapping is None)
        faults += _frame_faults(log)
        if METADATA in log.file.metadata and log.note is None:
            read_episode(path)
        log.close()
    except UserError as error:
        faults.append(str(error))
    return faults


def _parts(path: Path, mapping: TopicMapping | None) -> list[str]:
    """Every part that such a log must have, and the optional ones that it does have."""
    log = FrameLog(path, ("images",), mapping)
    there = [part for part in FORMS if all(topic in log.file.channels for topic in log.mapping.topics_of(part))]
    log.close()
    if mapping is not None:
        return [part for part in FORMS if mapping.topics_of(part)]
    return [part for part in PARTS if part in there or part not in OPTIONAL]


def _summary_faults(log: FrameLog) -> Iterator[str]:
    """Checksum of the summary, and whether its counts are the data's. Chunks check themselves as they are read."""
    file = log.file
    tail = FOOTER.size + len(MCAP0_MAGIC)
    opcode, _, start, _, crc = FOOTER.unpack(os.pread(file.descriptor, FOOTER.size, file.size - tail))
    if opcode != Opcode.FOOTER or not start:
        yield "there is no summary: viewers read the whole file to find anything"
        return
    data = os.pread(file.descriptor, file.size - tail - start + FOOTER.size - 4, start)
    if crc and zlib.crc32(data) != crc:
        yield "the summary's checksum does not fit"
    counted: dict[int, int] = {}
    for number in range(len(file.contents.chunks)):
        chunk = file.chunk(number)
        for inner, place, _ in walk(chunk):
            if inner == Opcode.MESSAGE:
                (channel,) = struct.unpack_from("<H", chunk, place)
                counted[channel] = counted.get(channel, 0) + 1
    try:
        told = [parse_record(Statistics, data[place : place + size])
                for inner, place, size in walk(data[: -FOOTER.size + 4]) if inner == Opcode.STATISTICS]  # fmt: skip
    except DAMAGE as error:
        yield f"the summary cannot be read ({error})"
        return
    if told and not file.contents.loose and dict(told[0].channel_message_counts) != counted:
        yield "the summary counts other messages than there are"


def _time_faults(log: FrameLog, ours: bool) -> Iterator[str]:
    """Times that stand still or run backwards; in logs of ours, topics that lack a step."""
    named = [topic for part in log.parts for topic in log.mapping.topics_of(part)]
    for topic, entries in log.file.entries(named).items():
        steps = np.diff(entries.times)
        if (steps <= 0).any():
            at = int(np.argmax(steps <= 0)) + 1
            yield f"topic {topic}: message {at + 1} is not later than the one before it"
        if ours and len(entries.times) != len(log):
            yield f"topic {topic} has {len(entries.times)} messages, {len(log)} frames are whole"
    gaps = np.diff(log.times)
    if ours and len(gaps) and (np.abs(gaps - np.median(gaps)) > 0.01 * np.median(gaps)).any():
        yield f"frames are {gaps.min() / 1e9:g} to {gaps.max() / 1e9:g} s apart"


def _frame_faults(log: FrameLog) -> Iterator[str]:
    """Images that do not decode or do not fit their calibration; messages whose own time is another."""
    sizes = {camera.name: (camera.height, camera.width) for camera in cameras_of(log)}
    lacking = [name for name in log.cameras if name not in sizes]
    if lacking:
        yield f"there is no calibration of {', '.join(lacking)}"
    shape = None
    for number in range(len(log)):
        frame = log.frame(number)
        shape = frame["images"].shape[-2:]
        wrong = [f"{name} {h} x {w}" for name, (h, w) in sizes.items() if (h, w) != shape]
        if wrong:
            yield f"images are {shape[0]} x {shape[1]}, the calibration says {', '.join(wrong)}"
            return
    for part in log.parts:
        for topic in log.mapping.topics_of(part):
            yield from _stamp_faults(log, part, topic)


def _stamp_faults(log: FrameLog, part: str, topic: str) -> Iterator[str]:
    schema = log.file.schema(topic)
    check_schema(part, topic, schema, log.file.channels[topic].message_encoding, str(log.path))
    assert schema is not None
    entries = log.file.entries([topic])[topic]
    for number, (time, place) in enumerate(zip(entries.times, entries.places, strict=True)):
        try:
            message = parse(schema, log.file.message(place))
        except DecodeError as error:
            yield f"topic {topic}: message {number + 1} cannot be read ({error})"
            return
        if "timestamp" not in message.DESCRIPTOR.fields_by_name:
            return
        own = message.timestamp.seconds * NANOSECONDS + message.timestamp.nanos
        if own != int(time) and METADATA in log.file.metadata:
            yield f"topic {topic}: message {number + 1} is stamped {own / 1e9:g} s and logged at {time / 1e9:g} s"
            return


def check_logs(paths: Sequence[Path], mapping: TopicMapping | None = None) -> dict[Path, list[str]]:
    """The faults of each log, and of all together: calibrations that are mixed stand at the log that differs."""
    faults = {path: check_log(path, mapping) for path in paths}
    sound = [path for path in paths if not faults[path]]
    if sound:
        first = FrameLog(sound[0], ("images",), mapping)
        for path in sound[1:]:
            try:
                refuse_mixed([first, FrameLog(path, ("images",), mapping)])
            except LogError as error:
                faults[path].append(str(error))
    return faults

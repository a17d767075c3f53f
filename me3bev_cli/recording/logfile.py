"""`LogFile`: an MCAP file whose messages are found by topic and number, without reading the rest.

The index is read once, from the file's own; a file without one is gone through, and one that is cut off is taken up to
its last whole chunk.
"""

from __future__ import annotations

import os
import struct
from collections import OrderedDict
from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from mcap.opcode import Opcode
from mcap.reader import SeekingReader
from mcap.records import Channel, Schema
from mcap.writer import MCAP0_MAGIC
from numpy.typing import NDArray

from me3bev_cli.errors import LogError
from me3bev_cli.recording.records import (
    DAMAGE,
    HEAD,
    MESSAGE_HEAD,
    ChunkPlace,
    Contents,
    chunk_head,
    scan,
    unpack_chunk,
    walk,
)

LOOSE = -1
"""In place of a chunk's number: the message lies in the file itself."""
CHUNKS_KEPT = 3
"""Chunks that stay decompressed."""


class LogWarning(UserWarning):
    """A log that is read, though not as it should be."""


class Entries(NamedTuple):
    """The M messages of one topic, by time."""

    times: NDArray[np.int64]
    """(M,) nanoseconds."""
    places: NDArray[np.int64]
    """(M, 2) number of the chunk and offset of the record in it; or `LOOSE` and the data's offset in the file."""


class LogFile:
    """Reads one file. Can be pickled; its descriptor is opened when it is needed.

    Args:
        path: the file.

    Raises:
        LogError: it is missing, empty, or no MCAP file.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.note: str | None = None
        """What is missing of a file that is cut off."""
        self._file: int | None = None
        self._kept: OrderedDict[int, bytes] = OrderedDict()
        self._entries: dict[int, Entries] = {}
        self._lengths: dict[int, int] = {}
        if path.is_dir():
            raise LogError("this is a folder, not a log", where=str(path))
        if path.is_file() and not path.stat().st_size:
            raise LogError("the log is empty: it has no byte", where=str(path))
        if os.pread(self.descriptor, len(MCAP0_MAGIC), 0) != MCAP0_MAGIC:
            raise LogError("this is no MCAP file", where=str(path))
        self.size = os.fstat(self.descriptor).st_size
        self.metadata: dict[str, dict[str, str]] = {}
        found = self._summary()
        self.indexed = found is not None
        """Whether the file has an index."""
        self.contents = found or self._scan()
        self.channels: dict[str, Channel] = {c.topic: c for c in self.contents.channels.values()}
        self.metadata |= {record.name: dict(record.metadata) for record in self.contents.metadata}

    @property
    def descriptor(self) -> int:
        """Of the open file."""
        if self._file is None:
            try:
                self._file = os.open(self.path, os.O_RDONLY)
            except OSError as error:
                raise LogError(f"cannot be read: {error.strerror}", where=str(self.path)) from None
        return self._file

    def close(self) -> None:
        """Close the file; it opens again when it is read."""
        if self._file is not None:
            os.close(self._file)
            self._file = None
        self._kept.clear()

    def __del__(self) -> None:
        if getattr(self, "_file", None) is not None:
            self.close()

    def __getstate__(self) -> dict[str, Any]:
        return {**vars(self), "_file": None, "_kept": OrderedDict()}

    def damaged(self, error: object) -> LogError:
        """The error for bytes that are not what they should be."""
        return LogError(f"the log is damaged ({error})", where=str(self.path))

    def _summary(self) -> Contents | None:
        """What the summary says; None where there is none, or none that fits."""
        contents = Contents(self.size)
        try:
            with open(self.path, "rb") as file:
                reader = SeekingReader(file, record_size_limit=self.size)
                summary = reader.get_summary()
                if summary is None or not summary.chunk_indexes:
                    return None
                told = {index for chunk in summary.chunk_indexes for index in chunk.message_index_offsets}
                schemas = {channel.schema_id for channel in summary.channels.values()} - {0}
                if not summary.channels or told - set(summary.channels) or schemas - set(summary.schemas):
                    return None  # Not every writer repeats them at the end.
                contents.schemas, contents.channels = summary.schemas, summary.channels
                contents.metadata = list(reader.iter_metadata())
            self._indexes = summary.chunk_indexes
            for index in summary.chunk_indexes:
                place, _, _ = chunk_head(os.pread(self.descriptor, 128, index.chunk_start_offset + HEAD),
                                         index.chunk_start_offset + HEAD)  # fmt: skip
                if place.index_offset > self.size:
                    return None
                contents.chunks.append(place)
        except (*DAMAGE, KeyError, OSError, AssertionError, TypeError):
            return None
        contents.good, contents.ended = self.size, True
        return contents

    def _scan(self) -> Contents:
        contents = scan(self.descriptor)
        self._indexes = []
        self._lengths = {offset: n for (_, _, offset), n in zip(contents.loose, contents.loose_lengths, strict=True)}
        if not contents.ended:
            lost = self.size - contents.good
            self.note = (
                f"{self.path} is cut off: {len(contents.chunks)} whole chunks ({contents.good / 1e6:.2f} MB) are read, "
                f"{lost / 1e6:.2f} MB after them are lost"
            )
        return contents

    def entries(self, topics: Iterable[str]) -> dict[str, Entries]:
        """Where the messages of some topics are; a topic that is not there has none."""
        wanted = {self.channels[topic].id: topic for topic in topics if topic in self.channels}
        missing = set(wanted) - set(self._entries)
        if missing:
            found: dict[int, list[tuple[int, int, int]]] = {identity: [] for identity in missing}
            try:
                self._collect(found)
            except DAMAGE as error:
                raise self.damaged(error) from error
            for identity, rows in found.items():
                table = np.array(rows, np.int64).reshape(-1, 3)
                table = table[np.argsort(table[:, 0], kind="stable")]
                self._entries[identity] = Entries(table[:, 0], table[:, 1:])
        return {topic: self._entries[identity] for identity, topic in wanted.items()}

    def _collect(self, found: dict[int, list[tuple[int, int, int]]]) -> None:
        """Fill in (time, chunk, offset) of each channel's messages."""
        for channel, time, offset in self.contents.loose:
            if channel in found:
                found[channel].append((time, LOOSE, offset))
        for number, place in enumerate(self.contents.chunks):
            index = self._indexes[number] if self._indexes else None
            if index is not None and index.message_index_offsets:
                self._collect_index(number, place, index.message_index_length, found)
            else:
                data = self.chunk(number)
                for opcode, start, _ in walk(data):
                    if opcode == Opcode.MESSAGE:
                        channel, _, time, _ = MESSAGE_HEAD.unpack_from(data, start)
                        if channel in found:
                            found[channel].append((time, number, start - HEAD))

    def _collect_index(
        self, number: int, place: ChunkPlace, length: int, found: dict[int, list[tuple[int, int, int]]]
    ) -> None:
        data = os.pread(self.descriptor, length, place.index_offset)
        for opcode, start, _ in walk(data):
            if opcode == Opcode.MESSAGE_INDEX:
                channel, size = struct.unpack_from("<HI", data, start)
                if channel in found:
                    numbers = struct.unpack_from(f"<{size // 8}Q", data, start + 6)
                    found[channel].extend((numbers[i], number, numbers[i + 1]) for i in range(0, len(numbers), 2))

    def chunk(self, number: int) -> bytes:
        """A chunk's records; the last few stay in memory.

        Raises:
            LogError: it is damaged.
        """
        if number in self._kept:
            self._kept.move_to_end(number)
            return self._kept[number]
        place = self.contents.chunks[number]
        try:
            data = unpack_chunk(place, os.pread(self.descriptor, place.packed, place.offset))
        except DAMAGE as error:
            raise self.damaged(f"chunk {number + 1} of {len(self.contents.chunks)}: {error}") from error
        self._kept[number] = data
        while len(self._kept) > CHUNKS_KEPT:
            self._kept.popitem(last=False)
        return data

    def message(self, place: NDArray[np.int64]) -> bytes:
        """A message's data."""
        number, offset = int(place[0]), int(place[1])
        if number == LOOSE:
            return os.pread(self.descriptor, self._lengths[offset], offset)
        data = self.chunk(number)
        try:
            opcode, length = struct.unpack_from("<BQ", data, offset)
        except struct.error as error:
            raise self.damaged(error) from error
        if opcode != Opcode.MESSAGE or offset + HEAD + length > len(data):
            raise self.damaged("the index points to no message")
        return data[offset + HEAD + MESSAGE_HEAD.size : offset + HEAD + length]

    def schema(self, topic: str) -> Schema | None:
        """The schema of a topic's messages, if it has one."""
        return self.contents.schemas.get(self.channels[topic].schema_id)

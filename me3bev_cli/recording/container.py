"""MCAP files in the making: chunks that end where a step ends, compressed, indexed, with checksums.

The library's own writer ends a chunk wherever it happens to be full; here a step lies whole in one chunk, so that one
read finds it and a file that is cut off keeps whole steps.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Mapping
from typing import IO

import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    ChunkIndex,
    DataEnd,
    Footer,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
from mcap.records import Header as HeaderRecord
from mcap.writer import MCAP0_MAGIC

CHUNK_BYTES = 400_000
"""A chunk is closed at the first step's end after so many bytes: to find a frame, little else is read."""
LEVEL = -1
"""Of zstd. Images are compressed already; the rest, maps above all, shrinks nearly as well as at higher levels."""

_MESSAGE = struct.Struct("<BQHIQQ")
_CHUNK = struct.Struct("<BQQQQII4sQ")
_ZSTD = b"zstd"


def _bytes(record: McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    data: bytes = builder.end()  # type: ignore[no-untyped-call]
    return data


class LogWriter:
    """Writes records to an open file.

    Args:
        file: open for writing bytes, empty.
    """

    def __init__(self, file: IO[bytes]) -> None:
        self.file, self.place = file, 0
        self._compressor = zstandard.ZstdCompressor(level=LEVEL)
        self._schemas: list[Schema] = []
        self._channels: list[Channel] = []
        self._chunks: list[ChunkIndex] = []
        self._metadata: list[MetadataIndex] = []
        self._counts: dict[int, int] = {}
        self._parts: list[bytes] = []
        self._size = 0
        self._index: dict[int, list[int]] = {}
        self._times: list[int] = []
        self._put(MCAP0_MAGIC + _bytes(HeaderRecord(profile="", library="me3bev")))

    def _put(self, data: bytes) -> None:
        self.file.write(data)
        self.place += len(data)

    def schema(self, name: str, encoding: str, data: bytes) -> int:
        """Register a schema; its id."""
        self._schemas.append(Schema(id=len(self._schemas) + 1, data=data, encoding=encoding, name=name))
        self._put(_bytes(self._schemas[-1]))
        return len(self._schemas)

    def channel(self, topic: str, encoding: str, schema: int) -> int:
        """Register a channel; its id."""
        identity = len(self._channels) + 1
        self._channels.append(
            Channel(id=identity, topic=topic, message_encoding=encoding, metadata={}, schema_id=schema)
        )
        self._put(_bytes(self._channels[-1]))
        return identity

    def metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Write names and values, at once."""
        data = _bytes(Metadata(name=name, metadata=dict(values)))
        self._metadata.append(MetadataIndex(offset=self.place, length=len(data), name=name))
        self._put(data)

    def message(self, channel: int, time: int, data: bytes) -> None:
        """Add a message to the chunk, nanoseconds."""
        number = self._counts.get(channel, 0)
        self._counts[channel] = number + 1
        self._parts += (_MESSAGE.pack(Opcode.MESSAGE, 22 + len(data), channel, number, time, time), data)
        self._index.setdefault(channel, []).extend((time, self._size))
        self._times.append(time)
        self._size += 31 + len(data)

    def end_step(self) -> None:
        """Close the chunk if it is full."""
        if self._size >= CHUNK_BYTES:
            self.end_chunk()

    def end_chunk(self) -> None:
        """Compress and write what has been added."""
        if not self._parts:
            return
        records = b"".join(self._parts)
        packed = self._compressor.compress(records)
        start, first, last = self.place, min(self._times), max(self._times)
        head = _CHUNK.pack(
            Opcode.CHUNK, 44 + len(packed), first, last, len(records), zlib.crc32(records), 4, _ZSTD, len(packed)
        )
        self._put(head)
        self._put(packed)
        length, offsets, parts = self.place - start, {}, []
        place = self.place
        for channel, entries in self._index.items():
            offsets[channel] = place
            parts.append(
                struct.pack(f"<BQHI{len(entries)}Q", Opcode.MESSAGE_INDEX, 6 + 8 * len(entries), channel,
                            8 * len(entries), *entries)
            )  # fmt: skip
            place += len(parts[-1])
        self._put(b"".join(parts))
        self._chunks.append(
            ChunkIndex(
                chunk_length=length,
                chunk_start_offset=start,
                compression=_ZSTD.decode(),
                compressed_size=len(packed),
                message_end_time=last,
                message_index_length=place - start - length,
                message_index_offsets=offsets,
                message_start_time=first,
                uncompressed_size=len(records),
            )
        )
        self._parts, self._size, self._index, self._times = [], 0, {}, []

    def finish(self) -> None:
        """Write the last chunk, the summary and the end. The file stays open."""
        self.end_chunk()
        self._put(_bytes(DataEnd(data_section_crc=0)))
        start = self.place
        groups: tuple[tuple[Opcode, list[McapRecord]], ...] = (
            (Opcode.SCHEMA, list(self._schemas)),
            (Opcode.CHANNEL, list(self._channels)),
            (Opcode.STATISTICS, [self._statistics()]),
            (Opcode.CHUNK_INDEX, list(self._chunks)),
            (Opcode.METADATA_INDEX, list(self._metadata)),
        )
        offsets, summary = b"", b""
        for opcode, records in groups:
            data = b"".join(_bytes(record) for record in records)
            offset = SummaryOffset(group_opcode=opcode, group_start=start + len(summary), group_length=len(data))
            offsets += _bytes(offset)
            summary += data
        offset_start = start + len(summary)
        summary += offsets
        # The checksum covers the footer too, but for itself.
        head = struct.pack("<BQQQ", Opcode.FOOTER, 20, start, offset_start)
        footer = Footer(summary_start=start, summary_offset_start=offset_start, summary_crc=zlib.crc32(summary + head))
        self._put(summary + _bytes(footer) + MCAP0_MAGIC)

    def _statistics(self) -> Statistics:
        return Statistics(
            attachment_count=0,
            channel_count=len(self._channels),
            channel_message_counts=dict(self._counts),
            chunk_count=len(self._chunks),
            message_count=sum(self._counts.values()),
            message_end_time=max((chunk.message_end_time for chunk in self._chunks), default=0),
            message_start_time=min((chunk.message_start_time for chunk in self._chunks), default=0),
            metadata_count=len(self._metadata),
            schema_count=len(self._schemas),
        )

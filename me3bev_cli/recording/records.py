"""The records of an MCAP file, one after another, without trusting any length in it.

Needed where a file has no summary: it was cut off, or its writer wrote none.
"""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from io import BytesIO
from typing import Any

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Metadata, Schema
from mcap.writer import MCAP0_MAGIC

HEAD = 9
"""Bytes of a record's opcode and length."""
MESSAGE_HEAD = struct.Struct("<HIQQ")
LARGEST_CHUNK = 1 << 31
"""Bytes that a chunk may claim to hold."""
DAMAGE = (McapError, EOFError, ValueError, struct.error, zstandard.ZstdError, RuntimeError)
"""What libraries raise over bytes that are not what they should be."""


@dataclass(frozen=True)
class ChunkPlace:
    """Where a chunk's records are."""

    offset: int
    """Of its compressed records in the file."""
    packed: int
    size: int
    """Bytes, compressed and not."""
    crc: int
    compression: str
    index_offset: int
    """Where the records begin that follow it."""


@dataclass
class Contents:
    """What was found in a file."""

    size: int
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    metadata: list[Metadata] = field(default_factory=list)
    chunks: list[ChunkPlace] = field(default_factory=list)
    loose: list[tuple[int, int, int]] = field(default_factory=list)
    """(channel, time, offset of the data) of messages outside of chunks, and their length in `loose_lengths`."""
    loose_lengths: list[int] = field(default_factory=list)
    good: int = 0
    """Bytes up to the end of the last record that is whole."""
    ended: bool = False
    """Whether the data has its end mark."""


def parse(kind: Any, data: bytes) -> Any:
    """A record's content."""
    return kind.read(ReadDataStream(BytesIO(data)))


def chunk_head(data: bytes, offset: int) -> tuple[ChunkPlace, int, int]:
    """(place, first and last time) from the beginning of a chunk record's content, which begins at `offset`."""
    first, last, size, crc, length = struct.unpack_from("<QQQII", data)
    if length > 64:
        raise ValueError(f"a chunk is compressed with a method whose name has {length} letters")
    compression = data[32 : 32 + length].decode()
    (packed,) = struct.unpack_from("<Q", data, 32 + length)
    start = offset + 40 + length
    return ChunkPlace(start, packed, size, crc, compression, start + packed), first, last


def unpack_chunk(place: ChunkPlace, packed: bytes) -> bytes:
    """A chunk's records. Raises one of `DAMAGE` when they are not what was written."""
    if len(packed) != place.packed or place.size > LARGEST_CHUNK:
        raise ValueError("a chunk's length is wrong")
    if place.compression == "zstd":
        if zstandard.frame_content_size(packed) not in (place.size, zstandard.CONTENTSIZE_UNKNOWN, -1):
            raise ValueError("a chunk's length is wrong")
        data = zstandard.ZstdDecompressor().decompress(packed, max_output_size=place.size) if place.size else b""
    elif place.compression == "lz4":
        import lz4.frame

        data = lz4.frame.decompress(packed)
    elif place.compression == "":
        data = packed
    else:
        raise ValueError(f"a chunk is compressed with '{place.compression}'")
    if len(data) != place.size:
        raise ValueError("a chunk's length is wrong")
    if place.crc and zlib.crc32(data) != place.crc:
        raise ValueError("a chunk's checksum does not fit")
    return data


def walk(data: bytes) -> Iterator[tuple[int, int, int]]:
    """(opcode, offset of the content, its length) of the records in a chunk."""
    place = 0
    while place < len(data):
        opcode, length = struct.unpack_from("<BQ", data, place)
        if place + HEAD + length > len(data):
            raise ValueError("a record reaches beyond its chunk")
        yield opcode, place + HEAD, length
        place += HEAD + length


def take_definition(contents: Contents, opcode: int, data: bytes) -> None:
    """Note a schema, channel or metadata record."""
    if opcode == Opcode.SCHEMA:
        schema: Schema = parse(Schema, data)
        contents.schemas[schema.id] = schema
    elif opcode == Opcode.CHANNEL:
        channel: Channel = parse(Channel, data)
        contents.channels[channel.id] = channel
    elif opcode == Opcode.METADATA:
        contents.metadata.append(parse(Metadata, data))


def scan(file: int) -> Contents:
    """Everything up to the last whole record of the data section.

    Args:
        file: descriptor of an open file that begins with MCAP's magic.
    """
    size = os.fstat(file).st_size
    contents = Contents(size, good=len(MCAP0_MAGIC))
    while contents.good + HEAD <= size:
        place = contents.good
        opcode, length = struct.unpack("<BQ", os.pread(file, HEAD, place))
        if place + HEAD + length > size:
            break
        try:
            _take(contents, file, opcode, place + HEAD, length)
        except DAMAGE:
            break
        contents.good = place + HEAD + length
        if opcode == Opcode.DATA_END:
            contents.ended = True
            break
    return contents


def _take(contents: Contents, file: int, opcode: int, offset: int, length: int) -> None:
    if opcode == Opcode.CHUNK:
        place, _, _ = chunk_head(os.pread(file, min(length, 128), offset), offset)
        if place.index_offset != offset + length:
            raise ValueError("a chunk's length is wrong")
        data = unpack_chunk(place, os.pread(file, place.packed, place.offset))
        for inner, start, size in walk(data):
            if inner != Opcode.MESSAGE:
                take_definition(contents, inner, data[start : start + size])
        contents.chunks.append(place)
    elif opcode == Opcode.MESSAGE:
        channel, _, time, _ = MESSAGE_HEAD.unpack(os.pread(file, MESSAGE_HEAD.size, offset))
        contents.loose.append((channel, time, offset + MESSAGE_HEAD.size))
        contents.loose_lengths.append(length - MESSAGE_HEAD.size)
    elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.METADATA):
        take_definition(contents, opcode, os.pread(file, length, offset))

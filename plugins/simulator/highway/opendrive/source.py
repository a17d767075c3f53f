"""The bytes of an OpenDRIVE file and their XML, with limits on what a file may ask of the machine."""

from __future__ import annotations

import stat
import zlib
from pathlib import Path
from xml.etree import ElementTree as ET

from me3bev_cli.errors import MapError

LARGEST = 256 * 2**20
"""Bytes of XML; the largest published towns have a quarter of it."""
MOST_ELEMENTS = 4_000_000
GIVE = "Give an OpenDRIVE file (.xodr or .xodr.gz)"


def read_file(path: Path) -> bytes:
    """The XML of a file, unpacked if it is gzipped.

    Raises:
        MapError: it is missing, no file, unreadable, empty, too large, or its compression is damaged.
    """
    where = str(path)
    try:
        state = path.stat()
        if not stat.S_ISREG(state.st_mode):
            kind = "is a folder" if stat.S_ISDIR(state.st_mode) else "is no ordinary file"
            raise MapError(f"cannot be read ({kind})", where=where, hint="Give the path of an .xodr file")
        if state.st_size > LARGEST:
            raise _too_large(where)
        with path.open("rb") as file:
            data = file.read(LARGEST + 1)  # It may have grown meanwhile.
    except OSError as fault:
        raise MapError(
            f"cannot be read ({fault.strerror or fault})", where=where, hint="Give the path of an .xodr file"
        ) from fault
    except ValueError as fault:  # A null character in the path.
        raise MapError(f"cannot be read ({fault})", where=where, hint="Give the path of an .xodr file") from fault
    return unpacked(data, where)


def unpacked(data: bytes, where: str) -> bytes:
    """The XML of bytes that may be gzipped. Raises MapError: damaged, too large or empty."""
    if data[:2] == b"\x1f\x8b":
        data = _unzipped(data, where)
    if len(data) > LARGEST:
        raise _too_large(where)
    if not data.strip():
        raise MapError("the file is empty", where=where, hint=GIVE)
    return data


def _unzipped(data: bytes, where: str) -> bytes:
    """Every member of a gzip file, never more than the limit at once."""
    parts: list[bytes] = []
    room = LARGEST + 1
    rest = data
    try:
        while rest.strip(b"\0"):
            unzip = zlib.decompressobj(16 + zlib.MAX_WBITS)
            parts.append(unzip.decompress(rest, room))
            room -= len(parts[-1])
            if room <= 0:
                raise _too_large(where)
            if not unzip.eof:
                raise EOFError("it ends early")
            rest = unzip.unused_data
    except (EOFError, zlib.error) as fault:
        raise MapError(f"the compressed file is damaged ({fault})", where=where, hint="Copy it again") from fault
    return b"".join(parts)


def _too_large(where: str) -> MapError:
    return MapError(f"the file holds more than {LARGEST // 2**20} MiB of XML", where=where, hint="Cut the map up")


def parse(data: bytes, where: str) -> ET.Element:
    """The outermost element, <OpenDRIVE>, without namespaces.

    Raises:
        MapError: the text is not XML, is not OpenDRIVE, or has more elements than any map needs.
    """
    if data.count(b"<") > 2 * MOST_ELEMENTS:
        raise MapError(f"the file has more than {MOST_ELEMENTS:,} elements", where=where, hint="Cut the map up")
    try:
        root = ET.fromstring(data)
    except (ET.ParseError, ValueError, LookupError) as fault:
        hint = f"{GIVE}; a truncated one must be copied again"
        raise MapError(f"is not well-formed XML ({fault})", where=where, hint=hint) from fault
    for element in root.iter():  # Some exporters put everything in a namespace.
        if isinstance(element.tag, str) and element.tag.startswith("{"):
            element.tag = element.tag.rpartition("}")[2]
    if root.tag != "OpenDRIVE":
        raise MapError(f"the outermost element is <{root.tag}>", where=where, allowed="<OpenDRIVE>", hint=GIVE)
    return root

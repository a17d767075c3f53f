"""Where imported towns are kept: one gzipped OpenDRIVE file each, its description in the gzip header.

The folder is `maps` in the user's data folder, or in the one that the environment variable ME3BEV_DATA names.
Names and descriptions are read without opening a town; nothing here imports numpy.
"""

from __future__ import annotations

import hashlib
import os
import re
import struct
import zlib
from pathlib import Path

from me3bev_cli.errors import MapError, UserError, unknown_name
from me3bev_cli.files import atomic_write_bytes

MAPS = ("T1", "T2", "T3", "T4", "T5", "T6", "T7")
"""The built-in towns."""
SUFFIX = ".xodr.gz"
NAME = re.compile(r"[A-Za-z][A-Za-z0-9_.-]*")
LONGEST_NAME = 64
RESERVED = ("all",)
"""Words that mean something else where maps are named."""
_HEADER = b"\x1f\x8b\x08\x10\x00\x00\x00\x00\x00\xff"
"""Deflated, with a comment, no time (the same town is the same bytes), from any system."""
_HEADER_BYTES = 1024


def folder() -> Path:
    """The folder of imported towns; it may not exist yet."""
    own = os.environ.get("ME3BEV_DATA")
    if own:
        return Path(own).expanduser() / "maps"
    from platformdirs import user_data_dir

    return Path(user_data_dir("me3bev", appauthor=False)) / "maps"


def imported(*, strict: bool = False) -> dict[str, Path]:
    """The imported towns by name, T2 before T10.

    Args:
        strict: whether a folder that cannot be read is an error; otherwise it holds nothing, so that the
            built-in towns can be driven all the same.

    Raises:
        MapError: the folder is there and cannot be read.
    """
    place = folder()
    try:
        files = [Path(entry.path) for entry in os.scandir(place) if entry.name.endswith(SUFFIX) and entry.is_file()]
    except FileNotFoundError:
        return {}
    except OSError as fault:
        if strict:
            raise _refused("the folder of imported maps cannot be read", place, fault) from fault
        return {}
    named = {file.name.removesuffix(SUFFIX): file for file in files}
    return {name: named[name] for name in sorted(named, key=_natural) if NAME.fullmatch(name) and name not in MAPS}


def _natural(name: str) -> list[tuple[int, str]]:
    """Sorts numbers within names by their value."""
    return [(int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"(\d+)", name)]


def available() -> tuple[str, ...]:
    """Names of all towns, the built-in ones first."""
    return (*MAPS, *imported())


def checked_name(name: str, *, replace: bool, where: str) -> str:
    """A name that an imported town may have.

    Args:
        replace: whether it may be the name of an imported town.
        where: what gave the name.

    Raises:
        MapError: it is not a word, is a built-in town's, or is taken.
    """
    if not NAME.fullmatch(name) or len(name) > LONGEST_NAME:
        raise MapError(
            f"'{name}' cannot be the name of a map",
            where=where,
            allowed=f"a letter, then letters, digits, '_', '.' and '-'; at most {LONGEST_NAME} characters",
            hint="Choose one with --name",
        )
    same = next((other for other in (*available(), *RESERVED) if other.casefold() == name.casefold()), None)
    if same in MAPS or same in RESERVED:
        kind = "a built-in map" if same in MAPS else "a word of its own"
        raise MapError(f"'{same}' is {kind}", where=where, hint="Choose another name with --name")
    if same is not None and same != name:
        raise MapError(
            f"'{name}' differs from the imported map '{same}' in case only",
            where=where,
            hint="Choose another name with --name",
        )
    if same is not None and not replace:
        raise MapError(
            f"there is an imported map '{name}' already",
            where=where,
            hint="Choose another name with --name, or add --replace",
        )
    return name


def save(name: str, data: bytes, description: str) -> Path:
    """Keep a town's OpenDRIVE text, whole or not at all.

    Raises:
        MapError: it cannot be written.
    """
    squeeze = zlib.compressobj(6, zlib.DEFLATED, -zlib.MAX_WBITS)
    comment = description.encode("latin-1", "replace").replace(b"\0", b" ")[: _HEADER_BYTES - 64]
    body = squeeze.compress(data) + squeeze.flush()
    tail = struct.pack("<II", zlib.crc32(data), len(data) & 0xFFFFFFFF)
    path = folder() / f"{name}{SUFFIX}"
    try:
        atomic_write_bytes(path, _HEADER + comment + b"\0" + body + tail)
    except UserError as fault:
        hint = "Nothing was kept. Make room there, or name another folder with ME3BEV_DATA"
        raise MapError(fault.what, where=fault.where, hint=hint) from fault
    return path


def description(path: Path) -> str:
    """What was written about a town when it was imported; empty when there is nothing."""
    try:
        with path.open("rb") as file:
            head = file.read(_HEADER_BYTES)
    except OSError:
        return ""
    if head[:4] != _HEADER[:4] or b"\0" not in head[len(_HEADER) :]:
        return ""
    return head[len(_HEADER) :].partition(b"\0")[0].decode("latin-1")


def digest(name: str) -> str | None:
    """Letters that are others when an imported town's file is; None for a built-in one.

    Raises:
        MapError: there is none of that name, or its file cannot be read.
    """
    if name in MAPS:
        return None
    known = imported(strict=True)
    if name not in known:
        raise unknown_name("map", name, available(), kind=MapError)
    try:
        return hashlib.blake2b(known[name].read_bytes(), digest_size=16).hexdigest()
    except OSError as fault:
        raise _refused("cannot be read", known[name], fault) from fault


def remove(name: str) -> None:
    """Forget an imported town.

    Raises:
        MapError: there is none of that name, it is built in, or its file cannot be removed.
    """
    if name in MAPS:
        raise MapError(f"'{name}' is a built-in map: only imported ones can be removed")
    known = imported(strict=True)
    if name not in known:
        if not known:
            raise MapError(f"unknown map '{name}': none has been imported", hint="`me3bev maps list` shows every map")
        raise unknown_name("imported map", name, known, kind=MapError)
    try:
        known[name].unlink()
    except FileNotFoundError:
        return
    except OSError as fault:
        raise _refused("cannot be removed", known[name], fault) from fault


def _refused(what: str, where: Path, fault: OSError) -> MapError:
    return MapError(f"{what} ({fault.strerror or fault})", where=str(where), hint="Check who may read and write there")

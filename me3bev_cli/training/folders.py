"""Folders that are written whole or not at all, and are there after a power cut."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import IO, Any

PART, OLD = ".part", ".old"
"""Endings of hidden folders: one that is being written, and one that is about to be replaced."""

Write = Callable[[IO[bytes]], Any]
"""Writes a file that is open."""


def write_folder(final: Path, files: Mapping[str, Write]) -> None:
    """Write a folder of files under a temporary name and rename it.

    Raises:
        OSError: it cannot be written; nothing is left of it, and one that was there stands.
    """
    temporary = final.with_name(f".{final.name}{PART}")
    try:
        shutil.rmtree(temporary, ignore_errors=True)
        temporary.mkdir(parents=True)
        for name, write in files.items():
            _write(temporary / name, write)
        _sync(temporary)
        _replace(temporary, final)
    except OSError:
        shutil.rmtree(temporary, ignore_errors=True)
        raise


def _write(path: Path, write: Write) -> None:
    """Write a file and wait until the disk has it."""
    with open(path, "wb") as file:
        try:
            write(file)
        except RuntimeError as error:
            # torch hides what the file said behind an error of its own.
            if isinstance(error.__context__, OSError):
                raise error.__context__ from None
            raise
        file.flush()
        os.fsync(file.fileno())


def _sync(folder: Path) -> None:
    """Wait until the disk knows the names in a folder, where the system can tell."""
    with suppress(OSError):
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


def _replace(temporary: Path, final: Path) -> None:
    """Give a whole folder its name. One that has it already gives way, but is not gone before the new one is there:
    `clear_folders` knows what to do when a process dies in between."""
    old = final.with_name(f".{final.name}{OLD}")
    if final.exists():
        shutil.rmtree(old, ignore_errors=True)
        final.rename(old)
    temporary.rename(final)
    _sync(final.parent)
    shutil.rmtree(old, ignore_errors=True)


def clear_folders(parent: Path) -> None:
    """Remove what a process that died left behind while it wrote."""
    for path in parent.glob(f".*{PART}"):
        shutil.rmtree(path, ignore_errors=True)
    for path in parent.glob(f".*{OLD}"):
        name = path.name[1 : -len(OLD)]
        if path.with_name(name).exists():
            shutil.rmtree(path, ignore_errors=True)
        else:
            path.rename(path.with_name(name))

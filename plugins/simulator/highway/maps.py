"""Towns by name: the built-in ones, and those that the user has imported."""

from __future__ import annotations

from functools import lru_cache
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING

from me3bev_cli.errors import MapError, unknown_name
from me3bev_plugins.simulator.highway.library_store import MAPS, available, imported

if TYPE_CHECKING:
    from me3bev_plugins.simulator.highway.town import Town

__all__ = ["MAPS", "available", "load_town"]


def load_town(name: str) -> Town:
    """A town by name; every caller of a process shares the same one until it is imported again.

    Raises:
        MapError: there is no such map, or the file of an imported one is damaged.
    """
    if name in MAPS:
        return _built_in(name)
    found = imported()
    if name not in found:
        raise unknown_name("map", name, (*MAPS, *found), kind=MapError)
    try:
        state = found[name].stat()
    except OSError as fault:
        raise MapError(f"map '{name}' cannot be read ({fault.strerror})", where=str(found[name])) from fault
    return _imported(name, found[name], (state.st_mtime_ns, state.st_size, state.st_ino))


@lru_cache(maxsize=len(MAPS))
def _built_in(name: str) -> Town:
    from me3bev_plugins.simulator.highway.opendrive import read_town

    source = files("me3bev_plugins.simulator.highway.towns") / f"{name}.xodr.gz"
    return read_town(source.read_bytes(), name)


@lru_cache(maxsize=16)
def _imported(name: str, path: Path, state: tuple[int, int, int]) -> Town:
    """An imported town; `state` of its file tells one import from the next."""
    from me3bev_plugins.simulator.highway.opendrive import read_town

    return read_town(path, name)

"""The built-in towns by name."""

from __future__ import annotations

from functools import lru_cache
from importlib.resources import files

from me3bev_cli.errors import MapError, unknown_name
from me3bev_plugins.simulator.highway.opendrive import read_town
from me3bev_plugins.simulator.highway.town import Town

MAPS = ("T1", "T2", "T3", "T4", "T5", "T6", "T7")


@lru_cache(maxsize=len(MAPS))
def load_town(name: str) -> Town:
    """A town by name; every caller of a process shares the same one.

    Raises:
        MapError: there is no such map.
    """
    if name not in MAPS:
        raise unknown_name("map", name, MAPS, kind=MapError)
    source = files("me3bev_plugins.simulator.highway.towns") / f"{name}.xodr.gz"
    return read_town(source.read_bytes(), name)

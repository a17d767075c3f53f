"""The simulator's maps for people: listed, imported, removed, measured and drawn (`me3bev maps`)."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from me3bev_cli.api import FactRow, MapEntry
from me3bev_cli.errors import MapError
from me3bev_plugins.simulator.highway import library_store as store

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from me3bev_plugins.simulator.highway.town import Town

BUILT_IN = {
    "T1": "a small town of two-lane streets, T-junctions and lights; after Town01",
    "T2": "a quarter of T1, with shorter blocks; after Town02",
    "T3": "four-lane arterials, a two-lane roundabout, a five-arm junction, a hilly corner; after Town03",
    "T4": "a figure-8 motorway that crosses itself, loop ramps, a small grid; after Town04",
    "T5": "a multi-lane grid inside a ring motorway that rises over it; after Town05",
    "T6": "nested dual carriageways with link ramps and U-turn crossovers; after Town06",
    "T7": "narrow winding country roads, stop and yield signs; after Town07",
}
ROUTES = 5
"""Routes that are tried before a town is kept."""
SHORTEST_ROUTE = 10.0
"""Metres that the longest of them must have."""


class TownLibrary:
    """The optional `MapLibrary` of the simulator."""

    def maps(self) -> tuple[str, ...]:
        """The built-in towns, then the imported ones."""
        return store.available()

    def map_entries(self) -> tuple[MapEntry, ...]:
        """Every town, without opening any."""
        kept = store.imported(strict=True)
        return (
            *(MapEntry(name, "built-in", BUILT_IN[name]) for name in store.MAPS),
            *(MapEntry(name, "imported", store.description(path)) for name, path in kept.items()),
        )

    def import_map(self, source: Path, name: str | None, replace: bool) -> MapEntry:
        """Read an OpenDRIVE file, check that it can be driven, and keep it.

        Raises:
            MapError: the name cannot be used, the file cannot be read or driven, or there is no room.
        """
        where = "--name" if name is not None else str(source)
        name = store.checked_name(_stem(source) if name is None else name, replace=replace, where=where)
        from me3bev_plugins.simulator.highway.opendrive import read_file, read_town

        data = read_file(source)
        town = read_town(data, name, where=str(source))
        check_routes(town, str(source))
        store.save(name, data, town.description)
        return MapEntry(name, "imported", town.description)

    def remove_map(self, name: str) -> None:
        """Forget an imported town. Raises MapError for a built-in or unknown one."""
        store.remove(name)

    def map_digest(self, name: str) -> str | None:
        """Of an imported town's file; None for a built-in one. Raises MapError."""
        return store.digest(name)

    def map_facts(self, name: str) -> tuple[FactRow, ...]:
        """What is measured on a town, beside the real one's figures where it has a model. Raises MapError."""
        from me3bev_plugins.simulator.highway.maps import load_town
        from me3bev_plugins.simulator.highway.towns.facts import measure
        from me3bev_plugins.simulator.highway.towns.facts_compare import compare

        return compare(name, measure(load_town(name)))

    def map_plan(self, name: str, seed: int) -> NDArray[np.uint8]:
        """A plan of the whole town with one route, (H, W, 3). Raises MapError."""
        from me3bev_plugins.simulator.highway.maps import load_town
        from me3bev_plugins.simulator.highway.plan_poster import poster

        return poster(load_town(name), seed)


def _stem(source: Path) -> str:
    """The file's name without what says that it is OpenDRIVE."""
    name = source.name
    for suffix in (".gz", ".xodr", ".xml"):
        if name.lower().endswith(suffix):
            name = name[: -len(suffix)]
    return name


def check_routes(town: Town, where: str) -> None:
    """Raises MapError unless routes of a useful length can be found in a town."""
    import numpy as np

    from me3bev_plugins.simulator.highway.route_sampling import random_route

    longest = max(random_route(town, np.random.default_rng(seed)).length for seed in range(ROUTES))
    if not longest >= SHORTEST_ROUTE:
        raise MapError(
            f"the longest route found is {longest:.1f} m: {town.description}",
            where=where,
            hint=f"A town needs lanes and limits that allow {SHORTEST_ROUTE:.0f} m in ten seconds",
        )

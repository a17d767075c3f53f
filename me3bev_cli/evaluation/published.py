"""The paper's published figures: results in CARLA, to be shown beside ours, never to be ranked with them."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from functools import cache
from importlib.resources import files
from typing import Any

from me3bev_cli.evaluation.definitions import METRICS
from me3bev_cli.evaluation.summary import AVERAGE, Row

NOTE = (
    "Published results in CARLA (ME3-BEV, Tables 1 and 2): another simulator, other towns and traffic. They are not "
    "comparable in absolute terms. The published driving score follows paper_score, not driving_score."
)
EPISODES = 100
"""Of each published cell."""
METHODS = {
    "me3bev": "ME3-BEV (CARLA)",
    "e2e_cla": "e2e-CLA (CARLA)",
    "me3bev_without_ssa": "without SSA (CARLA)",
    "me3bev_without_tafm": "without TAFM (CARLA)",
}
"""Key in the file -> name in tables."""
RENAMED = {"waypoint_distance_m": "waypoint_distance", "comfortness": "comfort"}
"""Metrics that have another name here."""
THEIR_AVERAGE = "avg"


@cache
def _data() -> dict[str, Any]:
    text = files("me3bev_cli.evaluation").joinpath("data/paper.json").read_text(encoding="utf-8")
    data: dict[str, Any] = json.loads(text)
    return data


def published_rows(maps: Sequence[str], densities: Sequence[str]) -> list[Row]:
    """The published figures of these maps and densities, without intervals, which nobody has published.

    The average is over T1 to T7 and so is given only where all of them are among the maps.
    """
    return [
        Row(label, map, density, name, value, math.nan, math.nan, count)
        for key, label in METHODS.items()
        for density in densities
        for name, methods in _tables(key)
        for map, value, count in _figures(methods.get(density, {}), maps)
    ]


def _figures(cells: Mapping[str, float], maps: Sequence[str]) -> list[tuple[str, float, int]]:
    """(map, figure, episodes) of the wanted maps; of all of them also the average, which not every table gives."""
    known = [map for map in cells if map != THEIR_AVERAGE]
    found = [(map, float(cells[map]), EPISODES) for map in maps if map in known]
    if known and set(known) <= set(maps):
        mean = cells.get(THEIR_AVERAGE, sum(cells[map] for map in known) / len(known))
        found.append((AVERAGE, float(mean), EPISODES * len(known)))
    return found


def _tables(method: str) -> list[tuple[str, dict[str, dict[str, float]]]]:
    """(metric, density -> map -> figure) of a method, in the order of our tables."""
    merged: dict[str, dict[str, dict[str, float]]] = {}
    for table in ("comparison", "ablation"):
        for name, methods in _data()[table].items():
            if method in methods:
                merged.setdefault(RENAMED.get(name, name), methods[method])
    return [(name, merged[name]) for name in METRICS if name in merged]

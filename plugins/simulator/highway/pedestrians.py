"""The pedestrians of an episode: who they are and where they begin."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from me3bev_plugins.simulator.highway.pedestrian_kernel import STROLL, stand
from me3bev_plugins.simulator.highway.pedestrian_tables import Walks
from me3bev_plugins.simulator.highway.town import Floats
from me3bev_plugins.simulator.highway.traffic_records import PERSON

APART = 0.8
"""Mean room that a pedestrian has along the strips, metres; a town holds no more."""
_COLOURS = np.array(
    [
        (52, 64, 92), (120, 48, 44), (66, 88, 62), (190, 176, 150), (40, 40, 44), (150, 108, 62),
        (92, 92, 98), (176, 62, 84), (58, 110, 128), (204, 196, 188),
    ],
    np.uint8,
)  # fmt: skip


class Looks(NamedTuple):
    """Sizes (M,) in metres and colours (M, 3)."""

    length: Floats
    width: Floats
    height: Floats
    colour: NDArray[np.uint8]


def draw_people(rng: np.random.Generator, walks: Walks, count: int) -> tuple[NDArray, Looks]:
    """Up to `count` pedestrians (M,) `PERSON`, spread over all strips by length."""
    total = float(walks.strips["length"].sum()) if len(walks.strips) else 0.0
    count = min(count, int(total / APART))
    people = np.zeros(count, PERSON)
    ends = np.cumsum(walks.strips["length"])
    at = np.sort(rng.random(count)) * total
    people["strip"] = np.searchsorted(ends, at, "right") if count else 0
    people["strip"] = np.minimum(people["strip"], max(len(ends) - 1, 0))
    if count:
        people["s"] = at - (ends - walks.strips["length"])[people["strip"]]
        half = walks.strips["half"][people["strip"]]
        people["aside"] = rng.uniform(-1.0, 1.0, count) * half
    people["way"] = np.where(rng.random(count) < 0.5, 1, -1)
    people["pace"] = rng.uniform(1.0, 1.7, count)
    people["rng"] = rng.integers(0, 2**63, count, dtype=np.uint64)
    people["mode"], people["crossing"] = STROLL, -1
    for person in people:
        person["x"], person["y"], person["z"], heading = stand(walks, person)
        person["heading"] = heading if person["way"] > 0 else heading + np.pi
    size = rng.uniform(0.92, 1.08, count)
    looks = Looks(0.45 * size, 0.55 * size, 1.72 * size, _COLOURS[rng.integers(0, len(_COLOURS), count)])
    return people, looks

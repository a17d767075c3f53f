"""What the built-in towns should be like: figures of the seven towns whose twins they are."""

from __future__ import annotations

from typing import NamedTuple


class Reference(NamedTuple):
    """Figures of one town, as `facts.Facts` measures them; None where they are not known."""

    box: tuple[float, float]
    lane_km: float
    signalised: int
    intersections: dict[str, int]
    lanes_per_direction: dict[int, float]
    posted_kmh: dict[int, float] | None
    width: float
    """Median, metres."""
    straight: float
    bend_radius: float
    """Median, metres."""
    block: float
    """Median, metres."""
    z: tuple[float, float]
    furniture: dict[str, int | None]
    levels: int


REFERENCES = {
    "T1": Reference(
        box=(402.0, 337.0),
        lane_km=6.40,
        signalised=12,
        intersections={"3": 12, "4": 0, "5": 0, "merge": 0, "roundabout": 0, "pass": 0},
        lanes_per_direction={1: 1.0},
        posted_kmh={30: 0.728, 60: 0.045, 90: 0.227},
        width=4.0,
        straight=0.974,
        bend_radius=10.6,
        block=80.0,
        z=(0.0, 0.0),
        furniture={"light": 36, "stop": 0, "yield": 0, "crosswalk": 0},
        levels=0,
    ),
    "T2": Reference(
        box=(205.0, 205.0),
        lane_km=2.92,
        signalised=8,
        intersections={"3": 8, "4": 0, "5": 0, "merge": 0, "roundabout": 0, "pass": 0},
        lanes_per_direction={1: 1.0},
        posted_kmh={30: 0.748, 60: 0.147, 90: 0.105},
        width=4.0,
        straight=0.934,
        bend_radius=11.4,
        block=43.8,
        z=(0.0, 0.0),
        furniture={"light": 24, "stop": 0, "yield": 0, "crosswalk": 0},
        levels=0,
    ),
    "T3": Reference(
        box=(402.0, 420.0),
        lane_km=14.33,
        signalised=11,
        intersections={"3": 16, "4": 5, "5": 1, "merge": 0, "roundabout": 1, "pass": 2},
        lanes_per_direction={1: 0.431, 2: 0.569},
        posted_kmh=None,
        width=3.5,
        straight=0.777,
        bend_radius=47.9,
        block=54.7,
        z=(-0.9, 8.4),
        furniture={"light": 35, "stop": None, "yield": None, "crosswalk": None},
        levels=0,
    ),
    "T4": Reference(
        box=(933.0, 836.0),
        lane_km=33.34,
        signalised=12,
        intersections={"3": 9, "4": 9, "5": 0, "merge": 9, "roundabout": 0, "pass": 0},
        lanes_per_direction={1: 0.371, 2: 0.096, 4: 0.533},
        posted_kmh={30: 0.191, 40: 0.005, 60: 0.197, 90: 0.607},
        width=3.5,
        straight=0.51,
        bend_radius=165.5,
        block=67.2,
        z=(0.0, 11.0),
        furniture={"light": 43, "stop": 0, "yield": 0, "crosswalk": 27},
        levels=1,
    ),
    "T5": Reference(
        box=(491.0, 420.0),
        lane_km=23.47,
        signalised=15,
        intersections={"3": 8, "4": 13, "5": 0, "merge": 0, "roundabout": 0, "pass": 0},
        lanes_per_direction={1: 0.119, 2: 0.517, 3: 0.365},
        posted_kmh=None,
        width=3.5,
        straight=0.639,
        bend_radius=92.4,
        block=61.9,
        z=(0.0, 10.0),
        furniture={"light": 54, "stop": None, "yield": None, "crosswalk": None},
        levels=3,
    ),
    "T6": Reference(
        box=(1047.0, 569.0),
        lane_km=25.52,
        signalised=8,
        intersections={"3": 5, "4": 4, "5": 0, "merge": 12, "roundabout": 0, "pass": 2},
        lanes_per_direction={1: 0.092, 2: 0.016, 3: 0.164, 4: 0.288, 5: 0.439},
        posted_kmh={30: 0.1, 40: 0.259, 60: 0.427, 90: 0.213},
        width=3.5,
        straight=0.807,
        bend_radius=61.3,
        block=85.0,
        z=(0.0, 0.0),
        furniture={"light": 19, "stop": 0, "yield": 0, "crosswalk": 14},
        levels=0,
    ),
    "T7": Reference(
        box=(294.0, 377.0),
        lane_km=7.14,
        signalised=5,
        intersections={"3": 20, "4": 3, "5": 0, "merge": 2, "roundabout": 0, "pass": 6},
        lanes_per_direction={1: 0.994, 2: 0.006},
        posted_kmh={30: 0.543, 40: 0.445},
        width=3.2,
        straight=0.624,
        bend_radius=46.0,
        block=46.8,
        z=(-0.7, 9.4),
        furniture={"light": 17, "stop": 19, "yield": 20, "crosswalk": 7},
        levels=0,
    ),
}

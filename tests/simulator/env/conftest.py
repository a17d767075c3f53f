"""A town small enough to work out by hand, and driving environments."""

from __future__ import annotations

import numpy as np
import pytest

from me3bev_plugins.simulator.highway.scene import Actors, Kind
from me3bev_plugins.simulator.highway.town import Building, Floats, Junction, Lane, Prop, Sign, Signal, Town


def line(start: tuple[float, float, float], end: tuple[float, float, float]) -> Floats:
    """Points at most 1 m apart."""
    a, b = np.array(start, float), np.array(end, float)
    return np.linspace(a, b, int(np.ceil(np.hypot(*(b - a)[:2]))) + 1)


def quarter_left(x: float, y: float, radius: float) -> Floats:
    """From (x, y) heading east round to the north."""
    angle = np.linspace(0, np.pi / 2, 17)
    return np.stack([x + radius * np.sin(angle), y + radius * (1 - np.cos(angle)), 0 * angle], 1)


def make_town() -> Town:
    """A road east (lanes 0 and 5 side by side), a junction at x = 60 to 80, on to the east (2) or the north (4).

    A light governs lane 0, a stop sign ends lane 4, lane 6 crosses over lane 2 on a bridge, ten metres up.
    """
    lanes = (
        Lane(0, line((0, 0, 0), (60, 0, 0)), 3.5, 10.0, (1, 3), left=5),
        Lane(1, line((60, 0, 0), (80, 0, 0)), 3.5, 10.0, (2,), (0,), junction=0),
        Lane(2, line((80, 0, 0), (580, 0, 0)), 3.5, 20.0, (), (1,)),
        Lane(3, quarter_left(60, 0, 10), 3.5, 10.0, (4,), (0,), junction=0, turn="left"),
        Lane(4, line((70, 10, 0), (70, 110, 0)), 3.5, 15.0, (), (3,)),
        Lane(5, line((0, 3.5, 0), (60, 3.5, 0)), 3.5, 10.0, (), right=0),
        Lane(6, line((150, -50, 10), (150, 50, 10)), 3.5, 15.0),
    )
    junction = Junction(0, (1, 3), (0,), (2, 4), "signal", 3)
    return Town(
        "tiny",
        lanes,
        (junction,),
        signals=(Signal(0, 0, (0,), 0, (61.0, -4.0, 5.0), 0.0),),
        signs=(Sign("stop", 4, (73.0, 110.0, 2.0), np.pi / 2),),
        buildings=(Building((30.0, -20.0), (20.0, 10.0), 0.0, 8.0, (200, 200, 200)),),
        props=(Prop("pole", (100.0, 4.0), 5.0, 0.2),),
        surfaces=(np.array([[60.0, -5.0], [80.0, -5.0], [80.0, 12.0], [60.0, 12.0]]),),
    )


@pytest.fixture(scope="session")
def town() -> Town:
    """The tiny town."""
    return make_town()


def make_actors(*rows: tuple[float, float, float, float, Kind]) -> Actors:
    """Actors from (x, y, heading, speed, kind): cars of 4 x 2 m, pedestrians of 0.6 x 0.6 m."""
    table = np.array([row[:4] for row in rows], np.float64).reshape(-1, 4)
    kinds = np.array([row[4] for row in rows], np.int32)
    walks = kinds == Kind.PEDESTRIAN
    return Actors(
        x=table[:, 0],
        y=table[:, 1],
        z=np.zeros(len(rows)),
        heading=table[:, 2],
        speed=table[:, 3],
        length=np.where(walks, 0.6, 4.0),
        width=np.where(walks, 0.6, 2.0),
        height=np.full(len(rows), 1.7),
        kind=kinds,
        colour=np.zeros((len(rows), 3), np.uint8),
        braking=np.zeros(len(rows), bool),
    )


@pytest.fixture(scope="session")
def actors_of() -> type[Actors] | object:
    """`make_actors`."""
    return make_actors

"""A straight street to look at, scenes on it, and an independent ray caster."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from me3bev_plugins.simulator.highway.scene import Actors, Ego, Kind, Scene
from me3bev_plugins.simulator.highway.town import Building, Crosswalk, Lane, Prop, Sidewalk, Signal, Town

SIZES = {
    Kind.CAR: (4.6, 1.85, 1.5),
    Kind.VAN: (5.2, 2.0, 2.3),
    Kind.TRUCK: (8.5, 2.5, 3.4),
    Kind.MOTORCYCLE: (2.2, 0.8, 1.6),
    Kind.PEDESTRIAN: (0.5, 0.5, 1.75),
}
Row = tuple[float, float, float, Kind]


def _line(x0: float, x1: float, y: float) -> NDArray[np.float64]:
    x = np.linspace(x0, x1, int(abs(x1 - x0)) + 1)
    return np.stack([x, np.full_like(x, y), np.zeros_like(x)], axis=1)


def make_town(markings: bool = True, buildings: tuple[Building, ...] = ()) -> Town:
    """A street along x from -150 to 150 with a lane each way.

    Asphalt |y| < 3.6, a gutter, sidewalks 4 < |y| < 6; a light at x = 40 for the eastbound lane; a crosswalk from
    x = 30 to 33.
    """
    white, yellow = ("solid", "yellow_solid") if markings else ("none", "none")
    lanes = (
        Lane(0, _line(-150, 40, -1.75), 3.5, 10.0, left_marking=yellow, right_marking=white),
        Lane(1, _line(150, -150, 1.75), 3.5, 10.0, left_marking=yellow, right_marking=white),
        Lane(2, _line(40, 150, -1.75), 3.5, 10.0, left_marking=yellow, right_marking=white),
    )
    corners = np.array([(30.0, -3.5), (33.0, -3.5), (33.0, 3.5), (30.0, 3.5)])
    return Town(
        "street",
        lanes,
        (),
        signals=(Signal(0, 0, (0,), 0, (40.0, -5.0, 4.0), 0.0),) if markings else (),
        crosswalks=(Crosswalk(corners, (), None),) if markings else (),
        sidewalks=tuple(Sidewalk(np.array([(-150.0, y), (150.0, y)]), 2.0) for y in (-5.0, 5.0)),
        buildings=buildings,
        props=(Prop("tree", (-20.0, 9.0), 7.0, 0.3), Prop("pole", (25.0, 6.5), 7.0, 0.1)) if markings else (),
    )


def make_scene(town: Town, rows: list[Row], ego: tuple[float, float, float] = (0.0, -1.75, 0.0)) -> Scene:
    """Actors at (x, y, heading, kind), at rest, and the ego at (x, y, heading)."""
    table = np.array([row[:3] for row in rows], np.float64).reshape(-1, 3)
    size = np.array([SIZES[row[3]] for row in rows], np.float64).reshape(-1, 3)
    count = len(rows)
    actors = Actors(
        x=table[:, 0],
        y=table[:, 1],
        z=np.zeros(count),
        heading=table[:, 2],
        speed=np.zeros(count),
        length=size[:, 0],
        width=size[:, 1],
        height=size[:, 2],
        kind=np.array([row[3] for row in rows], np.int32),
        colour=np.full((count, 3), (200, 30, 30), np.uint8),
        braking=np.zeros(count, bool),
    )
    return Scene(town, Ego(ego[0], ego[1], 0.0, ego[2], 0.0), actors, np.ones(len(town.signals), np.int32))


@pytest.fixture(scope="session")
def town_of() -> Callable[..., Town]:
    """`make_town`."""
    return make_town


@pytest.fixture(scope="session")
def scene_of() -> Callable[..., Scene]:
    """`make_scene`."""
    return make_scene


@pytest.fixture(scope="session")
def street() -> Town:
    """The street with all its paint."""
    return make_town()


@pytest.fixture(scope="session")
def bridge() -> Town:
    """A road along x at height 0 and one along y on a bridge 6 m above it, with ramps down on both sides."""
    x = np.arange(-120.0, 121.0)
    lower = np.stack([x, np.zeros_like(x), np.zeros_like(x)], axis=1)
    ramp = np.clip(6.0 * (1 - (np.abs(x) - 20) / 80), 0, 6)
    upper = np.stack([np.zeros_like(x), x, ramp], axis=1)
    return Town("bridge", (Lane(0, lower, 4.0, 10.0), Lane(1, upper, 4.0, 10.0)), ())

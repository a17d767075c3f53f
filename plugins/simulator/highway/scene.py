"""`Scene`: what moves, at one instant, as arrays. Traffic fills it; cameras, truth and collisions read it.

World frame as in `town.py`. The ego is not among the actors.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from me3bev_plugins.simulator.highway.town import Town
from me3bev_plugins.simulator.highway.weather import CLEAR_NOON, Weather


class Kind(IntEnum):
    """What an actor is."""

    CAR = 0
    VAN = 1
    TRUCK = 2
    MOTORCYCLE = 3
    PEDESTRIAN = 4


class Light(IntEnum):
    """State of a signal head, as in `me3bev_cli.api.LIGHT_STATES`."""

    NONE = 0
    RED = 1
    AMBER = 2
    GREEN = 3
    OFF = 4


@dataclass(eq=False)
class Actors:
    """A actors, vehicles first. Positions are centres on the ground; boxes are oriented by `heading`."""

    x: NDArray[np.float64]
    y: NDArray[np.float64]
    z: NDArray[np.float64]
    """Height of the ground under it; actors over 2.5 m apart in z neither meet nor see each other."""
    heading: NDArray[np.float64]
    speed: NDArray[np.float64]
    """m/s along the heading."""
    length: NDArray[np.float64]
    width: NDArray[np.float64]
    height: NDArray[np.float64]
    kind: NDArray[np.int32]
    colour: NDArray[np.uint8]
    """(A, 3) r, g, b."""
    braking: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.x)


@dataclass(eq=False)
class Ego:
    """The ego's pose and motion."""

    x: float
    y: float
    z: float
    heading: float
    speed: float
    length: float = 4.7
    width: float = 1.9
    height: float = 1.5


@dataclass(eq=False)
class Scene:
    """One instant of the world."""

    town: Town
    ego: Ego
    actors: Actors
    lights: NDArray[np.int32]
    """(S,) `Light` of each of the town's signals."""
    weather: Weather = CLEAR_NOON

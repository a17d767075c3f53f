"""The numbers of an observation: road R(9), vehicle V(4), navigation N(5) (Section 3.1)."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from me3bev_cli.api import LIGHT_STATES, NAVIGATION_WIDTH, ROAD_WIDTH
from me3bev_plugins.simulator.highway.compiled import kernel
from me3bev_plugins.simulator.highway.town import Floats

Features = NDArray[np.float32]

NEAR_JUNCTION = 10.0
"""Metres within which a junction counts as reached."""
NEAR_LIGHT = 20.0
"""Metres to a governed stop line within which the ego is at a traffic light."""
MAX_SPEED = 60.0
"""Bound of speeds and limits, m/s."""
MAX_DISTANCE = 1000.0
"""Bound of distances to waypoints, metres."""
NO_LIGHT = LIGHT_STATES.index("none")


def road_space() -> spaces.Box:
    """Of R."""
    high = np.ones(ROAD_WIDTH, np.float32)
    high[3] = MAX_SPEED
    return spaces.Box(np.zeros(ROAD_WIDTH, np.float32), high, dtype=np.float32)


def vehicle_space() -> spaces.Box:
    """Of V."""
    low = np.array([-1, 0, 0, 0], np.float32)
    return spaces.Box(low, np.array([1, MAX_SPEED, 1, 1], np.float32), dtype=np.float32)


def navigation_space(mode: Literal["distance", "offset"]) -> spaces.Box:
    """Of N."""
    low = 0.0 if mode == "distance" else -MAX_DISTANCE
    return spaces.Box(low, MAX_DISTANCE, (NAVIGATION_WIDTH,), np.float32)


def road_features(*, on_connector: bool, junction_distance: float, light: int, limit: float) -> Features:
    """R(9): in an intersection, in or near a junction, at a traffic light, limit (m/s), one-hot of the light.

    Args:
        on_connector: whether the ego's lane crosses a junction.
        junction_distance: metres to the nearest lane that crosses one.
        light: index into `LIGHT_STATES` of the light that governs the stop line within 20 m; 0 for none.
        limit: m/s.
    """
    values = np.zeros(ROAD_WIDTH, np.float32)
    values[0] = on_connector
    values[1] = on_connector or junction_distance <= NEAR_JUNCTION
    values[2] = light != NO_LIGHT
    values[3] = min(limit, MAX_SPEED)
    values[4 + light] = 1.0
    return values


def vehicle_features(*, similarity: float, speed: float, longitudinal: float) -> Features:
    """V(4): similarity, speed (m/s), throttle and brake, each in 0..1."""
    values = (similarity, min(speed, MAX_SPEED), max(longitudinal, 0.0), max(-longitudinal, 0.0))
    return np.array(values, np.float32)


def navigation_features(
    mode: Literal["distance", "offset"], waypoints: Floats, x: float, y: float, heading: float
) -> Features:
    """N(5) from the next five waypoints (5, 2 or 3), world, metres.

    `distance`: metres to each. `offset`, in the ego frame: y of the 1st, x and y of the 3rd, x and y of the 5th.
    """
    values = np.empty(NAVIGATION_WIDTH, np.float32)
    if mode == "distance":
        _distances(waypoints, x, y, values)
    else:
        _offsets(waypoints, x, y, heading, values)
    return values


@kernel
def _distances(waypoints: NDArray[Any], x: float, y: float, out: NDArray[Any]) -> None:
    for i in range(len(out)):
        out[i] = min(np.hypot(waypoints[i, 0] - x, waypoints[i, 1] - y), MAX_DISTANCE)


@kernel
def _offsets(waypoints: NDArray[Any], x: float, y: float, heading: float, out: NDArray[Any]) -> None:
    cos, sin = np.cos(heading), np.sin(heading)
    for i in range(0, len(out), 2):
        dx, dy = waypoints[i, 0] - x, waypoints[i, 1] - y
        if i > 0:
            out[i - 1] = max(-MAX_DISTANCE, min(MAX_DISTANCE, dx * cos + dy * sin))
        out[i] = max(-MAX_DISTANCE, min(MAX_DISTANCE, dy * cos - dx * sin))

"""Episodes with chosen columns."""

from __future__ import annotations

from typing import Any

import numpy as np

from me3bev_cli.evaluation.episode import STEP_DTYPE, Ending, Episode


def episode(
    length: int = 10,
    ended: Ending = "timeout",
    map: str = "T1",
    density: str = "low",
    driver: str = "me",
    weather: str = "dry",
    seed: int = 1,
    **columns: Any,
) -> Episode:
    """An uneventful drive at 5 m/s along a route of 100 m, with the given columns instead."""
    steps = np.zeros(length, STEP_DTYPE)
    steps["time"] = 0.1 * np.arange(1, length + 1)
    steps["speed"] = 5.0
    steps["traffic_speed"] = np.nan
    steps["route_length"] = 100.0
    steps["route_done"] = 0.5 * np.arange(1, length + 1)
    for name, values in columns.items():
        steps[name] = values
    return Episode(map, density, weather, seed, 0, driver, ended, steps)

"""The parameters of traffic that are highway-env's own."""

from __future__ import annotations

import numpy as np

from me3bev_plugins.simulator.highway.stock import IDMVehicle
from me3bev_plugins.simulator.highway.town import Floats


def idm_parameters() -> Floats:
    """highway-env's IDM parameters; its jam distance is between the centres of vehicles of its own length."""
    return np.array(
        [
            IDMVehicle.COMFORT_ACC_MAX,
            -IDMVehicle.COMFORT_ACC_MIN,
            IDMVehicle.TIME_WANTED,
            IDMVehicle.DISTANCE_WANTED - IDMVehicle.LENGTH,
            IDMVehicle.DELTA,
            IDMVehicle.ACC_MAX,
        ],
        np.float64,
    )


def mobil_parameters() -> Floats:
    """highway-env's parameters of changes of lane."""
    return np.array(
        [
            IDMVehicle.POLITENESS,
            IDMVehicle.LANE_CHANGE_MIN_ACC_GAIN,
            IDMVehicle.LANE_CHANGE_MAX_BRAKING_IMPOSED,
            IDMVehicle.LANE_CHANGE_DELAY,
        ],
        np.float64,
    )

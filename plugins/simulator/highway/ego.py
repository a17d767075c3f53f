"""The ego: highway-env's bicycle kinematics, forward only."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from me3bev_plugins.simulator.highway.lane_grid import Place
from me3bev_plugins.simulator.highway.scene import Ego
from me3bev_plugins.simulator.highway.stock import AbstractLane, Vehicle

if TYPE_CHECKING:
    from me3bev_plugins.simulator.highway.roads import TownRoad

STEERING = float(np.pi / 4)
"""Wheel angle at steering 1, radians, left positive."""
ACCELERATION = 3.5
"""m/s^2 at longitudinal 1."""
BRAKING = 8.0
"""m/s^2 of deceleration at longitudinal -1."""


def acceleration_of(longitudinal: float) -> float:
    """The acceleration, m/s^2, that a longitudinal action in [-1, 1] asks for."""
    return longitudinal * (ACCELERATION if longitudinal > 0 else BRAKING)


def longitudinal_of(acceleration: float) -> float:
    """The longitudinal action that asks for an acceleration, m/s^2; the inverse of `acceleration_of`, clipped."""
    return float(np.clip(acceleration / (ACCELERATION if acceleration > 0 else BRAKING), -1.0, 1.0))


class EgoVehicle(Vehicle):  # type: ignore[misc]  # highway-env has no types
    """The driven car. Its speed never falls below 0: braking holds, it does not reverse.

    `acceleration` (m/s^2 along the heading) and `yaw_rate` (rad/s) are those of the last step; `z` and `place`
    follow the lanes under it.
    """

    LENGTH = 4.7
    WIDTH = 1.9
    HEIGHT = 1.5
    MIN_SPEED = 0.0

    heading: float
    speed: float
    lane: AbstractLane | None

    def __init__(self, road: TownRoad, position: tuple[float, float, float], heading: float) -> None:
        self.z = position[2]
        self.acceleration = 0.0
        self.yaw_rate = 0.0
        self.place = Place(-1, 0.0, 0.0, self.z, np.inf, np.inf)
        # Without a road highway-env does not look for the nearest of all lanes, where one is under the wheels.
        super().__init__(None, position[:2], heading, 0.0)
        self.road = road
        self.on_state_update()
        if self.lane is None:
            self.lane_index = road.network.get_closest_lane_index(self.position, heading)
            self.lane = road.network.get_lane(self.lane_index)

    def step(self, dt: float) -> None:
        """Advance by `dt` seconds with the stored steering (radians) and acceleration (m/s^2).

        Number by number what `Vehicle.step` does in arrays of two, in a quarter of the time.
        """
        speed, heading = self.speed, self.heading
        self.action["acceleration"] = max(float(self.action["acceleration"]), -speed / dt)
        self.clip_actions()
        slip = float(np.arctan(0.5 * np.tan(self.action["steering"])))
        self.position[0] += speed * math.cos(heading + slip) * dt
        self.position[1] += speed * math.sin(heading + slip) * dt
        self.heading = heading + speed * math.sin(slip) / (self.LENGTH / 2) * dt
        self.speed = max(0.0, speed + self.action["acceleration"] * dt)
        self.on_state_update()
        self.acceleration = (self.speed - speed) / dt
        self.yaw_rate = (self.heading - heading) / dt

    def on_state_update(self) -> None:
        """Find the lanes under the ego."""
        x, y = self.position.tolist()
        place = self.road.network.locate(x, y, self.z, self.heading)
        self.place = place
        if place.lane >= 0:
            self.z = place.z
            self.lane_index = self.road.network.index_of[place.lane]
            self.lane = self.road.network.get_lane(self.lane_index)

    @property
    def x(self) -> float:
        """World, metres."""
        return float(self.position[0])

    @property
    def y(self) -> float:
        """World, metres."""
        return float(self.position[1])

    @property
    def pose(self) -> Ego:
        """The ego as the scene holds it."""
        x, y = self.position.tolist()
        return Ego(x, y, self.z, float(self.heading), float(self.speed), self.LENGTH, self.WIDTH, self.HEIGHT)

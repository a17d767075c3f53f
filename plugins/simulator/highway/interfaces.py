"""The environment's action and observation in highway-env's terms."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from gymnasium import spaces

from me3bev_cli.errors import UserError
from me3bev_plugins.simulator.highway.ego import STEERING, EgoVehicle, acceleration_of
from me3bev_plugins.simulator.highway.features import (
    navigation_features,
    navigation_space,
    road_features,
    road_space,
    vehicle_features,
    vehicle_space,
)
from me3bev_plugins.simulator.highway.stock import ActionType, ObservationType

if TYPE_CHECKING:
    from me3bev_plugins.simulator.highway.env import TownEnv


class TownAction(ActionType):  # type: ignore[misc]  # highway-env has no types
    """(steering, longitudinal), each in [-1, 1]: wheel angle up to 45 degrees, left positive; gas or brake."""

    def __init__(self, env: TownEnv) -> None:
        super().__init__(env)
        self.applied = (0.0, 0.0)
        """The last action, clipped."""

    def space(self) -> spaces.Box:
        """Two numbers in [-1, 1]."""
        return spaces.Box(-1.0, 1.0, (2,), np.float32)

    @property
    def vehicle_class(self) -> type[EgoVehicle]:
        """The ego's."""
        return EgoVehicle

    def act(self, action: Any) -> None:
        """Clip the action and give it to the ego.

        Raises:
            UserError: for an action that is not two finite numbers.
        """
        values = np.asarray(action, np.float64)
        if values.shape != (2,) or not all(map(math.isfinite, values.tolist())):
            raise UserError(f"the action is {action!r}", allowed="two finite numbers: steering, longitudinal")
        steering, longitudinal = (min(1.0, max(-1.0, value)) for value in values.tolist())
        self.applied = (steering, longitudinal)
        self.env.vehicle.act({"steering": STEERING * steering, "acceleration": acceleration_of(longitudinal)})


class TownObservation(ObservationType):  # type: ignore[misc]  # highway-env has no types
    """Images (C, 3, H, W) uint8 where asked for, and the features R(9), V(4), N(5), float32."""

    env: TownEnv

    def space(self) -> spaces.Dict:
        """A dict of boxes."""
        observation = self.env.observation
        parts: dict[str, spaces.Space[Any]] = {}
        if self.env.images:
            shape = (len(observation.cameras), 3, observation.height, observation.width)
            parts["images"] = spaces.Box(0, 255, shape, np.uint8)
        parts["road"] = road_space()
        parts["vehicle"] = vehicle_space()
        parts["navigation"] = navigation_space(observation.navigation)
        return spaces.Dict(parts)

    def observe(self) -> dict[str, np.ndarray]:
        """What the policy is given now; every array is new."""
        env = self.env
        state, ego = env.situation, env.vehicle
        values: dict[str, np.ndarray] = {}
        if env.images:
            observation = env.observation
            shape = (len(observation.cameras), 3, observation.height, observation.width)
            values["images"] = np.empty(shape, np.uint8)
            env.cameras.render(env.scene, values["images"])
        values["road"] = road_features(
            on_connector=state.on_connector,
            junction_distance=ego.place.junction_distance,
            light=state.light,
            limit=state.limit,
        )
        values["vehicle"] = vehicle_features(
            similarity=state.similarity, speed=ego.speed, longitudinal=env.action_type.applied[1]
        )
        values["navigation"] = navigation_features(
            env.observation.navigation, state.waypoints, ego.x, ego.y, ego.heading
        )
        return values

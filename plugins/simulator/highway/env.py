"""`TownEnv`: a gymnasium environment, a highway-env `AbstractEnv`, in which the ego follows a route through a town."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from me3bev_cli.api import Actors, ObservationConfig, StepRecord, View
from me3bev_cli.errors import UserError
from me3bev_cli.seeding import derive_seed
from me3bev_plugins.simulator.highway import driver, options
from me3bev_plugins.simulator.highway.bev import bev_semantics
from me3bev_plugins.simulator.highway.cameras import Cameras
from me3bev_plugins.simulator.highway.collisions import CollisionTest, Hit
from me3bev_plugins.simulator.highway.dress import DRESSES
from me3bev_plugins.simulator.highway.ego import EgoVehicle, longitudinal_of
from me3bev_plugins.simulator.highway.infractions import Infractions, RoadEdge, StopLines
from me3bev_plugins.simulator.highway.interfaces import TownAction, TownObservation
from me3bev_plugins.simulator.highway.lane_keeping import LaneKeeping
from me3bev_plugins.simulator.highway.maps import load_town
from me3bev_plugins.simulator.highway.picture import camera_sheet
from me3bev_plugins.simulator.highway.plan_view import plan_view
from me3bev_plugins.simulator.highway.reward import reward
from me3bev_plugins.simulator.highway.rig import surround_rig
from me3bev_plugins.simulator.highway.roads import TownRoad, road_network
from me3bev_plugins.simulator.highway.route_sampling import random_route
from me3bev_plugins.simulator.highway.routes import Route, RouteTracker
from me3bev_plugins.simulator.highway.scene import Light, Scene
from me3bev_plugins.simulator.highway.simulator import HighwayConfig
from me3bev_plugins.simulator.highway.situation import Situation, assess, step_record
from me3bev_plugins.simulator.highway.stock import AbstractEnv
from me3bev_plugins.simulator.highway.town import Town
from me3bev_plugins.simulator.highway.traffic import Traffic
from me3bev_plugins.simulator.highway.views import Views

FREQUENCY = 10
"""Steps per second, of the policy and of the simulation."""


class TownEnv(AbstractEnv):  # type: ignore[misc]  # highway-env has no types
    """Drive a random route in a town among vehicles, pedestrians and traffic lights.

    Observation: a dict of `images` (C, 3, H, W) uint8 (absent when `images` is false), `road` (9,), `vehicle`
    (4,), `navigation` (5,) float32. Action: (steering, longitudinal) in [-1, 1], left positive. 10 Hz. An
    episode terminates at a collision or at the end of the route, and is truncated after `horizon` steps.
    `info["record"]` is a `StepRecord`, `info["weather"]` the name of the episode's weather.

    Args:
        map: name of a built-in town, or a `Town`.
        density: low (50 vehicles and 50 pedestrians) or high (100 and 100).
        weather: a name, or several of which each episode draws one by its seed; None is clear noon. Routes and
            traffic do not depend on it.
        observation: cameras, image size and navigation features; a dict of its fields will do.
        images: False for drivers that do not look: no camera is drawn.
        collision_penalty: k_c of the reward.
        horizon: steps.
        vehicles, pedestrians: numbers instead of the density's.
        render_mode: "rgb_array" for `render()`.

    Raises:
        MapError: for an unknown map or density.
        UserError: for any other wrong argument.
    """

    dresses = DRESSES
    metadata = {"render_modes": ["rgb_array"], "render_fps": FREQUENCY}
    action_type: TownAction
    observation_type: TownObservation

    def __init__(
        self,
        *,
        map: str | Town = "T3",
        density: str = "low",
        weather: str | Sequence[str] | None = None,
        observation: ObservationConfig | Mapping[str, Any] | None = None,
        images: bool = True,
        collision_penalty: float = 1000.0,
        horizon: int = 128,
        vehicles: int | None = None,
        pedestrians: int | None = None,
        render_mode: str | None = None,
        **unknown: Any,
    ) -> None:
        options.refuse_unknown(unknown)
        if render_mode not in (None, "rgb_array"):
            raise UserError(f"render_mode is {render_mode!r}", allowed="None, 'rgb_array'")
        values = {
            "collision_penalty": collision_penalty,
            "horizon": horizon,
            "vehicles": vehicles,
            "pedestrians": pedestrians,
        }
        self.settings = options.validated(HighwayConfig, values, "environment")
        self.observation = options.observation_config(observation)
        self.rig = surround_rig(self.observation)
        self.images = bool(images)
        self.population = options.population(density, self.settings)
        self.weathers = options.weather_set(weather)
        self.town = map if isinstance(map, Town) else load_town(map)
        self._network = road_network(self.town)
        self._traffic = Traffic(self.town)
        self._collisions = CollisionTest(self.town)
        self._stop_lines = StopLines(self.town)
        self._edge = RoadEdge(self.town)
        self._keeping = LaneKeeping(self.town)
        # highway-env resets once while constructing; a world that nobody has seeded yet is not worth building.
        self._ready = False
        super().__init__({"simulation_frequency": FREQUENCY, "policy_frequency": FREQUENCY}, render_mode)
        self._ready = True

    @classmethod
    def default_config(cls) -> dict[str, Any]:
        """highway-env's own, less what has no meaning here."""
        config: dict[str, Any] = super().default_config()
        for key in ("observation", "action", "other_vehicles_type"):
            config.pop(key, None)
        return config

    def update_metadata(self, video_real_time_ratio: float = 1) -> None:
        """Videos run in real time."""
        super().update_metadata(video_real_time_ratio)

    def define_spaces(self) -> None:
        """Set the types and spaces of observation and action, once: they do not change."""
        if self.observation_type is None:
            self.observation_type = TownObservation(self)
            self.action_type = TownAction(self)
            self.observation_space = self.observation_type.space()
            self.action_space = self.action_type.space()

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Begin an episode on a new route.

        Args:
            seed: of everything in the episode; without it the next episode of the current seed.
            options: must be empty: an environment's settings are fixed when it is made.
        """
        if options:
            raise UserError(f"reset() was given options {sorted(options)}", allowed="none")
        if not self._ready:
            return {}, {}
        observation, info = super().reset(seed=seed)
        return observation, info

    def _reset(self) -> None:
        route_seed, traffic_seed = (int(n) for n in self.np_random.integers(2**62, size=2))
        # From a stream of its own: the same seed has the same route and traffic in any weather.
        self.weather = self.weathers[derive_seed("weather", route_seed) % len(self.weathers)]
        route = random_route(self.town, np.random.default_rng(route_seed))
        self._tracker = RouteTracker(route, self.observation.waypoint_spacing)
        self.road = TownRoad(self._network, self.np_random)
        start = (float(route.points[0, 0]), float(route.points[0, 1]), float(route.points[0, 2]))
        self.vehicle = EgoVehicle(self.road, start, float(route.heading[0]))
        vehicles, pedestrians = self.population
        rng = np.random.default_rng(traffic_seed)
        self._traffic.reset(rng, vehicles, pedestrians, self.vehicle.pose, self._tracker.path)
        self.road.populate(self.vehicle, self._tracker, self._traffic)
        self._stop_lines.reset(self.vehicle.pose)
        self._keeping.reset()
        self.action_type.applied = (0.0, 0.0)
        self._measure(self.scene, None, Infractions(False, False))

    def _simulate(self, action: Any = None) -> None:
        super()._simulate(action)
        scene = self.scene
        hit = self._collisions(scene.ego, scene.actors)
        self.vehicle.crashed = hit is not None
        self._measure(scene, hit, self._stop_lines.update(scene.ego, scene.lights))

    def _measure(self, scene: Scene, hit: Hit | None, broken: Infractions) -> None:
        """Work out the situation and the record of the instant that has been reached."""
        ego = self.vehicle
        state = assess(scene, ego, self._tracker)
        off_road = self._edge.off_road(ego.place, scene.ego.x, scene.ego.y)
        self.situation: Situation = state
        self._record: StepRecord = step_record(
            time=self.steps / FREQUENCY,
            ego=ego,
            action=self.action_type.applied,
            tracker=self._tracker,
            situation=state,
            scene=scene,
            off_road=off_road,
            hit=hit,
            broken=broken,
            lane_departure=self._keeping.update(scene.ego, off_road),
            reward=reward(
                collision=hit is not None,
                speed=ego.speed,
                limit=state.limit,
                similarity=state.similarity,
                distance=state.waypoint_distance,
                collision_penalty=self.settings.collision_penalty,
            ),
        )

    def _reward(self, action: Any) -> float:
        return float(self._record["reward"])

    def _is_terminated(self) -> bool:
        return bool(self._record["collision"]) or self._tracker.done

    def _is_truncated(self) -> bool:
        return self.steps >= self.settings.horizon and not self._is_terminated()

    def _info(self, obs: Any, action: Any = None) -> dict[str, Any]:
        return {"record": self._record, "weather": self.weather.name}

    @property
    def scene(self) -> Scene:
        """The world at this instant. The actors are moved in place: copy what is to be kept."""
        return Scene(self.town, self.vehicle.pose, self._traffic.actors, self._traffic.lights, self.weather)

    @property
    def route(self) -> Route:
        """The route that the ego is to follow."""
        return self._tracker.route

    @cached_property
    def cameras(self) -> Cameras:
        """The rig's cameras in this town."""
        return Cameras(self.town, self.rig)

    def autopilot(self) -> NDArray[np.float32]:
        """The action (2,) of a careful, law-abiding driver that follows the route."""
        advice = self._traffic.advise(self.vehicle.pose, self._tracker.path)
        advice = driver.wait_at_red(advice, self.vehicle.speed, self.situation.light == Light.RED)
        return np.array([driver.steer(self.vehicle, self._tracker), longitudinal_of(advice)], np.float32)

    def pose(self) -> tuple[float, float, float]:
        """Where the ego is: x and y, metres, and heading, radians, in the world frame."""
        here = self.vehicle.pose
        return here.x, here.y, here.heading

    def bev_semantics(self) -> NDArray[np.uint8]:
        """The true semantic map around the ego, (200, 200), classes as `BEV_CLASSES`, 0.5 m per cell."""
        return bev_semantics(self.scene)

    def camera_truth(self) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
        """Of every pixel (C, H, W): depth along the optical axis, metres, inf in the sky; class as `BEV_CLASSES`."""
        return self.cameras.truth(self.scene)

    def actors(self) -> Actors:
        """The other road users at this instant."""
        others = self._traffic.actors
        columns = (others.x, others.y, others.z, others.heading, others.length, others.width, others.height)
        return Actors(np.stack(columns, axis=1), others.kind.astype(np.int64), others.speed.copy())

    def route_line(self) -> NDArray[np.float64]:
        """The centre line (P, 3) of the route that is to be driven, world frame, metres."""
        return self.route.points[(self.route.s >= 0) & (self.route.s <= self.route.length)]

    @cached_property
    def _views(self) -> Views:
        return Views(self.town, self.rig, self.cameras)

    def look_from(self, ahead: float, left: float, turn: float, scale: float = 1.0, dress: int = 0) -> View:
        """What would be seen from another place on the ground: metres from the ego, radians to its left.

        In a world `scale` times as large; seen by cameras as much smaller, that is the same. In another of the town's
        dresses, if it is not 0; see `dressed`.
        """
        return self._views.look(self.scene, ahead, left, turn, scale, dress)

    def plan_view(self, size: int) -> NDArray[np.uint8]:
        """The surroundings from above with what is left of the route, the ego heading up: (size, size, 3) r, g, b."""
        route, progress = self.route, self._tracker.progress
        left = route.points[(route.s >= progress) & (route.s <= route.length)]
        return plan_view(self.scene, left, size)

    def render(self) -> NDArray[np.uint8] | None:
        """The cameras and the plan view in one picture (H, W, 3) when the render mode is "rgb_array"."""
        if self.render_mode != "rgb_array":
            return None
        sheet = camera_sheet(self.scene, self.cameras, self.rig)
        return np.concatenate([sheet, self.plan_view(len(sheet))], axis=1)

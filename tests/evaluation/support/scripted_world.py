"""A simulator of a third party that drives by script: cheap enough to start in several processes."""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from pydantic import Field

from me3bev_cli.api import Camera, ObservationConfig, PluginConfig, Rig, StepRecord
from me3bev_cli.seeding import derive_seed

WEATHERS = ("dry", "wet", "white")

RECIPE = """
name: by-script
simulator: {name: scripted, map: M1, density: high, horizon: 40}
observation: {height: 16, width: 16, cameras: [front, back]}
modalities: [vr, nav]
encoders: {vr: {hidden: [8], width: 8}, nav: {hidden: [8], width: 8}}
temporal: null
fusion: {name: concat}
stages: [{kind: ppo, steps: 10}]
"""


class ScriptedEnv(gymnasium.Env[dict[str, Any], Any]):
    """Speeds are drawn from the seed, faster with the pedal; a step in fifty is a collision; the route is 30 m."""

    def __init__(self, place: str, horizon: int, images: bool, weathers: Sequence[str] | None = None) -> None:
        self.place, self.horizon, self.images = place, horizon, images
        self.weathers = weathers or WEATHERS[:1]
        widths = {"road": 9, "vehicle": 4, "navigation": 5}
        self.observation_space = spaces.Dict({k: spaces.Box(-1, 1, (n,), np.float32) for k, n in widths.items()})
        self.action_space = spaces.Box(-1, 1, (2,), np.float32)

    def _observe(self) -> dict[str, Any]:
        boxes = self.observation_space.spaces  # type: ignore[attr-defined]
        observation: dict[str, Any] = {key: np.zeros(box.shape, np.float32) for key, box in boxes.items()}
        if self.images:
            observation["images"] = np.full((2, 3, 8, 16), self.steps, np.uint8)
        return observation

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        super().reset(seed=seed)
        self.steps, self.x = 0, 0.0
        self.weather = self.weathers[derive_seed("weather", seed or 0) % len(self.weathers)]
        return self._observe(), {"weather": self.weather}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        time.sleep(float(os.environ.get("SCRIPTED_SLEEP", "0")))
        self.steps += 1
        speed = float(self.np_random.uniform(4, 6) + action[1])
        self.x = min(30.0, self.x + 0.1 * speed)
        hit = bool(self.np_random.random() < 0.02)
        record = StepRecord(
            time=0.1 * self.steps, x=self.x, y=0.0, heading=0.0, speed=speed, acceleration=0.0,
            lateral_acceleration=0.0, yaw_rate=0.0, steering=float(action[0]), longitudinal=float(action[1]),
            waypoint_x=self.x + 2, waypoint_y=0.0, similarity=1.0, waypoint_distance=2.0, speed_limit=10.0,
            traffic_speed=5.0 if self.place != "M3" else float("nan"), background_speed=4.0,
            route_done=self.x, route_length=30.0, off_route=0.0, off_road=False,
            collision="vehicle" if hit else "", at_fault=hit, contact="front" if hit else "",
            red_light=False, red_met=False, stop_sign=False,
            lane_departure=False, reward=speed,
        )  # fmt: skip
        over = hit or self.x >= 30.0
        info = {"record": record, "weather": self.weather}
        return self._observe(), speed, over, self.steps >= self.horizon and not over, info

    def autopilot(self) -> Any:
        return np.array([0.0, 1.0], np.float32)

    def bev_semantics(self) -> Any:
        return np.ones((200, 200), np.uint8)


class Scripted:
    """The plugin."""

    class Config(PluginConfig):
        horizon: int = Field(default=60, gt=0)

    def __init__(self, config: Any) -> None:
        self.config = config

    def maps(self) -> tuple[str, ...]:
        return "M1", "M2", "M3", "old-town"

    def densities(self) -> tuple[str, ...]:
        return "low", "high"

    def weathers(self) -> tuple[str, ...]:
        return WEATHERS

    def rig(self, observation: ObservationConfig) -> Rig:
        size = {"width": observation.width, "height": observation.height, "fx": 1.0, "fy": 1.0, "cx": 1.0, "cy": 1.0}
        return Rig(cameras=tuple(Camera(name=n, position=(0, 0, 1), yaw=0, **size) for n in observation.cameras))

    def make_env(
        self,
        observation: ObservationConfig,
        *,
        map: str,
        density: str,
        weather: Sequence[str] | None = None,
        images: bool = True,
    ) -> ScriptedEnv:
        return ScriptedEnv(map, self.config.horizon, images, weather)


class Wrong(Scripted):
    """Reports steps that are not `StepRecord`s."""

    def make_env(self, observation: ObservationConfig, **place: Any) -> ScriptedEnv:
        env = super().make_env(observation, **place)
        step = env.step

        def poor(action: Any) -> Any:
            *rest, info = step(action)
            del info["record"]["speed"]
            return (*rest, info)

        env.step = poor  # type: ignore[method-assign]
        return env

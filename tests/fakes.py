"""Small stand-ins for tests: a simulator without a world, a spatial encoder without calibration."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib.metadata import EntryPoint
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium import spaces
from torch import nn

from me3bev_cli import registry
from me3bev_cli.api import (
    Actors,
    Camera,
    GridSpec,
    ObservationConfig,
    PluginConfig,
    Rig,
    SpatialOutput,
    StepRecord,
    TokenSpec,
)
from me3bev_cli.errors import unknown_name
from me3bev_cli.seeding import derive_seed

LENGTH = 12
WEATHERS = ("sun", "moon", "mist")


class LineEnv(gymnasium.Env[dict[str, Any], Any]):
    """A point on a line that should move on: the reward is its speed, a hard left is a collision."""

    def __init__(
        self, observation: ObservationConfig, place: str, weathers: Sequence[str] | None, images: bool
    ) -> None:
        shape = (len(observation.cameras), 3, observation.height, observation.width)
        boxes: dict[str, spaces.Space[Any]] = {
            "road": spaces.Box(-1e3, 1e3, (9,), np.float32),
            "vehicle": spaces.Box(-1e3, 1e3, (4,), np.float32),
            "navigation": spaces.Box(-1e3, 1e3, (5,), np.float32),
        }
        if images:
            boxes["images"] = spaces.Box(0, 255, shape, np.uint8)
        self.observation_space = spaces.Dict(boxes)
        self.action_space = spaces.Box(-1.0, 1.0, (2,), np.float32)
        self.place = place
        self.weathers = WEATHERS[:1] if weathers is None else tuple(weathers)
        for name in self.weathers:
            if name not in WEATHERS:
                raise unknown_name("weather", name, WEATHERS)

    def _observe(self) -> dict[str, Any]:
        obs = {
            key: self.np_random.normal(size=space.shape).astype(np.float32)
            for key, space in self.observation_space.spaces.items()
            if key != "images"
        }
        obs["vehicle"][1] = self.speed
        if "images" in self.observation_space.spaces:
            space = self.observation_space.spaces["images"]
            obs["images"] = self.np_random.integers(0, 256, space.shape, np.uint8)
        return obs

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        super().reset(seed=seed)
        self.seed_used = seed
        self.steps, self.x, self.speed = 0, 0.0, 0.0
        self.weather = self.weathers[derive_seed("weather", seed or 0) % len(self.weathers)]
        return self._observe(), {"weather": self.weather}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        self.steps += 1
        self.speed = float(np.clip(self.speed + 0.3 * action[1], 0, 5))
        self.x += 0.1 * self.speed
        hit = bool(action[0] > 0.97)
        record = StepRecord(
            time=0.1 * self.steps, x=self.x, y=0.0, heading=0.0, speed=self.speed, acceleration=0.0,
            lateral_acceleration=0.0, yaw_rate=0.0, steering=float(action[0]), longitudinal=float(action[1]),
            waypoint_x=self.x + 2, waypoint_y=0.0, similarity=1.0, waypoint_distance=2.0, speed_limit=10.0,
            traffic_speed=float("nan"), background_speed=float("nan"), route_done=self.x,
            route_length=5.0, off_route=0.0, off_road=False, collision="vehicle" if hit else "", at_fault=hit,
            contact="front" if hit else "", red_light=False, red_met=False, stop_sign=False, lane_departure=False,
            reward=self.speed,
        )  # fmt: skip
        truncated = self.steps >= LENGTH
        info = {"record": record, "weather": self.weather}
        return self._observe(), self.speed - 5.0 * hit, hit, truncated and not hit, info

    def autopilot(self) -> Any:
        return np.array([0.0, 1.0], np.float32)

    def pose(self) -> tuple[float, float, float]:
        return self.x, 0.0, 0.0

    def bev_semantics(self) -> Any:
        classes = np.zeros((200, 200), np.uint8)
        classes[:, 90:110] = 1
        classes[40 + 10 * (self.steps % 4) : 60 + 10 * (self.steps % 4), 95:100] = 6
        return classes

    def camera_truth(self) -> tuple[Any, Any]:
        count, _, height, width = self.observation_space["images"].shape
        depth = np.full((count, height, width), 5.0 + self.steps, np.float32)
        depth[:, : height // 2] = np.inf
        return depth, np.isfinite(depth).astype(np.uint8)

    def actors(self) -> Actors:
        boxes = np.array([[self.x + 10.0, 2.0, 0.0, 0.5, 4.0, 2.0, 1.5], [0.0, -3.0, 0.0, -2.0, 0.5, 0.5, 1.8]])
        return Actors(boxes, np.array([0, 4]), np.array([3.0, 1.0]))

    def route_line(self) -> Any:
        return np.array([[0.0, 0.0, 0.0], [5.0, 0.0, 0.0]])

    def plan_view(self, size: int) -> Any:
        return np.full((size, size, 3), self.steps, np.uint8)


class LineSimulator:
    """A simulator plugin around `LineEnv`."""

    class Config(PluginConfig):
        """No settings."""

    def __init__(self, config: Any) -> None:
        self.config = config

    def maps(self) -> tuple[str, ...]:
        return ("F1", "F2")

    def densities(self) -> tuple[str, ...]:
        return ("low", "high")

    def weathers(self) -> tuple[str, ...]:
        return WEATHERS

    def rig(self, observation: ObservationConfig) -> Rig:
        size = {"width": observation.width, "height": observation.height}
        lens = {"fx": 50.0, "fy": 50.0, "cx": observation.width / 2, "cy": observation.height / 2}
        names = enumerate(observation.cameras)
        return Rig(
            cameras=tuple(Camera(name=n, yaw=-float(i), position=(0.0, 0.0, 1.5), **size, **lens) for i, n in names)
        )

    def make_env(
        self,
        observation: ObservationConfig,
        *,
        map: str,
        density: str,
        weather: Sequence[str] | None = None,
        images: bool = True,
    ) -> LineEnv:
        return LineEnv(observation, map, weather, images)


class TinySpatial(nn.Module):
    """2 x 2 tokens of 8 numbers from strided pixels."""

    class Config(PluginConfig):
        """No settings."""

    def __init__(self, config: Any, rig: Rig) -> None:
        super().__init__()
        self.conv = nn.Conv2d(3 * len(rig.cameras), 8, 8, stride=8)

    @classmethod
    def output_spec(cls, config: Any, rig: Rig) -> TokenSpec:
        return TokenSpec(2, 2, 8)

    def forward(self, images: torch.Tensor) -> SpatialOutput:
        maps = nn.functional.adaptive_avg_pool2d(torch.tanh(self.conv(images.flatten(1, 2))), 2)
        return SpatialOutput(maps.flatten(2).transpose(1, 2))


class TinyGrid(TinySpatial):
    """As `TinySpatial`, with a map of 20 x 20 cells and depth in four bins at stride 8."""

    def __init__(self, config: Any, rig: Rig) -> None:
        super().__init__(config, rig)
        self.fine = nn.Conv2d(3 * len(rig.cameras), 6, 8, stride=4, padding=2)
        self.depth = nn.Conv2d(3, 4, 8, stride=8)
        self.register_buffer("depth_edges", torch.tensor([2.0, 5.0, 9.0, 20.0, 50.0]), persistent=False)

    @classmethod
    def grid_spec(cls, config: Any, rig: Rig) -> GridSpec:
        return GridSpec(6, 20, 20, (-50.0, 50.0), (-50.0, 50.0))

    def forward(self, images: torch.Tensor) -> SpatialOutput:
        grid = nn.functional.interpolate(self.fine(images.flatten(1, 2)), size=(20, 20))
        depth = self.depth(images.flatten(0, 1)).unflatten(0, images.shape[:2])
        return SpatialOutput(super().forward(images).tokens, grid, depth)


PLUGINS = {
    ("simulator", "line"): LineSimulator,
    ("spatial", "tiny_test"): TinySpatial,
    ("spatial", "tiny_grid"): TinyGrid,
}


@contextmanager
def installed(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """The fakes as if a distribution had registered them, beside what is really installed."""
    real = registry.entry_points

    def entry_points(*, group: str) -> list[EntryPoint]:
        extra = [
            EntryPoint(name, f"fakes:{cls.__name__}", group)
            for (kind, name), cls in PLUGINS.items()
            if group == f"me3bev.{kind}"
        ]
        return [*real(group=group), *extra]

    monkeypatch.setattr(registry, "entry_points", entry_points)
    registry.clear()
    yield
    monkeypatch.undo()
    registry.clear()


def install_for_good() -> None:
    """The fakes in a process of their own: nothing takes them away again."""
    installed(pytest.MonkeyPatch()).__enter__()


RECIPE = """
name: line
simulator: {name: line, map: F1, density: low}
observation: {height: 16, width: 32, cameras: [front, back]}
spatial: {name: tiny_test}
encoders: {bev: {width: 8}, vr: {hidden: [8], width: 8}, nav: {hidden: [8], width: 8}}
temporal: {name: gru}
context: {kind: window, length: 4}
fusion: {name: sum}
policy: {hidden: [8]}
stages:
  - {kind: ppo, steps: 192, envs: 2, workers: 1, rollout: 16, segment: 8, minibatch: 16, epochs: 2,
     checkpoint_every: 64}
seed: 3
device: cpu
"""

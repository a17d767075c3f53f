"""A simulator that breaks one promise is told which."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from fakes import WEATHERS, LineEnv, LineSimulator

from me3bev_cli.api import Actors, ObservationConfig, Rig
from me3bev_cli.errors import PluginError
from me3bev_cli.testing import check_plugin


class StrictLine(LineSimulator):
    """The line world, with a rig that knows its cameras."""

    env: type[LineEnv] = LineEnv

    def rig(self, observation: ObservationConfig) -> Rig:
        if "no_such_camera" in observation.cameras:
            raise ValueError("no such camera")
        return super().rig(observation)

    def make_env(
        self,
        observation: ObservationConfig,
        *,
        map: str,
        density: str,
        weather: Sequence[str] | None = None,
        images: bool = True,
    ) -> LineEnv:
        return self.env(observation, map, weather, images)


class ForgetsRecord(LineEnv):
    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        *rest, info = super().step(action)
        info["record"].pop("yaw_rate")
        return (*rest, info)  # type: ignore[return-value]


class ForgetsWeather(LineEnv):
    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        *rest, info = super().step(action)
        del info["weather"]
        return (*rest, info)  # type: ignore[return-value]


class OneWeather(LineEnv):
    """Has the first of those asked for in every episode."""

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[Any, dict[str, Any]]:
        observation, _ = super().reset(seed=seed)
        self.weather = self.weathers[0]
        return observation, {"weather": self.weather}


class NeverTheDefault(LineEnv):
    """Has the last kind where none is asked for."""

    def __init__(self, observation: ObservationConfig, place: str, weathers: Any, images: bool) -> None:
        super().__init__(observation, place, weathers or WEATHERS[-1:], images)


class WeatherMovesRoutes(LineEnv):
    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[Any, dict[str, Any]]:
        return super().reset(seed=None if seed is None else seed + WEATHERS.index(self.weathers[0]))


class AnyWeather(LineEnv):
    """Takes names that it does not know."""

    def __init__(self, observation: ObservationConfig, place: str, weathers: Any, images: bool) -> None:
        super().__init__(observation, place, tuple(name for name in weathers or () if name in WEATHERS) or None, images)


class FlatPlan(LineEnv):
    def plan_view(self, size: int) -> Any:
        return super().plan_view(size)[..., 0]


class StrangeActors(LineEnv):
    def actors(self) -> Actors:
        return super().actors()._replace(kinds=np.array([0, 9]))


class FlatRoute(LineEnv):
    def route_line(self) -> Any:
        return super().route_line()[:, :2]


class IgnoresSeed(LineEnv):
    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[Any, dict[str, Any]]:
        return super().reset(seed=None)


@pytest.mark.parametrize(
    ("env", "promise"),
    [
        (ForgetsRecord, "the record has every key of StepRecord. Seen: missing: yaw_rate"),
        (ForgetsWeather, "where none was asked for, at every step. Seen: None"),
        (OneWeather, "an episode draws one of the kinds of weather asked for"),
        (NeverTheDefault, "info['weather'] is the first of weathers() where none was asked for, at reset. Seen: mist"),
        (WeatherMovesRoutes, "routes and traffic of a seed are the same in any weather. Seen: not in 'moon'"),
        (AnyWeather, "an unknown weather raises UserError"),
        (FlatPlan, "plan_view(64) is (64, 64, 3) uint8"),
        (StrangeActors, "the kinds of actors are indices of ('car', 'van',"),
        (FlatRoute, "route_line() is (P, 3), finite. Seen: (2, 2)"),
        (IgnoresSeed, "the same seed gives the same first observation"),
    ],
)
def test_a_broken_simulator_is_told_what_it_breaks(env: type[LineEnv], promise: str) -> None:
    check_plugin("simulator", StrictLine)
    broken = type("BrokenLine", (StrictLine,), {"env": env})
    with pytest.raises(PluginError) as caught:
        check_plugin("simulator", broken)
    assert promise in str(caught.value)


def test_a_rig_that_takes_any_camera_is_told() -> None:
    with pytest.raises(PluginError, match="an unknown camera raises ValueError"):
        check_plugin("simulator", LineSimulator)

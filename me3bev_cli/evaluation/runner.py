"""What an episode is driven in, and one episode at a time: the same seed gives the same numbers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

from me3bev_cli import registry
from me3bev_cli.errors import PluginError
from me3bev_cli.evaluation.drivers import Driver
from me3bev_cli.seeding import derive_seed

if TYPE_CHECKING:
    import gymnasium

    from me3bev_cli.api import ObservationConfig, SimulatorPlugin, StepRecord
    from me3bev_cli.recipe import PluginChoice


def episode_seed(seed: int, map: str, density: str, index: int) -> int:
    """The seed of an evaluation's episode. No training plays it, whatever its recipe's seed."""
    return derive_seed("evaluation", seed, map, density, index)


@dataclass(frozen=True)
class World:
    """What is driven in: a simulator by name with its settings, and what is observed."""

    simulator: PluginChoice
    observation: ObservationConfig
    weather: tuple[str, ...] | None = None
    """Each episode draws one of these by its seed; None: the simulator's default one."""

    def open(self) -> SimulatorPlugin:
        """The simulator.

        Raises:
            PluginError: it is not installed or does not import.
        """
        plugin = registry.load("simulator", self.simulator.name)
        simulator: SimulatorPlugin = plugin(plugin.Config(**self.simulator.settings))
        return simulator


class Drive(NamedTuple):
    """What an environment reported of one episode."""

    records: list[StepRecord]
    terminated: bool
    """Whether the environment ended it, rather than the horizon."""
    weather: str


def weather_of(info: Mapping[str, Any]) -> str:
    """The episode's weather, from what an environment reports at its reset.

    Raises:
        PluginError: it is not there.
    """
    weather = info.get("weather")
    if not isinstance(weather, str):
        raise PluginError("the simulator's info['weather'] is not the name of the episode's weather")
    return weather


def drive(env: gymnasium.Env[Any, Any], driver: Driver, seed: int) -> Drive:
    """Play one episode.

    Raises:
        PluginError: the simulator does not say which weather it has.
    """
    observation, info = env.reset(seed=seed)
    weather = weather_of(info)
    driver.begin(env, seed)
    records: list[StepRecord] = []
    while True:
        observation, _, terminated, truncated, info = env.step(driver.act(observation, env))
        records.append(info["record"])
        if terminated or truncated:
            return Drive(records, terminated, weather)

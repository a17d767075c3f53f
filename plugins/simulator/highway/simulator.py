"""The `highway` simulator plugin: its settings, and the environments it makes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from pydantic import Field

from me3bev_cli.api import ObservationConfig, PluginConfig, Rig
from me3bev_plugins.simulator.highway.library import TownLibrary
from me3bev_plugins.simulator.highway.rig import surround_rig
from me3bev_plugins.simulator.highway.weather import WEATHERS

if TYPE_CHECKING:
    from me3bev_plugins.simulator.highway.env import TownEnv

DENSITIES = {"low": (50, 50), "high": (100, 100)}
"""Density -> vehicles and pedestrians in the whole town."""


class HighwayConfig(PluginConfig):
    """Settings of the embedded simulator."""

    collision_penalty: float = Field(default=1000.0, ge=0, allow_inf_nan=False, description="k_c of the reward")
    horizon: int = Field(default=128, gt=0, description="steps (of 0.1 s) after which an episode is cut off")
    vehicles: int | None = Field(default=None, ge=0, le=1000, description="other vehicles, instead of the density's")
    pedestrians: int | None = Field(default=None, ge=0, le=1000, description="pedestrians, instead of the density's")


class Highway(TownLibrary):
    """Towns on highway-env's roads and kinematics, with traffic in arrays and drawn cameras."""

    Config = HighwayConfig

    def __init__(self, config: HighwayConfig) -> None:
        self.config = config

    def densities(self) -> tuple[str, ...]:
        """Names of the traffic densities."""
        return tuple(DENSITIES)

    def weathers(self) -> tuple[str, ...]:
        """Names of the kinds of weather and light, the default one first."""
        return WEATHERS

    def rig(self, observation: ObservationConfig) -> Rig:
        """Calibration of the chosen cameras. Raises UserError for a camera that the rig does not have."""
        return surround_rig(observation)

    def make_env(
        self,
        observation: ObservationConfig,
        *,
        map: str,
        density: str,
        weather: Sequence[str] | None = None,
        images: bool = True,
    ) -> TownEnv:
        """A driving environment on one map; each episode draws one of `weather` by its seed.

        Raises:
            MapError: for a map or a density that does not exist.
            UserError: for a weather that does not exist.
        """
        from me3bev_plugins.simulator.highway.env import TownEnv

        return TownEnv(
            map=map,
            density=density,
            weather=weather,
            observation=observation,
            images=images,
            **self.config.model_dump(),
        )

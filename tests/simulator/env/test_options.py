"""Wrong arguments are refused with one clear message."""

from __future__ import annotations

import pytest

from me3bev_cli.api import ObservationConfig
from me3bev_cli.errors import MapError, UserError
from me3bev_plugins.simulator.highway import Highway, HighwayConfig
from me3bev_plugins.simulator.highway.env import TownEnv
from me3bev_plugins.simulator.highway.options import observation_config, population


@pytest.mark.parametrize(
    ("arguments", "parts"),
    [
        ({"densty": "high"}, ["unknown argument 'densty'", "did you mean 'density'?", "collision_penalty"]),
        ({"observation": {"hight": 64}}, ["unknown key 'hight'", "did you mean 'height'?", "observation"]),
        ({"observation": {"height": 4}}, ["observation.height", "greater than or equal to 16", "got 4"]),
        ({"observation": {"cameras": ("front", "rear")}}, ["unknown camera 'rear'"]),
        ({"observation": 7}, ["observation is 7", "ObservationConfig"]),
        ({"horizon": 0}, ["environment.horizon", "greater than 0", "got 0"]),
        ({"collision_penalty": -1.0}, ["environment.collision_penalty", "got -1.0"]),
        ({"collision_penalty": float("nan")}, ["environment.collision_penalty", "finite"]),
        ({"vehicles": -3, "pedestrians": "many"}, ["environment.vehicles", "environment.pedestrians"]),
        ({"render_mode": "human"}, ["render_mode is 'human'", "'rgb_array'"]),
    ],
)
def test_messages(arguments: dict[str, object], parts: list[str]) -> None:
    with pytest.raises(UserError) as caught:
        TownEnv(**{"map": "T2", **arguments})  # type: ignore[arg-type]
    for part in parts:
        assert part in str(caught.value)


def test_unknown_density_and_map() -> None:
    with pytest.raises(MapError, match="unknown density 'hihg'; did you mean 'high'"):
        TownEnv(map="T2", density="hihg")
    with pytest.raises(MapError, match="T9"):
        TownEnv(map="T9")


def test_population() -> None:
    assert population("low", HighwayConfig()) == (50, 50)
    assert population("high", HighwayConfig()) == (100, 100)
    assert population("high", HighwayConfig(vehicles=0, pedestrians=7)) == (0, 7)


def test_observation_config_forms() -> None:
    assert observation_config(None) == ObservationConfig()
    assert observation_config({"height": 32}).height == 32
    config = ObservationConfig(width=64)
    assert observation_config(config) is config


def test_the_plugin_names_its_maps_and_densities() -> None:
    plugin = Highway(HighwayConfig())
    assert plugin.maps() == tuple(f"T{i}" for i in range(1, 8))
    assert plugin.densities() == ("low", "high")
    assert [camera.name for camera in plugin.rig(ObservationConfig(cameras=("back",))).cameras] == ["back"]

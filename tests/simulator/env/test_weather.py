"""Each episode has the weather that its seed draws, and nothing else of it depends on the weather."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest

from me3bev_cli.api import ObservationConfig
from me3bev_cli.errors import UserError
from me3bev_plugins.simulator.highway import Highway, HighwayConfig
from me3bev_plugins.simulator.highway.env import TownEnv
from me3bev_plugins.simulator.highway.weather import WEATHERS

FEW = {"vehicles": 6, "pedestrians": 4}


def weathers(env: TownEnv, seeds: range) -> list[str]:
    return [env.reset(seed=seed)[1]["weather"] for seed in seeds]


def test_every_kind_is_drawn_as_often() -> None:
    env = TownEnv(map="T2", weather=["night", "fog", "rain"], images=False, vehicles=0, pedestrians=0)
    drawn = weathers(env, range(150))
    assert drawn == weathers(env, range(150))
    counts = Counter(drawn)
    assert set(counts) == {"night", "fog", "rain"}
    assert min(counts.values()) > 30


def test_the_default_is_the_first() -> None:
    plugin = Highway(HighwayConfig(**FEW))
    assert plugin.weathers() == WEATHERS
    env = plugin.make_env(ObservationConfig(), map="T2", density="low", images=False)
    assert env.reset(seed=1)[1]["weather"] == env.step(np.zeros(2))[4]["weather"] == WEATHERS[0]


def test_the_scene_has_it() -> None:
    env = TownEnv(map="T2", weather="fog", images=False, **FEW)  # type: ignore[arg-type]
    env.reset(seed=1)
    assert env.scene.weather.name == "fog"


def test_routes_and_traffic_do_not_depend_on_it() -> None:
    drives = []
    for weather in (None, "night", WEATHERS):
        env = TownEnv(map="T2", weather=weather, images=False, **FEW)  # type: ignore[arg-type]
        observation, _ = env.reset(seed=11)
        records = [env.step(env.autopilot())[4]["record"] for _ in range(12)]
        actors = env.scene.actors
        drives.append((str(observation), str(records), actors.x.tobytes(), actors.heading.tobytes()))
    assert drives[0] == drives[1] == drives[2]


@pytest.mark.parametrize(
    ("weather", "message"),
    [
        ("nigth", "unknown weather 'nigth'; did you mean 'night'?"),
        (["fog", "snow"], "unknown weather 'snow'"),
        ([], r"weather is \[\]"),
        (7, "weather is 7"),
    ],
)
def test_mistakes(weather: object, message: str) -> None:
    with pytest.raises(UserError, match=message):
        TownEnv(map="T2", weather=weather)  # type: ignore[arg-type]

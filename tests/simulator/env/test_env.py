"""`TownEnv` as a whole: the checkers' view, episode ends, seeds, records, and what pays."""

from __future__ import annotations

import hashlib
import math
import subprocess
import sys
import warnings
from collections.abc import Iterator
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from highway_env.envs.common.abstract import AbstractEnv
from highway_env.road.road import Road
from highway_env.vehicle.kinematics import Vehicle
from stable_baselines3.common.env_checker import check_env as check_sb3

from me3bev_cli.api import LIGHT_STATES, ObservationConfig, StepRecord
from me3bev_cli.errors import UserError
from me3bev_plugins.simulator.highway import Highway, HighwayConfig
from me3bev_plugins.simulator.highway.env import TownEnv

SMALL = ObservationConfig(height=16, width=44)
FEW = {"vehicles": 10, "pedestrians": 10}


def make(**arguments: Any) -> TownEnv:
    """A small environment without images."""
    return TownEnv(**{"map": "T2", "images": False, "observation": SMALL, **FEW, **arguments})


def alone(**arguments: Any) -> TownEnv:
    """Nobody else on the road."""
    return make(vehicles=0, pedestrians=0, **arguments)


def episode(env: TownEnv, seed: int, action: Any = None) -> list[StepRecord]:
    """The records of one episode, driven by the autopilot or with one fixed action."""
    env.reset(seed=seed)
    records = []
    while True:
        _, reward, terminated, truncated, info = env.step(env.autopilot() if action is None else action)
        assert reward == info["record"]["reward"]
        records.append(info["record"])
        if terminated or truncated:
            assert terminated != truncated
            return records


def test_gymnasium_checks_it() -> None:
    env = gymnasium.make(
        "me3bev_plugins.simulator.highway:me3bev/Town-v0", map="T2", density="low", observation=SMALL.model_dump()
    )
    with warnings.catch_warnings():
        warnings.filterwarnings("error", message=".*observation.*")
        check_env(env.unwrapped, skip_render_check=False)


def test_registration() -> None:
    env = gymnasium.make("me3bev/Town-v0", map="T2", density="high", images=False)
    assert isinstance(env.unwrapped, TownEnv)
    assert env.unwrapped.population == (100, 100)


@pytest.mark.parametrize("arguments", [{"images": True, "weather": ("fog", "dusk")}, {"map": "T6", "density": "high"}])
def test_stable_baselines_checks_it(arguments: dict[str, Any]) -> None:
    check_sb3(make(**arguments), warn=False)


def test_it_is_highway_env_inside() -> None:
    env = make()
    env.reset(seed=0)
    assert isinstance(env, AbstractEnv)
    assert isinstance(env.road, Road)
    assert isinstance(env.vehicle, Vehicle)


def test_observation_spaces() -> None:
    env = Highway(HighwayConfig(**FEW)).make_env(ObservationConfig(), map="T2", density="low")
    observation, _ = env.reset(seed=1)
    assert {key: (value.shape, value.dtype) for key, value in observation.items()} == {
        "images": ((6, 3, 128, 352), np.dtype(np.uint8)),
        "road": ((9,), np.dtype(np.float32)),
        "vehicle": ((4,), np.dtype(np.float32)),
        "navigation": ((5,), np.dtype(np.float32)),
    }
    assert env.observation_space.contains(observation)
    assert observation["images"].std() > 10
    assert env.bev_semantics().shape == (200, 200)
    blind, _ = make().reset(seed=1)
    assert "images" not in blind


def test_observations_are_not_shared_between_steps() -> None:
    env = make(images=True)
    first, _ = env.reset(seed=3)
    kept = {key: value.copy() for key, value in first.items()}
    for _ in range(15):
        env.step(np.array([0.3, 1.0]))
    for key, value in first.items():
        np.testing.assert_array_equal(value, kept[key])


SCRIPT = """
import hashlib, sys
from me3bev_plugins.simulator.highway.env import TownEnv
env = TownEnv(map="T2", density="low", observation={"height": 16, "width": 44})
digest = hashlib.sha256()
for seed in (5, None):
    observation, info = env.reset(seed=seed)
    for _ in range(12):
        observation, reward, *_, info = env.step(env.autopilot())
        digest.update(b"".join(observation[key].tobytes() for key in sorted(observation)))
        digest.update(repr((reward, sorted(info["record"].items()))).encode())
print(digest.hexdigest())
"""


def test_the_same_seed_gives_the_same_bytes_in_any_process() -> None:
    runs = [subprocess.run([sys.executable, "-c", SCRIPT], capture_output=True, text=True, check=True) for _ in "ab"]
    assert runs[0].stdout == runs[1].stdout
    assert len(runs[0].stdout.strip()) == hashlib.sha256().digest_size * 2


def test_seeds_differ_and_what_happened_before_does_not_matter() -> None:
    env = make()
    first = episode(env, 7)
    second = episode(env, 8)
    assert (first[0]["x"], first[0]["y"]) != (second[0]["x"], second[0]["y"])
    assert repr(episode(env, 7)) == repr(first)


def steps_of(env: TownEnv, seed: int, count: int) -> Iterator[bytes]:
    """What is seen and reported step by step, driven by the autopilot."""
    observation, info = env.reset(seed=seed)
    for _ in range(count):
        seen = b"".join(observation[key].tobytes() for key in sorted(observation))
        yield seen + repr(sorted(info["record"].items())).encode()
        observation, *_, info = env.step(env.autopilot())


def test_episodes_do_not_depend_on_order_or_on_what_else_is_played() -> None:
    """Environments of one town share its tables: none may leave a trace in them."""
    weather = ("night", "rain", "clear_noon")
    one, other = (make(images=True, weather=weather) for _ in range(2))
    alone_in = [list(steps_of(one, seed, 15)) for seed in (5, 6)]
    assert [list(steps_of(other, seed, 15)) for seed in (6, 5)] == alone_in[::-1]
    side_by_side = zip(steps_of(one, 6, 15), steps_of(other, 5, 15), strict=True)
    assert [list(steps) for steps in zip(*side_by_side, strict=True)] == alone_in[::-1]


def test_waypoint_spacing_does_not_change_the_world() -> None:
    near, far = (make(observation=ObservationConfig(waypoint_spacing=s)) for s in (5.0, 20.0))
    near.reset(seed=2)
    far.reset(seed=2)
    np.testing.assert_array_equal(near.scene.actors.x, far.scene.actors.x)
    assert near.route.length == far.route.length


def test_the_route_ends_the_episode() -> None:
    records = episode(alone(), 0)
    last = records[-1]
    assert last["route_done"] == last["route_length"]
    assert last["collision"] == ""
    assert len(records) <= 128


def test_a_hundred_and_twenty_eight_steps_truncate() -> None:
    env = alone()
    env.reset(seed=0)
    for step in range(1, 129):
        _, _, terminated, truncated, info = env.step(np.zeros(2))
        assert not terminated
        assert truncated == (step == 128)
    assert info["record"]["time"] == pytest.approx(12.8)
    assert len(episode(alone(horizon=9), 0, np.zeros(2))) == 9


def test_a_collision_terminates_with_the_penalty() -> None:
    env = make(vehicles=1, collision_penalty=77.0)
    env.reset(seed=0)
    actors = env.scene.actors
    # In front of the other vehicle, whatever it is: the ego is put half a metre behind the middle of it.
    other = actors.x[0] - 0.5 * math.cos(actors.heading[0]), actors.y[0] - 0.5 * math.sin(actors.heading[0])
    env.vehicle.position[:] = other
    env.vehicle.z = float(actors.z[0])
    _, reward, terminated, truncated, info = env.step(np.zeros(2))
    assert (reward, terminated, truncated) == (-77.0, True, False)
    assert info["record"]["collision"] == "vehicle"
    assert not info["record"]["at_fault"]


def test_record_and_features_agree() -> None:
    env = make(density="high", vehicles=None, pedestrians=None)
    for seed in range(3):
        observation, info = env.reset(seed=seed)
        assert set(info["record"]) == set(StepRecord.__annotations__)
        for _ in range(40):
            action = env.autopilot()
            before = env.vehicle.speed
            observation, _, terminated, truncated, info = env.step(action)
            record = info["record"]
            assert record["steering"] == pytest.approx(float(action[0]))
            assert record["longitudinal"] == pytest.approx(float(action[1]))
            assert record["acceleration"] == pytest.approx((record["speed"] - before) * 10, abs=1e-6)
            assert record["lateral_acceleration"] == pytest.approx(record["speed"] * record["yaw_rate"])
            road, vehicle, navigation = (observation[key] for key in ("road", "vehicle", "navigation"))
            assert road[3] == np.float32(record["speed_limit"])
            assert road[4:].sum() == 1
            assert road[2] == (road[4 + LIGHT_STATES.index("none")] == 0)
            assert vehicle[0] == np.float32(record["similarity"])
            assert vehicle[1] == np.float32(record["speed"])
            assert navigation[0] == np.float32(record["waypoint_distance"])
            dx, dy = record["waypoint_x"] - record["x"], record["waypoint_y"] - record["y"]
            assert record["waypoint_distance"] == pytest.approx(math.hypot(dx, dy))
            angle = math.atan2(dy, dx) - record["heading"]
            assert record["similarity"] == pytest.approx(math.cos(angle), abs=1e-9)
            if terminated or truncated:
                break


def test_traffic_speed_is_the_mean_of_the_near() -> None:
    env = make()
    env.reset(seed=4)
    scene, record = env.scene, env.step(np.zeros(2))[4]["record"]
    near = [
        v
        for x, y, v, kind in zip(scene.actors.x, scene.actors.y, scene.actors.speed, scene.actors.kind, strict=True)
        if kind != 4 and math.dist((x, y), (record["x"], record["y"])) <= 50
    ]
    if near:
        assert record["traffic_speed"] == pytest.approx(sum(near) / len(near))
    else:
        assert math.isnan(record["traffic_speed"])
    everybody = [v for v, kind in zip(scene.actors.speed, scene.actors.kind, strict=True) if kind != 4]
    assert record["background_speed"] == pytest.approx(sum(everybody) / len(everybody))
    env = alone()
    env.reset(seed=4)
    record = env.step(np.zeros(2))[4]["record"]
    assert math.isnan(record["traffic_speed"])
    assert math.isnan(record["background_speed"])


def test_following_the_route_pays_and_nothing_else_does() -> None:
    env = alone()

    def earned(action: Any = None) -> float:
        totals = [sum(r["reward"] for r in episode(env, seed, action)) for seed in range(4)]
        return float(np.mean(totals))

    following = earned()
    standing = earned(np.zeros(2))
    spinning = max(earned(np.array([1.0, gas])) for gas in (0.1, 0.3, 1.0))
    assert standing == 0.0
    assert following > 200
    assert spinning < following / 4


def test_spinning_gains_no_progress() -> None:
    records = episode(alone(), 1, np.array([1.0, 0.1]))
    assert records[-1]["route_done"] < 20


@pytest.mark.parametrize("action", [np.array([np.nan, 0.0]), np.zeros(3), [math.inf, 0.0]])
def test_broken_actions_are_refused(action: Any) -> None:
    env = alone()
    env.reset(seed=0)
    with pytest.raises(UserError, match="two finite numbers"):
        env.step(action)


def test_actions_beyond_the_bounds_are_clipped() -> None:
    env = alone()
    env.reset(seed=0)
    record = env.step(np.array([-3.0, 5.0]))[4]["record"]
    assert (record["steering"], record["longitudinal"]) == (-1.0, 1.0)


def test_reset_takes_no_options() -> None:
    with pytest.raises(UserError, match=r"\['config'\]"):
        alone().reset(options={"config": {}})


def test_a_picture_shows_cameras_and_plan() -> None:
    env = make(images=True, render_mode="rgb_array")
    env.reset(seed=0)
    picture = env.render()
    assert picture is not None
    assert picture.shape == (2 * 16, 3 * 44 + 2 * 16, 3)
    assert picture.dtype == np.uint8
    assert make().render() is None

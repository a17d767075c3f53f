"""Playing episodes: seeds, drivers, the same numbers for any number of workers."""

from __future__ import annotations

import numpy as np
import pytest
from scripted_world import WEATHERS, ScriptedEnv

from me3bev_cli.api import ObservationConfig
from me3bev_cli.errors import PluginError, UserError
from me3bev_cli.evaluation.drivers import Autopilot, DriverSpec, Idle, Random
from me3bev_cli.evaluation.episode import Episode
from me3bev_cli.evaluation.runner import LARGEST_CHUNK, Player, World, drive, episode_seed, evaluate, plan
from me3bev_cli.recipe import PluginChoice
from me3bev_cli.seeding import derive_seed


def player(driver: str = "random", simulator: str = "scripted", seed: int = 0, **settings: object) -> Player:
    choice = PluginChoice.model_validate({"name": simulator, **settings})
    world = World(choice, ObservationConfig(cameras=("front", "back"), height=16, width=16), WEATHERS)
    return Player(world, DriverSpec(driver, driver), seed)


def contents(episodes: list[Episode]) -> list[object]:
    return [(e.map, e.density, e.weather, e.index, e.seed, e.driver, e.ended, e.steps.tobytes()) for e in episodes]


def test_the_plan_covers_every_episode_once() -> None:
    jobs = plan(["M1", "M2"], ["low", "high"], 21, snapshot=True)
    assert (jobs[0].indices, jobs[0].snapshot) == ((), 0)
    played = [(job.density, job.map, index) for job in jobs for index in job.indices]
    assert played == [(d, m, i) for d in ("low", "high") for m in ("M1", "M2") for i in range(21)]
    assert max(len(job.indices) for job in jobs) <= LARGEST_CHUNK


def test_any_number_of_workers_gives_the_same_numbers(scripted: None) -> None:
    jobs = plan(["M1", "M2"], ["low"], 17)
    found = [contents(evaluate(player(), jobs, workers)[0]) for workers in (0, 1, 2)]
    assert found[0] == found[1] == found[2]
    assert len(set(map(str, found[0]))) == 34
    assert {episode[2] for episode in found[0]} == set(WEATHERS)  # type: ignore[index]


def test_an_episode_does_not_depend_on_its_company(scripted: None) -> None:
    few, _ = evaluate(player(), plan(["M2"], ["low"], 2), 0)
    many, _ = evaluate(player(), plan(["M1", "M2"], ["low"], 9), 0)
    assert contents(few) == contents(many[9:11])
    other, _ = evaluate(player(seed=1), plan(["M2"], ["low"], 2), 0)
    assert [e.seed for e in other] != [e.seed for e in few]


def test_seeds_are_not_those_of_training() -> None:
    ours = {episode_seed(0, "T3", "low", index) for index in range(1000)}
    theirs = {derive_seed(0, "T3", "low", index) for index in range(1000)}
    assert len(ours) == 1000
    assert not ours & theirs


def test_progress_hears_of_every_episode(scripted: None) -> None:
    heard: list[Episode] = []
    episodes, snapshot = evaluate(player(), plan(["M1"], ["low"], 5, snapshot=True), 0, heard.extend)
    assert contents(heard) == contents(episodes)
    assert snapshot is not None
    assert snapshot.images.shape == (2, 3, 8, 16)
    # The scripted images hold the step that they were taken at.
    assert set(snapshot.images.ravel()) == {snapshot.step}
    assert snapshot.step <= min(40, len(episodes[0]))
    assert snapshot.bev.shape == (200, 200)
    assert snapshot.weather == episodes[0].weather


def test_reference_drivers(scripted: None) -> None:
    env = ScriptedEnv("M1", 50, images=False)
    records = drive(env, Idle(), 5).records
    assert {(r["steering"], r["longitudinal"]) for r in records} == {(0.0, 0.0)}
    records = drive(env, Autopilot(), 5).records
    assert {(r["steering"], r["longitudinal"]) for r in records} == {(0.0, 1.0)}
    first, second, other = (drive(env, Random(), seed).records for seed in (5, 5, 6))
    assert first == second
    assert first != other
    actions = np.array([(r["steering"], r["longitudinal"]) for r in first])
    assert (np.abs(actions) <= 1).all()
    assert actions.std(axis=0).min() > 0.3


def test_settings_reach_the_simulator(scripted: None) -> None:
    episodes, _ = evaluate(player("idle", horizon=3), plan(["M1"], ["low"], 3), 0)
    assert {(len(e), e.ended) for e in episodes} <= {
        (3, "timeout"),
        (1, "collision"),
        (2, "collision"),
        (3, "collision"),
    }


@pytest.mark.parametrize("workers", [0, 1])
def test_a_simulator_that_breaks_its_contract(scripted: None, workers: int) -> None:
    with pytest.raises(PluginError, match=r"info\['record'\] lacks 'speed'"):
        evaluate(player(simulator="wrong"), plan(["M1"], ["low"], 1), workers)


def test_drivers_that_cannot_be_made() -> None:
    with pytest.raises(UserError, match="unknown driver 'autopilt'; did you mean 'autopilot'"):
        DriverSpec("autopilt", "x")
    with pytest.raises(UserError, match="an untrained policy needs a recipe"):
        DriverSpec("untrained", "x")
    with pytest.raises(UserError, match="needs the run"):
        DriverSpec("policy", "x")

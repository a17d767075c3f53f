"""Playing episodes: seeds, drivers, the same numbers for any number of workers."""

from __future__ import annotations

import numpy as np
import pytest
from scripted_world import WEATHERS, ScriptedEnv

from me3bev_cli.api import ObservationConfig
from me3bev_cli.errors import PluginError, UserError
from me3bev_cli.evaluation.crew import ROWS, row_of
from me3bev_cli.evaluation.drivers import Autopilot, DriverSpec, Idle, Random
from me3bev_cli.evaluation.episode import Episode
from me3bev_cli.evaluation.plan import LARGEST, Visit, jobs_for, look_into, visits
from me3bev_cli.evaluation.player import Method, Played, Player
from me3bev_cli.evaluation.runner import World, drive, episode_seed
from me3bev_cli.parallel import run_jobs
from me3bev_cli.recipe import PluginChoice
from me3bev_cli.seeding import derive_seed


def player(driver: str = "random", simulator: str = "scripted", seed: int = 0, **settings: object) -> Player:
    choice = PluginChoice.model_validate({"name": simulator, **settings})
    world = World(choice, ObservationConfig(cameras=("front", "back"), height=16, width=16), WEATHERS)
    return Player((Method(DriverSpec(driver, driver), world),), seed)


def plan(maps: list[str], densities: list[str], episodes: int) -> list[Visit]:
    return visits(1, maps, densities, episodes)


def evaluate(player: Player, wanted: list[Visit], workers: int, cut_for: int | None = None) -> list[Episode]:
    """The episodes in the order of the plan, whatever jobs they are cut into."""
    jobs = jobs_for(wanted, (), workers if cut_for is None else cut_for)
    episodes = [episode for played in run_jobs(player, jobs, workers) for episode in played.episodes]
    assert [(e.map, e.density, e.index) for e in episodes] == [visit[1:] for visit in wanted]
    return episodes


def contents(episodes: list[Episode]) -> list[object]:
    return [(e.map, e.density, e.weather, e.index, e.seed, e.driver, e.ended, e.steps.tobytes()) for e in episodes]


@pytest.mark.parametrize("workers", [0, 1, 2, 7])
def test_jobs_cover_every_missing_episode_once(workers: int) -> None:
    wanted = visits(2, ["M1", "M2"], ["low", "high"], 41)
    done = {visit for visit in wanted if visit.map == "M2" and visit.number % 3}
    jobs = jobs_for(wanted, done, workers)
    assert [Visit(*job[:3], number) for job in jobs for number in job.indices] == [v for v in wanted if v not in done]
    assert max(len(job.indices) for job in jobs) <= LARGEST
    assert jobs_for(wanted, wanted, workers) == []


def test_several_workers_get_several_jobs_each() -> None:
    assert len(jobs_for(visits(1, ["M1"], ["low"], 100), (), 2)) >= 7
    # Never less than a batch full.
    assert [len(job.indices) for job in jobs_for(visits(1, ["M1"], ["low"], 9), (), 8)] == [4, 4, 1]


def test_any_number_of_workers_gives_the_same_numbers(scripted: None) -> None:
    wanted = plan(["M1", "M2"], ["low"], 17)
    found = [contents(evaluate(player(), wanted, workers)) for workers in (0, 1, 2, 4)]
    assert found[0] == found[1] == found[2] == found[3]
    assert len(set(map(str, found[0]))) == 34
    assert {episode[2] for episode in found[0]} == set(WEATHERS)  # type: ignore[index]


def test_an_episode_does_not_depend_on_its_company(scripted: None) -> None:
    few = evaluate(player(), plan(["M2"], ["low"], 2), 0)
    many = evaluate(player(), plan(["M1", "M2"], ["low"], 9), 0)
    assert contents(few) == contents(many[9:11])
    other = evaluate(player(seed=1), plan(["M2"], ["low"], 2), 0)
    assert [e.seed for e in other] != [e.seed for e in few]


def test_an_episode_keeps_its_row() -> None:
    assert [row_of(index) for index in range(6)] == [0, 1, 2, 3, 0, 1]
    assert ROWS == 4


def test_seeds_are_not_those_of_training() -> None:
    ours = {episode_seed(0, "T3", "low", index) for index in range(1000)}
    theirs = {derive_seed(0, "T3", "low", index) for index in range(1000)}
    assert len(ours) == 1000
    assert not ours & theirs


def test_a_look_into_an_episode(scripted: None) -> None:
    who = player()
    (visit,) = plan(["M1"], ["low"], 1)
    (episode,) = evaluate(who, [visit], 0)
    played: Played = who(look_into(visit))
    assert played.episodes == []
    snapshot = played.snapshot
    assert snapshot is not None
    assert snapshot.images.shape == (2, 3, 8, 16)
    # The scripted images hold the step that they were taken at.
    assert set(snapshot.images.ravel()) == {snapshot.step}
    assert snapshot.step <= min(40, len(episode))
    assert snapshot.bev.shape == (200, 200)
    assert snapshot.weather == episode.weather


def test_time_is_told_apart(scripted: None) -> None:
    timing = player()(jobs_for(plan(["M1"], ["low"], 5), (), 0)[0]).timing
    assert (timing.episodes, timing.steps > 0) == (4, True)
    shares = timing.shares()
    assert sum(shares.values()) == pytest.approx(1.0)
    assert min(shares.values()) >= 0
    assert timing.simulator + timing.network + timing.loading <= timing.busy


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
    episodes = evaluate(player("idle", horizon=3), plan(["M1"], ["low"], 3), 0)
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

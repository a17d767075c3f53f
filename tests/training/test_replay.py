"""Environments come back to where they were: in any number of processes, and when a worker is lost on the way."""

from __future__ import annotations

import os
import signal
from typing import Any

import numpy as np
import pytest
from parallel_worlds import MakeSeededNoise
from stable_baselines3.common.vec_env import DummyVecEnv

from me3bev_cli.api import ObservationConfig
from me3bev_cli.environment_host import Play, play_again
from me3bev_cli.environment_workers import Recovery
from me3bev_cli.parallel_envs import ParallelEnvs
from me3bev_cli.training.episodes import EpisodeMaker
from me3bev_cli.training.replay import ReplayedEnvs
from me3bev_cli.workers import WorkerDiedError
from me3bev_plugins.simulator.highway import Highway, HighwayConfig


def environments(workers: int, told: list[str] | None = None, silence: float | None = None) -> ReplayedEnvs:
    """Three environments that play 0, 3, 6, ..., 1, 4, 7, ... and 2, 5, 8, ..."""
    makers = [MakeSeededNoise(i) for i in range(3)]
    envs = ParallelEnvs(makers, workers) if workers else DummyVecEnv(list(makers))
    return ReplayedEnvs(envs, [0, 1, 2], 3, (told if told is not None else []).append, silence)


def worker_of_the_last(envs: ReplayedEnvs) -> int:
    assert isinstance(envs.venv, ParallelEnvs)
    pid = envs.venv._pool.workers[-1].process.pid
    assert pid is not None
    return pid


def actions(step: int) -> Any:
    return np.random.default_rng(step).uniform(-1, 1, (3, 2)).astype(np.float32)


def told_of(step: tuple[Any, ...]) -> Any:
    observations, rewards, dones, infos = step
    lasts = [info.pop("terminal_observation", None) for info in infos]
    return (
        {key: value.tobytes() for key, value in observations.items()},
        rewards.tolist(),
        dones.tolist(),
        infos,
        [last and {key: last[key].tobytes() for key in sorted(last)} for last in lasts],
    )


@pytest.mark.parametrize(("before", "after"), [(0, 0), (0, 2), (3, 2), (2, 0)])
def test_they_come_back_with_another_number_of_workers(before: int, after: int) -> None:
    one = environments(before)
    one.reset()
    # Episodes have 3 to 8 steps.
    seen = [one.step(actions(step))[0] for step in range(17)][-1]
    state = one.state()
    rest = [told_of(one.step(actions(step))) for step in range(17, 34)]
    one.close()
    other = environments(after)
    observations = other.restore(state)
    assert observations is not None
    assert {k: v.tobytes() for k, v in observations.items()} == {k: v.tobytes() for k, v in seen.items()}
    assert [told_of(other.step(actions(step))) for step in range(17, 34)] == rest
    other.close()


def test_environments_that_have_not_begun_do_so_at_their_episode() -> None:
    one, other = environments(0), environments(2)
    one.env_method("play_from", 7, indices=[1])
    assert other.restore(one.state()) is None
    first, second = one.reset(), other.reset()
    assert first["vehicle"].tobytes() == second["vehicle"].tobytes()
    assert one.episodes == other.episodes == [0, 7, 2]
    other.close()


def test_a_replay_can_be_given_up() -> None:
    one = environments(0)
    one.reset()
    one.step(actions(0))

    def no_more() -> None:
        raise InterruptedError

    with pytest.raises(InterruptedError):
        environments(0).restore(one.state(), no_more)


@pytest.mark.parametrize("sign", [signal.SIGKILL, signal.SIGSTOP])
def test_a_dead_or_hung_worker_is_started_again(sign: signal.Signals) -> None:
    undisturbed, told = environments(0), list[str]()
    # Long enough for a busy machine: a worker that is only slow would be started again too, to no harm.
    disturbed = environments(2, told, 2.0 if sign == signal.SIGSTOP else None)
    try:
        expected = {k: v.tobytes() for k, v in undisturbed.reset().items()}
        assert {k: v.tobytes() for k, v in disturbed.reset().items()} == expected
        victim = worker_of_the_last(disturbed)
        for step in range(30):
            if step == 17:
                os.kill(victim, sign)
            assert told_of(disturbed.step(actions(step))) == told_of(undisturbed.step(actions(step)))
        assert len(told) >= 1
        assert "environments 1 to 2" in told[0]
        assert ("killed by SIGKILL" if sign == signal.SIGKILL else "gave no answer for 2 s") in told[0]
        assert worker_of_the_last(disturbed) != victim
    finally:
        disturbed.close()


def test_a_worker_that_dies_over_and_over_is_given_up() -> None:
    told: list[str] = []
    envs = environments(2, told)
    envs.reset()
    deadly = np.zeros((3, 2), np.float32)
    deadly[2, 0] = 9
    with pytest.raises(WorkerDiedError, match=r"process 2 of 2 \(environments 1 to 2\) died: killed by SIGKILL"):
        envs.step(deadly)
    assert len(told) == 3


def test_waiting_for_a_hung_worker_can_be_given_up() -> None:
    def no_more() -> None:
        raise InterruptedError

    envs = ParallelEnvs([MakeSeededNoise(i) for i in range(3)], 2)
    replayed = ReplayedEnvs(envs, [0, 1, 2], 3, lambda _: None)
    replayed.reset()
    envs.recover_with(Recovery(replayed.plays, lambda _: None, None, no_more))
    os.kill(worker_of_the_last(replayed), signal.SIGSTOP)
    with pytest.raises(InterruptedError):
        replayed.step(actions(0))


def test_a_town_comes_back_in_a_fresh_environment() -> None:
    simulator = Highway(HighwayConfig(vehicles=20, pedestrians=20, horizon=9))
    view = ObservationConfig(height=16, width=44)
    make = EpisodeMaker(simulator, view, "T2", "low", ("rain", "clear_noon"), True, run_seed=4, first=2, stride=3)
    old = make()
    taken = [np.array([0.05 * (step % 3 - 1), 0.5], np.float32) for step in range(30)]
    old.reset()
    episode, since = 2, 0
    for step, action in enumerate(taken[:25]):
        _, _, terminated, truncated, _ = old.step(action)
        if terminated or truncated:
            old.reset()
            episode, since = episode + 3, step + 1
    assert episode > 2
    fresh = make()
    play_again(fresh, Play(episode, taken[since:25]))
    for action in taken[25:27]:
        a, b = old.step(action), fresh.step(action)
        assert {k: v.tobytes() for k, v in a[0].items()} == {k: v.tobytes() for k, v in b[0].items()}
        assert a[1] == b[1]
        assert repr(a[4]["record"]) == repr(b[4]["record"])

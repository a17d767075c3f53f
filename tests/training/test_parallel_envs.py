"""Environments in worker processes: the same bytes as in one, errors that say where, nothing left behind."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from parallel_worlds import MakeNoise
from stable_baselines3.common.vec_env import DummyVecEnv, VecEnv

from me3bev_cli.api import ObservationConfig
from me3bev_cli.errors import MapError
from me3bev_cli.parallel_envs import ParallelEnvs
from me3bev_cli.recipe_loading import resolve_recipe
from me3bev_cli.training.environments import make_environments
from me3bev_cli.training.episodes import EpisodeMaker
from me3bev_cli.workers import JobError, WorkerDiedError, core_of_each
from me3bev_plugins.simulator.highway import Highway, HighwayConfig

TESTS = Path(__file__).resolve().parent.parent


@contextmanager
def noise(count: int, workers: int) -> Iterator[ParallelEnvs]:
    envs = ParallelEnvs([MakeNoise(str(i)) for i in range(count)], workers)
    try:
        yield envs
    finally:
        envs.close()


def without_clock(info: dict[str, Any]) -> dict[str, Any]:
    if "episode" not in info:
        return info
    return info | {"episode": {key: value for key, value in info["episode"].items() if key != "t"}}


def history(envs: VecEnv, steps: int) -> list[Any]:
    """All that comes back of some steps with drawn actions, arrays as bytes."""
    envs.seed(11)
    envs.set_options({"note": 3})
    rng = np.random.default_rng(0)
    log: list[Any] = [{key: value.tobytes() for key, value in envs.reset().items()}, list(envs.reset_infos)]
    for _ in range(steps):
        actions = rng.uniform(-1, 1, (envs.num_envs, 2)).astype(np.float32)
        observations, rewards, dones, infos = envs.step(actions)
        assert rewards.dtype == np.float32
        assert dones.dtype == bool
        lasts = [info.pop("terminal_observation", None) for info in infos]
        assert [last is not None for last in lasts] == dones.tolist()
        log.append({key: (value.dtype, value.shape, value.tobytes()) for key, value in observations.items()})
        log.append((rewards.tolist(), dones.tolist(), [without_clock(info) for info in infos], list(envs.reset_infos)))
        log.append([last and {key: (last[key].dtype, last[key].tobytes()) for key in sorted(last)} for last in lasts])
    return log


@pytest.mark.parametrize(("count", "workers"), [(1, 1), (3, 1), (3, 2), (3, 3), (2, 9)])
def test_any_number_of_workers_gives_what_one_process_gives(count: int, workers: int) -> None:
    expected = history(DummyVecEnv([MakeNoise(str(i)) for i in range(count)]), 25)
    with noise(count, workers) as envs:
        assert len(set(envs.env_method("pid"))) == min(count, workers)
        assert history(envs, 25) == expected


def drive_towns(workers: int) -> list[Any]:
    """Two and a half short episodes in each of three environments."""
    simulator = Highway(HighwayConfig(vehicles=10, pedestrians=10, horizon=6))
    view = ObservationConfig(height=16, width=44)
    makers = [
        EpisodeMaker(simulator, view, "T2", "low", ("clear_noon", "rain"), True, run_seed=4, first=i, stride=3)
        for i in range(3)
    ]
    envs = ParallelEnvs(makers, workers) if workers else DummyVecEnv(list(makers))
    try:
        log = []
        for step in range(16):
            observations, rewards, dones, infos = (
                (envs.reset(), 0, 0, []) if not step else envs.step(np.ones((3, 2)) / 9)
            )
            log.append({key: value.tobytes() for key, value in observations.items()})
            log.append(repr((rewards, dones, [sorted(info["record"].items()) for info in infos])))
        return log
    finally:
        envs.close()


def test_towns_give_the_same_bytes_in_any_process_and_order() -> None:
    expected = drive_towns(0)
    assert len({str(entry) for entry in expected}) > 30
    assert drive_towns(2) == drive_towns(3) == expected


def test_what_is_returned_stays_as_it_is() -> None:
    with noise(2, 2) as envs:
        held: list[Any] = [envs.reset()]
        held += [envs.step(np.zeros((2, 2)))[0] for _ in range(6)]
        held.append({"images": envs.step(np.zeros((2, 2)))[0]["images"][1, 0]})
        kept = [{key: value.copy() for key, value in observation.items()} for observation in held]
        for _ in range(6):
            envs.step(np.zeros((2, 2)))
        for observation, copy in zip(held, kept, strict=True):
            for key, value in observation.items():
                np.testing.assert_array_equal(value, copy[key])


def test_attributes_and_methods_of_chosen_environments() -> None:
    with noise(5, 2) as envs:
        assert envs.get_attr("name") == ["0", "1", "2", "3", "4"]
        assert envs.get_attr("name", [4, 0, -2]) == ["4", "0", "3"]
        envs.set_attr("closed_at", "noon", 1)
        assert envs.get_attr("closed_at") == ["", "noon", "", "", ""]
        assert envs.env_method("threads", indices=[3]) == ["1"]
        assert envs.env_method("pid")[0] != os.getpid()
        assert not envs.has_attr("nothing")
        with pytest.raises(AttributeError, match="'nothing'"):
            envs.get_attr("nothing")


@pytest.mark.skipif(not hasattr(os, "sched_getaffinity"), reason="processes cannot be kept on a processor here")
def test_one_worker_per_core_stays_on_its_own() -> None:
    mine = os.sched_getaffinity(0)
    with noise(2, 2) as envs:
        places = [os.sched_getaffinity(pid) for pid in envs.env_method("pid")]
        assert places == ([{core} for core in sorted(mine)] if len(mine) == 2 else [mine, mine])
    assert core_of_each(len(mine)) == sorted(mine)
    assert core_of_each(len(mine) + 1) == [None] * (len(mine) + 1)


def test_mistakes_and_defects_come_back_and_the_others_go_on() -> None:
    with noise(3, 2) as envs:
        envs.reset()
        with pytest.raises(MapError, match="unknown map in 2") as mistake:
            envs.step(np.array([[0.0, 0.0], [0.0, 0.0], [7.0, 0.0]]))
        assert mistake.value.allowed == "T1"
        with pytest.raises(JobError, match=r"(?s)Traceback.*parallel_worlds.*ZeroDivisionError: a defect in 0"):
            envs.step(np.array([[8.0, 0.0], [0.0, 0.0], [0.0, 0.0]]))
        assert envs.step(np.zeros((3, 2)))[1].shape == (3,)


def test_a_mistake_in_making_leaves_no_process() -> None:
    before = set(children())
    with pytest.raises(MapError, match="no world for b"):
        ParallelEnvs([MakeNoise("a"), MakeNoise("b", fails=True)], 2)
    assert set(children()) <= before


def test_a_dead_worker_is_named() -> None:
    with noise(5, 2) as envs:
        envs.reset()
        actions = np.zeros((5, 2))
        actions[3, 0] = 9
        with pytest.raises(WorkerDiedError, match=r"process 2 of 2 \(environments 2 to 4\) died: killed by SIGKILL"):
            envs.step(actions)
        with pytest.raises(RuntimeError, match="closed"):
            envs.reset()


def test_closing_twice_and_in_the_middle_of_a_step() -> None:
    with noise(2, 2) as envs:
        envs.reset()
        pids = envs.env_method("pid")
        envs.step_async(np.zeros((2, 2)))
        envs.close()
        envs.close()
    assert not any(alive(pid) for pid in pids)


def test_a_reset_forgets_a_step_that_was_begun() -> None:
    with noise(2, 2) as envs:
        envs.reset()
        envs.step_async(np.zeros((2, 2)))
        with pytest.raises(RuntimeError, match="twice"):
            envs.step_async(np.zeros((2, 2)))
        envs.reset()
        envs.step(np.zeros((2, 2)))


def alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return Path(f"/proc/{pid}/stat").read_text().split()[2] != "Z" if Path("/proc").is_dir() else True


def children() -> list[int]:
    import multiprocessing

    return [process.pid or 0 for process in multiprocessing.active_children()]


def segments() -> set[str]:
    folder = Path("/dev/shm")
    return {path.name for path in folder.iterdir() if path.name.startswith("psm_")} if folder.is_dir() else set()


SCRIPT = """
import pathlib, sys, time
sys.path.insert(0, sys.argv[1])
from parallel_worlds import MakeNoise
from me3bev_cli.parallel_envs import ParallelEnvs
import numpy as np
if __name__ == "__main__":
    envs = ParallelEnvs([MakeNoise("a"), MakeNoise("b"), MakeNoise("c")], 2)
    envs.reset()
    pathlib.Path(sys.argv[2]).write_text(" ".join(str(pid) for pid in set(envs.env_method("pid"))))
    while True:
        envs.step(np.zeros((3, 2)))
"""


@pytest.mark.parametrize("sign", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_no_end_leaves_processes_or_memory_behind(sign: signal.Signals, tmp_path: Path) -> None:
    script, told = tmp_path / "script.py", tmp_path / "pids"
    script.write_text(SCRIPT)
    before = segments()
    parent = subprocess.Popen(
        [sys.executable, str(script), str(TESTS), str(told)],
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    deadline = time.monotonic() + 60
    while not (told.exists() and told.read_text()) and time.monotonic() < deadline:
        time.sleep(0.05)
    pids = [int(pid) for pid in told.read_text().split()]
    assert len(pids) == 2
    # Ctrl-C goes to the whole group, as in a terminal.
    (os.killpg if sign == signal.SIGINT else os.kill)(parent.pid, sign)
    _, err = parent.communicate(timeout=60)
    while any(alive(pid) for pid in pids) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not any(alive(pid) for pid in pids)
    assert segments() <= before
    assert "leaked" not in err
    assert "BufferError" not in err


def test_training_environments_are_the_same_in_one_process_and_in_two(line_recipe: Path) -> None:
    logs = []
    for workers in (1, 2):
        recipe = resolve_recipe(line_recipe, [f"stages.0.workers={workers}"])
        envs = make_environments(recipe, recipe.stages[0], first_episode=5)
        assert isinstance(envs.venv, ParallelEnvs) == (workers == 2)
        try:
            logs.append(history(envs, 30))
        finally:
            envs.close()
    assert repr(logs[0]) == repr(logs[1])
    assert "episode" in repr(logs[0])

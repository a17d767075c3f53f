"""Work on other processes: order, one thread, errors, deaths, Ctrl-C."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import parallel_jobs
import pytest

from me3bev_cli.errors import MapError, RecipeError
from me3bev_cli.parallel import run_jobs
from me3bev_cli.workers import THREAD_VARIABLES, JobError, WorkerDiedError


@pytest.mark.parametrize("workers", [0, 1, 2])
def test_results_are_in_the_order_of_the_jobs(workers: int) -> None:
    heard: dict[int, int] = {}
    assert run_jobs(parallel_jobs.square, range(9), workers, heard.__setitem__) == [i * i for i in range(9)]
    assert heard == {i: i * i for i in range(9)}


def test_no_jobs_need_no_workers() -> None:
    assert run_jobs(parallel_jobs.square, [], 2) == []


def test_workers_are_processes_with_one_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OMP_NUM_THREADS", "7")
    monkeypatch.delenv("MKL_NUM_THREADS", raising=False)
    (pid, threads), *_ = run_jobs(parallel_jobs.whoami, [1], 1)
    assert pid != os.getpid()
    assert threads == "1"
    assert os.environ["OMP_NUM_THREADS"] == "7"
    assert "MKL_NUM_THREADS" not in os.environ
    assert "MKL_NUM_THREADS" in THREAD_VARIABLES


def test_what_a_function_remembers_lasts_in_its_process() -> None:
    counter = parallel_jobs.Counter()
    assert run_jobs(counter, range(3), 1) == [1, 2, 3]
    assert counter.seen == 0


def test_a_dead_workers_job_is_done_again(tmp_path: Path) -> None:
    deaths: list[tuple[int, int]] = []
    jobs = [(tmp_path, number) for number in range(5)]
    assert run_jobs(parallel_jobs.die_once, jobs, 2, on_death=lambda *d: deaths.append(d)) == [0, 1, 2, 3, 4]
    assert sorted(deaths) == [(1, 1), (3, 1)]


def test_a_job_that_always_kills_its_worker_is_given_up() -> None:
    with pytest.raises(WorkerDiedError, match=r"died 3 times on the same work \(exit code 3\).*fewer --workers"):
        run_jobs(parallel_jobs.die_always, [1], 1)


@pytest.mark.parametrize("workers", [0, 1])
def test_mistakes_come_back_as_they_are(workers: int) -> None:
    with pytest.raises(MapError) as map_error:
        run_jobs(parallel_jobs.refuse, ["map"], workers)
    assert str(map_error.value) == "--maps: unknown map 'T33'; did you mean 'T3'? Allowed: T1, T3"
    assert map_error.value.allowed == "T1, T3"
    with pytest.raises(RecipeError) as recipe_error:
        run_jobs(parallel_jobs.refuse, ["recipe"], workers)
    assert [fault.what for fault in recipe_error.value.faults] == ["first", "second"]


def test_defects_keep_their_traceback() -> None:
    with pytest.raises(JobError, match=r"(?s)in blunder.*ZeroDivisionError"):
        run_jobs(parallel_jobs.blunder, [1, 2], 2)
    with pytest.raises(JobError, match="a result cannot be sent"):
        run_jobs(parallel_jobs.unsendable, [1], 1)


def test_stdout_is_the_commands_own(capfd: pytest.CaptureFixture[str]) -> None:
    run_jobs(parallel_jobs.greet, [1], 1)
    out, err = capfd.readouterr()
    assert "greetings" not in out
    assert "greetings" in err


def alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return Path(f"/proc/{pid}/stat").read_text().split()[2] != "Z" if Path("/proc").is_dir() else True


def test_ctrl_c_ends_every_worker_without_noise(tmp_path: Path) -> None:
    code = (
        "import sys, pathlib; sys.path.insert(0, sys.argv[1])\n"
        "import parallel_jobs; from me3bev_cli.parallel import run_jobs\n"
        "try: run_jobs(parallel_jobs.wait_for_ever, [pathlib.Path(sys.argv[2])] * 2, 2)\n"
        "except KeyboardInterrupt: print('stopped')\n"
    )
    command = [sys.executable, "-c", code, str(Path(parallel_jobs.__file__).parent), str(tmp_path)]
    parent = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    )
    deadline = time.monotonic() + 60
    while len(list(tmp_path.iterdir())) < 2 and time.monotonic() < deadline:
        time.sleep(0.02)
    pids = [int(path.name) for path in tmp_path.iterdir()]
    assert len(pids) == 2
    # As a terminal does: to the whole group.
    os.killpg(parent.pid, signal.SIGINT)
    out, err = parent.communicate(timeout=60)
    assert (out, err, parent.returncode) == ("stopped\n", "", 0)
    assert not any(alive(pid) for pid in pids)

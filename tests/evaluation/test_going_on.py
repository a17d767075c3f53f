"""An evaluation that is cut off goes on with the same command and ends with the same bytes."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
import scripted_world
from scripted_world import RECIPE
from typer.testing import CliRunner, Result

from me3bev_cli.main import app


@pytest.fixture
def options(scripted: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("ME3BEV_RUNS", str(tmp_path / "runs"))
    (tmp_path / "by-script.yaml").write_text(RECIPE)
    return ["--driver", "random", "--recipe", "by-script.yaml", "--maps", "M1,M2", "--episodes", "9"]


def run(*arguments: object) -> Result:
    return CliRunner().invoke(app, ["eval", *map(str, arguments)])


def contents(out: Path) -> dict[str, bytes]:
    files = [path for path in out.rglob("*") if path.is_file() and path.name != "timing.json"]
    return {path.relative_to(out).as_posix(): path.read_bytes() for path in files}


def forget_references(tmp_path: Path) -> None:
    """Reference drivers' episodes are kept for the next evaluation: without them everything is driven."""
    for path in (tmp_path / "runs" / "eval" / "references").rglob("*.npz"):
        path.unlink()


def whole(options: list[str], tmp_path: Path) -> dict[str, bytes]:
    result = run(*options, "--workers", 0, "--out", "whole")
    assert result.exit_code == 0, result.output
    forget_references(tmp_path)
    return contents(tmp_path / "whole")


def test_what_is_missing_or_damaged_is_driven_again(options: list[str], tmp_path: Path) -> None:
    expected = whole(options, tmp_path)
    out = tmp_path / "whole"
    logs = out / "episodes" / "random"
    (logs / "M1-high-00003.npz").unlink()
    (logs / "M2-high-00008.npz").write_bytes(b"PK\x03\x04")
    for path in out.glob("results.*"):
        path.unlink()
    result = run(*options, "--workers", 0, "--out", "whole")
    assert result.exit_code == 0, result.output
    assert "16 of them have been driven already" in result.stderr
    assert "M2-high-00008.npz: the log is damaged or truncated" in result.stderr
    assert contents(out) == expected
    sittings = json.loads((out / "timing.json").read_text())["sittings"]
    assert [sitting["episodes"] for sitting in sittings] == [18, 2]


def test_a_finished_evaluation_is_not_driven_again(options: list[str], tmp_path: Path) -> None:
    expected = whole(options, tmp_path)
    result = run(*options, "--workers", 0, "--out", "whole")
    assert "nothing was left to drive" in result.stdout
    assert contents(tmp_path / "whole") == expected


def process(options: list[str], tmp_path: Path, out: str, workers: int, slow: float) -> subprocess.Popen[str]:
    """The command in a process of its own whose environments take their time."""
    paths = [str(Path(scripted_world.__file__).parent), str(tmp_path / "site"), os.environ.get("PYTHONPATH", "")]
    env = {**os.environ, "PYTHONPATH": os.pathsep.join(paths), "SCRIPTED_SLEEP": str(slow)}
    code = (
        "import signal, sys; signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "from me3bev_cli.main import main; main()"
    )
    command = [sys.executable, "-c", code, "eval", *options, "--workers", str(workers), "--out", out]
    return subprocess.Popen(command, env=env, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def wait_for_logs(logs: Path, count: int, child: subprocess.Popen[str]) -> None:
    deadline = time.monotonic() + 120
    while len(list(logs.glob("[!.]*.npz"))) < count:
        assert time.monotonic() < deadline
        assert child.poll() is None, child.communicate()
        time.sleep(0.02)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGKILL])
def test_ctrl_c_and_kill_keep_finished_episodes(options: list[str], tmp_path: Path, number: int) -> None:
    expected = whole(options, tmp_path)
    logs = tmp_path / "cut" / "episodes" / "random"
    child = process(options, tmp_path, "cut", 2, 0.02)
    wait_for_logs(logs, 3, child)
    workers = children(child.pid)
    child.send_signal(number)
    _, err = child.communicate(timeout=60)
    deadline = time.monotonic() + 60
    # Workers that nobody waits for any more leave after the episode that they are at.
    while any(Path(f"/proc/{pid}").exists() for pid in workers):
        assert time.monotonic() < deadline
        time.sleep(0.02)
    kept = len(list(logs.glob("[!.]*.npz")))
    assert 3 <= kept < 18
    if number == signal.SIGINT:
        assert child.returncode == 130
        assert f"stopped: {kept} of 18 episodes are kept in cut; the same command goes on" in err
    assert not (tmp_path / "cut" / "results.json").exists()
    forget_references(tmp_path)
    result = run(*options, "--workers", 0, "--out", "cut")
    assert result.exit_code == 0, result.output
    assert contents(tmp_path / "cut") == expected


def children(pid: int) -> list[int]:
    found = []
    for path in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = path.read_text().rsplit(")", 1)[1].split()
            command = (path.parent / "cmdline").read_text()
        except OSError:
            continue
        if int(fields[1]) == pid and "spawn_main" in command:
            found.append(int(path.parent.name))
    return found


@pytest.mark.skipif(not Path("/proc").is_dir(), reason="looks for processes in /proc")
def test_a_killed_workers_episodes_are_driven_again(options: list[str], tmp_path: Path) -> None:
    expected = whole(options, tmp_path)
    child = process(options, tmp_path, "killed", 2, 0.02)
    wait_for_logs(tmp_path / "killed" / "episodes" / "random", 2, child)
    os.kill(children(child.pid)[0], signal.SIGKILL)
    _, err = child.communicate(timeout=120)
    assert child.returncode == 0, err
    assert "workers lost 1" in err
    assert contents(tmp_path / "killed") == expected


def refused(*arguments: object) -> str:
    result = run(*arguments)
    assert result.exit_code == 2, result.output
    return result.stderr


def test_another_evaluation_is_refused(options: list[str], tmp_path: Path) -> None:
    before = whole(options, tmp_path)
    same = [*options, "--workers", "0", "--out", "whole"]
    advice = ". Choose another --out, or --overwrite begins anew\n"
    start = "me3bev: --out: whole holds another evaluation: "
    assert refused(*same, "--seed", 1) == f"{start}the seed of 'random' is 0, not 1{advice}"
    assert refused(*same, "--weather", "wet") == f"{start}the weather of 'random' differs{advice}"
    assert refused(*same, "--episodes", 8) == f"{start}it has 9 episodes per map and density, not 8{advice}"
    assert refused(*same, "--maps", "M1") == f"{start}its maps are M1,M2, not M1{advice}"
    other = ["--driver", "idle", *options[2:], "--workers", "0", "--out", "whole"]
    assert refused(*other) == f"{start}it has the driver 'random', which is not asked for{advice}"
    (tmp_path / "by-script.yaml").write_text(RECIPE.replace("horizon: 40", "horizon: 30"))
    assert refused(*same) == f"{start}the simulator settings of 'random' differs{advice}"
    assert contents(tmp_path / "whole") == before


def test_overwrite_begins_anew(options: list[str], tmp_path: Path) -> None:
    whole(options, tmp_path)
    mine = tmp_path / "whole" / "notes.txt"
    mine.write_text("my own")
    assert run(*options, "--workers", 0, "--out", "whole", "--episodes", 2, "--overwrite").exit_code == 0
    assert len(list((tmp_path / "whole" / "episodes").rglob("*.npz"))) == 4
    assert mine.read_text() == "my own"


def rows(out: Path) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = json.loads((out / "results.json").read_text())["rows"]
    return found


def test_an_evaluation_can_grow(options: list[str], tmp_path: Path) -> None:
    grown = [*options, "--density", "low,high", "--reference", "autopilot", "--workers", "0"]
    assert run(*options, "--workers", 0, "--out", "grown", "--episodes", 4).exit_code == 0
    result = run(*grown, "--out", "grown")
    assert result.exit_code == 0, result.output
    assert "8 of them have been driven already" in result.stderr
    forget_references(tmp_path)
    assert run(*grown, "--out", "fresh").exit_code == 0
    assert contents(tmp_path / "grown") == contents(tmp_path / "fresh")


def test_reference_drivers_are_driven_once(options: list[str], tmp_path: Path) -> None:
    assert run(*options, "--workers", 0, "--out", "first").exit_code == 0
    result = run(*options, "--workers", 0, "--out", "second")
    assert "nothing was left to drive" in result.stdout
    assert contents(tmp_path / "first") == contents(tmp_path / "second")
    other = run(*options, "--workers", 0, "--out", "third", "--seed", 5)
    assert "nothing was left to drive" not in other.stdout


def test_a_folder_of_an_older_version_or_a_damaged_one_is_refused(options: list[str], tmp_path: Path) -> None:
    (tmp_path / "old").mkdir()
    (tmp_path / "old" / "results.json").write_text("{}")
    assert "an older version made it" in refused(*options, "--out", "old")
    assert run(*options, "--workers", 0, "--out", "old", "--overwrite", "--episodes", 1).exit_code == 0
    (tmp_path / "old" / "evaluation.json").write_text("{")
    assert "evaluation.json: is damaged" in refused(*options, "--out", "old")

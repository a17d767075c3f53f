"""Episode logs: what is written is read back, and nothing else is."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from episodes import episode
from scripted_world import ScriptedEnv

from me3bev_cli.api import StepRecord
from me3bev_cli.errors import LogError, PluginError
from me3bev_cli.evaluation.episode import STEP_DTYPE, ending, from_records, load


def records(steps: int = 5) -> list[StepRecord]:
    env = ScriptedEnv("M1", 99, images=False)
    env.reset(seed=3)
    return [env.step(np.zeros(2))[4]["record"] for _ in range(steps)]


NAMES = {"map": "M1", "density": "low", "weather": "dry", "seed": 3, "index": 0, "driver": "idle"}


def test_columns_are_the_records() -> None:
    reported = records()
    drive = from_records(reported, ended="timeout", **NAMES)  # type: ignore[arg-type]
    assert set(STEP_DTYPE.names or ()) == set(StepRecord.__annotations__)
    for name in STEP_DTYPE.names or ():
        np.testing.assert_array_equal(drive[name], [record[name] for record in reported])  # type: ignore[literal-required]
    assert len(drive) == 5
    assert drive.step_seconds == pytest.approx(0.1)


def test_a_log_gives_back_the_episode(tmp_path: Path) -> None:
    drive = episode(7, "collision", collision=[""] * 6 + ["pedestrian"], x=np.random.default_rng(0).normal(size=7))
    path = tmp_path / "deep" / drive.file_name
    drive.save(path)
    again = load(path)
    assert {k: v for k, v in vars(again).items() if k != "steps"} == {
        k: v for k, v in vars(drive).items() if k != "steps"
    }
    # Bytes, since NaN is not equal to itself.
    assert again.steps.tobytes() == drive.steps.tobytes()
    assert path.name == "T1-low-00000.npz"
    other = tmp_path / "other.npz"
    again.save(other)
    assert other.read_bytes() == path.read_bytes()
    assert path.stat().st_size < 4000


def test_an_older_log_is_read_without_what_it_lacks(tmp_path: Path) -> None:
    drive = episode(3, speed=[1, 2, 3])
    names = [name for name in STEP_DTYPE.names or () if name not in ("background_speed", "red_met")]
    header = {key: value for key, value in vars(drive).items() if key != "steps"}
    packed = np.array([tuple(step) for step in drive.steps[names]], [(name, STEP_DTYPE[name]) for name in names])
    np.savez_compressed(tmp_path / "old.npz", header=json.dumps(header | {"format": 2}), steps=packed)
    old = load(tmp_path / "old.npz")
    assert old["speed"].tolist() == [1, 2, 3]
    assert (old.has("speed"), old.has("red_met")) == (True, False)
    old.save(tmp_path / "again.npz")
    assert load(tmp_path / "again.npz").steps.tobytes() == old.steps.tobytes()


def test_why_an_episode_ended() -> None:
    last = records(1)[0]
    driven = {**last, "route_done": 30.0, "collision": ""}
    assert ending([{**driven, "collision": "static"}], terminated=True) == "collision"  # type: ignore[typeddict-item]
    assert ending([driven], terminated=True) == "finished"  # type: ignore[list-item]
    assert ending([{**driven, "route_done": 20.0}], terminated=True) == "stopped"  # type: ignore[typeddict-item]
    assert ending([driven], terminated=False) == "timeout"  # type: ignore[list-item]


def test_records_that_break_the_contract() -> None:
    poor = [{k: v for k, v in record.items() if k != "speed"} for record in records()]
    with pytest.raises(PluginError, match=r"info\['record'\] lacks 'speed'. StepRecord lists the fields"):
        from_records(poor, ended="timeout", **NAMES)  # type: ignore[arg-type]
    odd = [{**record, "collision": "cow"} for record in records()]
    with pytest.raises(PluginError, match="reports the collision 'cow'"):
        from_records(odd, ended="timeout", **NAMES)  # type: ignore[arg-type]
    words = [{**record, "speed": "fast"} for record in records()]
    with pytest.raises(PluginError, match="is not a StepRecord"):
        from_records(words, ended="timeout", **NAMES)  # type: ignore[arg-type]


@pytest.mark.parametrize("cut", [0, 10, 300, -1])
def test_a_truncated_log_is_refused(tmp_path: Path, cut: int) -> None:
    path = tmp_path / "log.npz"
    episode().save(path)
    path.write_bytes(path.read_bytes()[:cut])
    with pytest.raises(LogError, match=r"log\.npz: the log is damaged or truncated"):
        load(path)


def test_what_is_no_log_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "log.npz"
    with pytest.raises(LogError, match="there is no such log"):
        load(path)
    np.savez(path, header=np.array('{"format": 99}'), steps=np.zeros(3))
    with pytest.raises(LogError, match=r"a format that this version does not read\. Allowed: 2, 3"):
        load(path)
    np.savez(path, header=np.array('{"format": 3, "ended": "timeout"}'), steps=np.zeros(3))
    with pytest.raises(LogError, match="does not hold an episode's steps"):
        load(path)
    np.savez(path, header=np.array('{"format": 3, "ended": "timeout"}'), steps=np.zeros(3, STEP_DTYPE))
    with pytest.raises(LogError, match="header is not an episode's"):
        load(path)
    np.savez(path, header=np.array([{"format": 3}], dtype=object), steps=np.zeros(3))
    with pytest.raises(LogError, match="damaged"):
        load(path)

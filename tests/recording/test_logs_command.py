"""`me3bev collect` and `me3bev logs` from the command line."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from log_files import AUTOPILOT, OBSERVATION, LineWorld, write_foreign, write_log
from typer.testing import CliRunner

from me3bev_cli.main import app
from me3bev_cli.recipe import PluginChoice
from me3bev_cli.recording.collect import Recorder, Take, collect
from me3bev_cli.recording.logfile import LogWarning
from me3bev_cli.recording.reader import read_steps

RUN = CliRunner()


def run(*words: object, code: int = 0) -> str:
    found = RUN.invoke(app, [str(word) for word in words])
    assert found.exit_code == code, found.output
    return found.output


def test_collecting(tmp_path: Path, line_recipe: Path) -> None:
    words = ("collect", "--recipe", line_recipe, "--driver", "idle", "--maps", "F1", "--density", "all")
    run(*words, "--episodes", 1, "--out", tmp_path / "a", "--depth", "--semantics")
    assert sorted(path.name for path in (tmp_path / "a").iterdir()) == ["F1-high-00000.mcap", "F1-low-00000.mcap"]
    assert "2 of 2 logs are sound" in run("logs", "check", tmp_path / "a")
    message = run(*words, "--png", "--quality", 80, "--out", tmp_path, code=2)
    assert "PNG images have no quality" in message
    message = run(*words, "--png", "--out", tmp_path / "a", code=2)
    assert "its images is 'jpeg 92', not 'png'" in message


def test_files_are_the_same_for_any_number_of_workers(tmp_path: Path) -> None:
    takes = [Take(place, "low", index) for place in ("F1", "F2") for index in range(2)]
    for workers in (0, 1):  # Another process, and whatever is kept from episode to episode, changes nothing.
        recorder = Recorder(LineWorld(PluginChoice(name="line"), OBSERVATION), AUTOPILOT, 0, tmp_path / str(workers))
        assert collect(recorder, takes[:: 1 - 2 * workers], workers) == 4
    for take in takes:
        assert take.path(tmp_path / "0").read_bytes() == take.path(tmp_path / "1").read_bytes()


def test_info_counts(tmp_path: Path) -> None:
    for number in range(2):
        write_log(tmp_path / f"{number}.mcap", seed=number)
    shown = json.loads(run("logs", "info", tmp_path / "1.mcap", "--json", "-").partition("{")[2].join(("{", "")))
    (row,) = shown["rows"]
    assert (row["map"], row["steps"], row["seconds"], row["ended"]) == ("F1", 12, pytest.approx(1.1), "timeout")
    assert (row["collisions"], row["off_road_steps"]) == (0, 0)
    text = run("logs", "info", tmp_path)
    assert "2 episodes, 24 steps" in text
    (tmp_path / "2.mcap").write_bytes(b"")
    assert "2.mcap: the log is empty" in run("logs", "info", tmp_path, code=2)


@pytest.mark.filterwarnings("error")
def test_mistakes_have_exit_code_2_and_no_traceback(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("me3bev_cli.recording.container.CHUNK_BYTES", 100_000)
    assert "holds no MCAP file" in run("logs", "info", tmp_path, code=2)
    assert "there is no such folder" in run("logs", "check", tmp_path / "none", code=2)
    path = write_log(tmp_path / "a.mcap")
    assert "there is no camera 'top'" in run("logs", "export", path, "--out", tmp_path, "--cameras", "top", code=2)
    assert "cannot be written" in run("logs", "export", path, "--out", path / "x", code=2)
    path.write_bytes(path.read_bytes()[:-20_000])
    assert "is cut off" in run("logs", "check", path, code=2)
    assert "a.mcap is cut off" in run("logs", "info", path)
    write_foreign(path)
    assert "no topic /camera/NAME/image" in run("logs", "export", path, "--out", tmp_path, code=2)


def test_frames_as_pictures(tmp_path: Path) -> None:
    path = write_log(tmp_path / "a.mcap")
    assert "6 pictures" in run("logs", "export", path, "--out", tmp_path / "png", "--every", 4, "--cameras", "back")
    names = sorted(file.name for file in (tmp_path / "png" / "a").iterdir())
    assert names == [f"{number:05d}-{kind}.png" for number in (0, 4, 8) for kind in ("back", "bev")]
    step = list(read_steps(path))[4]
    found = cv2.imread(str(tmp_path / "png" / "a" / "00004-back.png"))
    np.testing.assert_array_equal(found[:, :, ::-1].transpose(2, 0, 1), step.observation["images"][1])
    mapping = tmp_path / "topics.yaml"
    mapping.write_text("cameras: {r: /right}")
    images = write_foreign(tmp_path / "b.mcap")
    run("logs", "export", tmp_path / "b.mcap", "--out", tmp_path / "png", "--mapping", mapping)
    found = cv2.imread(str(tmp_path / "png" / "b" / "00009-r.png"))
    np.testing.assert_array_equal(found[:, :, ::-1].transpose(2, 0, 1), images[9, 1])


def test_frames_as_a_video(tmp_path: Path) -> None:
    write_log(tmp_path / "a.mcap", observation=OBSERVATION.model_copy(update={"height": 32}))
    assert "12 frames" in run("logs", "export", tmp_path, "--out", tmp_path / "a.mp4")
    video = cv2.VideoCapture(str(tmp_path / "a.mp4"))
    assert video.get(cv2.CAP_PROP_FRAME_WIDTH) == 2 * 32 + 32
    assert video.get(cv2.CAP_PROP_FRAME_COUNT) == 12


def test_recovering(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("me3bev_cli.recording.container.CHUNK_BYTES", 100_000)
    path = write_log(tmp_path / "a.mcap")
    path.write_bytes(path.read_bytes()[:-20_000])
    run("logs", "recover", path, "--out", tmp_path / "b.mcap")
    assert "1 of 1 logs are sound" in run("logs", "check", tmp_path / "b.mcap")
    with pytest.warns(LogWarning):
        assert len(list(read_steps(path))) == len(list(read_steps(tmp_path / "b.mcap"))) == 9

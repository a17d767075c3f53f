"""`me3bev drive` as a user meets it: a video that opens, or a reason why there is none."""

from __future__ import annotations

import errno
import os
import re
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import av
import fakes
import numpy as np
import pytest
from numpy.typing import NDArray
from typer.testing import CliRunner, Result

from me3bev_cli.driving import video
from me3bev_cli.driving.film import HOLD_FRAMES, TITLE_FRAMES
from me3bev_cli.driving.frame import HEIGHT, WIDTH
from me3bev_cli.main import app

LINE = ("--simulator", "line", "--driver", "autopilot")


@pytest.fixture(autouse=True)
def here(line_plugins: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty current folder."""
    folder = tmp_path / "here"
    folder.mkdir()
    monkeypatch.chdir(folder)
    return folder


def run(*arguments: object) -> Result:
    return CliRunner().invoke(app, ["drive", *map(str, arguments)])


class Clip(NamedTuple):
    codec: str
    pixels: str
    rate: float
    frames: list[NDArray[Any]]


def clip(path: Path) -> Clip:
    """What a player finds in a video."""
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        frames = [frame.to_ndarray(format="rgb24") for frame in container.decode(stream)]
        context = stream.codec_context
        return Clip(context.name, str(context.pix_fmt), float(stream.average_rate or 0), frames)


def test_a_video_that_players_open(here: Path) -> None:
    result = run(*LINE, "--map", "F2", "--density", "high", "--video", "films/out.mp4")
    assert result.exit_code == 0, result.output
    found = clip(here / "films" / "out.mp4")
    assert (found.codec, found.pixels, found.rate) == ("h264", "yuv420p", video.RATE)
    assert len(found.frames) == fakes.LENGTH + HOLD_FRAMES
    assert {frame.shape for frame in found.frames} == {(HEIGHT, WIDTH, 3)}
    assert "F2, high, " in result.stdout
    assert re.search(r"episode 1: time is up after 1.2 s, route \d+ %, driving score [\d.]+", result.stdout)
    assert f"wrote films/out.mp4: {len(found.frames)} frames, 2.2 s" in result.stdout
    assert [path.name for path in (here / "films").iterdir()] == ["out.mp4"]
    assert oct((here / "films" / "out.mp4").stat().st_mode)[-3:] == "644"


def test_several_episodes_have_titles(here: Path) -> None:
    result = run(*LINE, "--episodes", 2, "--steps", 3, "--video", "out.webm")
    assert result.exit_code == 0, result.output
    found = clip(here / "out.webm")
    assert found.codec == "vp9"
    assert len(found.frames) == 2 * (TITLE_FRAMES + 3 + HOLD_FRAMES)
    # The outcome stands out from the last frame; the next title is nearly dark.
    assert np.abs(found.frames[7].astype(int) - found.frames[8]).max() > 100
    assert found.frames[TITLE_FRAMES + 3 + HOLD_FRAMES].mean() < 30
    assert result.stdout.count("time is up after 0.3 s") == 2


def test_a_bare_option_takes_the_usual_name(here: Path) -> None:
    assert run("--video", *LINE, "--steps", 1).exit_code == 0
    assert run(*LINE, "--map", "F2", "--steps", 1, "--video").exit_code == 0
    assert sorted(path.name for path in here.iterdir()) == ["drive-F1-autopilot.mp4", "drive-F2-autopilot.mp4"]


def test_without_a_video_the_figures_are_told(here: Path) -> None:
    result = run(*LINE, "--episodes", 2)
    assert result.exit_code == 0, result.output
    assert "autopilot, low density, 2 episodes" in result.stdout
    assert re.search(r"driving score ↑ +\d", result.stdout)
    assert list(here.iterdir()) == []


def test_driving_on_after_collisions_and_the_horizon() -> None:
    random = ("--simulator", "line", "--driver", "random", "--seed", 1, "--episodes", 3)
    stopped = run(*random)
    on = run(*random, "--no-stop", "--steps", 70)
    assert on.exit_code == stopped.exit_code == 0, on.output
    assert "collision with a vehicle, at fault" in stopped.stdout
    assert on.stdout.count(" after 7.0 s") == 3


def test_a_run_drives(line_recipe: Path, here: Path) -> None:
    trained = CliRunner().invoke(app, ["train", str(line_recipe), "--out", "runs/mine"])
    assert trained.exit_code == 0, trained.output
    for who in (("--driver", "mine"), ("--driver", "runs/mine"), ("--run", "runs/mine"), ()):
        result = run(*who, "--steps", 2)
        assert result.exit_code == 0, result.output
        assert "mine, low density, 1 episode" in result.stdout
    assert run("--driver", "mine", "--steps", 2, "--video", "--checkpoint", "last").exit_code == 0
    assert len(clip(here / "drive-F1-mine.mp4").frames) == 2 + HOLD_FRAMES
    twice = run("--driver", "mine", "--run", "runs/mine")
    assert (twice.exit_code, "--driver: two runs are named" in twice.stderr) == (2, True)
    resized = run("--run", "runs/mine", "--camera-size", "32x64")
    assert "--camera-size: a policy needs images of the size that it was trained with" in resized.stderr
    assert run("--driver", "untrained", "--run", "runs/mine", "--steps", 2).exit_code == 0


def after(steps: int, what: Callable[[], None], monkeypatch: pytest.MonkeyPatch) -> None:
    """Let something happen in a step of the fake world."""
    step = fakes.LineEnv.step

    def late(self: Any, action: Any) -> Any:
        if self.steps + 1 == steps:
            what()
        return step(self, action)

    monkeypatch.setattr(fakes.LineEnv, "step", late)


def test_an_interrupted_drive_keeps_its_film(here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    after(4, lambda: os.kill(os.getpid(), signal.SIGINT), monkeypatch)
    result = run(*LINE, "--episodes", 3, "--video", "out.mp4")
    assert result.exit_code == 130, result.output
    assert f"me3bev: stopped: wrote out.mp4: {TITLE_FRAMES + 4} frames" in result.stderr
    assert len(clip(here / "out.mp4").frames) == TITLE_FRAMES + 4
    assert [path.name for path in here.iterdir()] == ["out.mp4"]
    without = run(*LINE)
    assert (without.exit_code, "stopped: nothing is written" in without.stderr) == (130, True)


def test_a_defect_leaves_the_old_video(here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail() -> None:
        raise ZeroDivisionError

    after(4, fail, monkeypatch)
    (here / "out.mp4").write_text("old")
    assert isinstance(run(*LINE, "--video", "out.mp4").exception, ZeroDivisionError)
    assert [path.name for path in here.iterdir()] == ["out.mp4"]
    assert (here / "out.mp4").read_text() == "old"


def test_a_disk_that_fills_up(here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    add = video.FFmpegEncoder.add

    def full(self: Any, picture: Any) -> None:
        add(self, picture)
        if self.count == 3:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(video.FFmpegEncoder, "add", full)
    result = run(*LINE, "--video", "out.mp4")
    assert result.exit_code == 2
    assert "out.mp4: cannot be written: No space left on device" in result.stderr
    assert list(here.iterdir()) == []


def test_another_encoder_where_there_is_no_h264(here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(video, "has_codec", lambda name: False)
    result = run(*LINE, "--steps", 2, "--video", "out.mp4")
    assert result.exit_code == 0, result.output
    assert "me3bev: PyAV has no H.264 encoder here" in result.stderr
    found = clip(here / "out.mp4")
    assert (found.codec, len(found.frames), found.frames[0].shape) == ("mpeg4", 2 + HOLD_FRAMES, (HEIGHT, WIDTH, 3))
    webm = run(*LINE, "--steps", 2, "--video", "out.webm")
    assert (webm.exit_code, "no encoder for '.webm' here. Allowed: .mp4" in webm.stderr) == (2, True)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ("--video out.gif", "out.gif: a video cannot be '.gif'. Allowed: .mp4, .webm"),
        ("--video out", "out: the video's name has no suffix. Allowed: .mp4, .webm"),
        ("--video file/out.mp4", "file/out.mp4: cannot be written: "),
        ("--video folder.mp4", "folder.mp4: cannot be written: it is a folder. Name a file in it"),
        ("--episodes 99999999 --video out.mp4", "MB are free, "),
        ("--map F9", "--map: unknown map 'F9'. Allowed: F1, F2"),
        ("--density hgih", "--density: unknown density 'hgih'; did you mean 'high'"),
        ("--weather nigth", "--weather: unknown weather 'nigth'"),
        ("--episodes 0", "--episodes: 0 is too few"),
        ("--steps 0", "--steps: 0 is too few"),
        ("--seed -1", "--seed: -1 is negative"),
        ("--camera-size 64", "--camera-size: '64' is not a size. Allowed: HEIGHTxWIDTH, as 256x704"),
        ("--camera-size 4x44", "--camera-size: the height is 4"),
        ("--driver autopilt", "--driver: unknown driver or run 'autopilt'; did you mean 'autopilot'"),
        ("--driver folder.mp4", "folder.mp4 is not a run folder"),
        ("--simulator lime", "unknown simulator plugin 'lime'; did you mean 'line'"),
    ],
)
def test_mistakes_are_told_before_anything_is_driven(here: Path, options: str, message: str) -> None:
    (here / "folder.mp4").mkdir()
    (here / "file").touch()
    result = run(*LINE, *options.split())
    assert result.exit_code == 2, result.output
    assert message in result.stderr
    assert result.stdout == ""
    assert sorted(path.name for path in here.iterdir()) == ["file", "folder.mp4"]


def test_a_town(here: Path) -> None:
    options = "--driver autopilot --map T3 --weather night --steps 3 --camera-size 32x88 --video t3.mp4"
    result = run(*options.split())
    assert result.exit_code == 0, result.output
    assert "T3, low, night, episode 1: time is up after 0.3 s" in result.stdout
    frames = clip(here / "t3.mp4").frames
    assert len(frames) == 3 + HOLD_FRAMES
    assert frames[0].shape == (HEIGHT, WIDTH, 3)
    # Cameras, plan, semantic map and instruments are all there.
    upper, lower = frames[0][60:420], frames[0][460:880]
    for part in (upper[:, :500], upper[:, 600:1000], lower[:, 20:440], lower[:, 480:890], lower[:, 930:]):
        assert part.std() > 5

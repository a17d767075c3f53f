"""`me3bev decode`: what it prints, writes, draws and refuses."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from typer.testing import CliRunner

from me3bev_cli.main import app
from me3bev_cli.recording.frames import FrameLog
from me3bev_cli.recording.logfile import LogFile
from me3bev_cli.recording.mapping import TopicMapping

from .conftest import MakeLogs, MakeRun

FEW = ("--steps", "2", "--batch", "2", "--episodes", "2")


def _run(*arguments: object, code: int = 0) -> str:
    result = CliRunner().invoke(app, ["decode", *map(str, arguments)])
    assert result.exit_code == code, result.output + repr(result.exception)
    return result.stdout if code == 0 else result.stderr


def _decode(*arguments: object) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(_run(*arguments, "--json", "-"))
    return found


def test_a_run_is_decoded_scored_and_drawn(make_run_of: MakeRun, tmp_path: Path) -> None:
    run = make_run_of("spatial={name: tiny_grid}", "weather={training: [moon], evaluation: [mist, sun]}")
    picture, table = tmp_path / "p.png", tmp_path / "t.csv"
    result = _decode(run, *FEW, "--source", "both", "--panel", picture, "--csv", table)
    assert {row["source"] for row in result["rows"]} == {"u_bev", "grid"}
    assert {row["source"] for row in result["baselines"]} == {"untrained", "most_frequent"}
    assert set(result["weathers"]) == {"mist", "sun"}
    keys = [(row["source"], row["mask"], row["map"], row["class"]) for row in result["rows"]]
    assert len(set(keys)) == len(keys)
    assert {key[1] for key in keys} == {"all", "seen", "near", "0-15", "15-30", "30-50"}
    assert table.read_text().startswith("source,decoder,mask,map,weather,class,iou\nu_bev,resnet,all,F1,all,other,0.")
    with Image.open(picture) as image:
        assert image.width > 900
    # The decoder is there now: it is scored on every map, as it is.
    again = _decode(run, "--eval", "--maps", "F1-F2", "--episodes", 1, "--weather", "sun")
    assert again["maps"] == ["F1", "F2", "mean"]
    assert again["decoder"] == result["decoder"]
    assert again["frames"] == 6
    assert json.loads((run / "decode" / "scores.json").read_text()) == again


def test_a_decoder_that_lacks_is_trained_before_it_is_scored(make_run_of: MakeRun) -> None:
    run = make_run_of()
    result = _decode(run, "--eval", "--steps", 1, "--no-untrained", "--maps", "F2", "--episodes", 1)
    assert {row["source"] for row in result["baselines"]} == {"most_frequent"}
    assert (run / "decode" / "decoder.safetensors").exists()


def test_an_episode_is_animated(make_run_of: MakeRun, tmp_path: Path) -> None:
    _run(make_run_of(), *FEW, "--no-untrained", "--panel", tmp_path / "p.webp", "--frames", "random")
    with Image.open(tmp_path / "p.webp") as image:
        assert image.n_frames == 12


def test_logs_are_decoded_and_copied_with_their_maps(
    make_run_of: MakeRun, make_logs_of: MakeLogs, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = make_run_of()
    logs = make_logs_of(run)
    result = _decode(run, "--logs", logs, "--steps", 2, "--batch", 2, "--no-untrained", "--mcap", tmp_path / "copies")
    assert result["episodes"] == 1
    assert "seen" in {row["mask"] for row in result["rows"]}
    for path in sorted(logs.glob("*.mcap")):
        copy = FrameLog(tmp_path / "copies" / path.name)
        before, after = FrameLog(path), copy.frame(5)
        assert all(np.array_equal(after[part], value) for part, value in before.frame(5).items())
        mapping = TopicMapping(cameras=dict(copy.mapping.cameras), bev="/bev/decoded")
        decoded = FrameLog(copy.path, ("bev",), mapping)
        assert np.array_equal(decoded.times, before.times)
        assert decoded.frame(3)["bev"].shape == (200, 200)
        assert LogFile(copy.path).metadata["me3bev.decoded"]["checkpoint"] == "step_000000064"
    stderr = _run(run, "--logs", logs, "--mcap", logs, code=2)
    assert "a copy cannot replace its log" in stderr
    monkeypatch.setattr("me3bev_cli.decoding.grid_log.os.replace", _full_disk)
    stderr = _run(run, "--logs", logs, "--mcap", tmp_path / "full", code=2)
    assert "cannot be written: No space left on device" in stderr
    assert not list((tmp_path / "full").iterdir())


def _full_disk(*_: object) -> None:
    raise OSError(28, "No space left on device")


def test_a_vector_is_decoded_and_that_is_said(make_run_of: MakeRun) -> None:
    run = make_run_of("spatial={name: flat_cnn, trunk: tiny, width: 8}")
    result = _decode(run, *FEW, "--no-untrained")
    assert result["notes"] == [
        "'flat_cnn' has no bird's-eye grid: the map is decoded from one vector of 8 numbers, which does not say where "
        "things are"
    ]
    stderr = _run(run, "--source", "grid", "--out", run / "other", code=2)
    assert "--source: the spatial plugin 'flat_cnn' gives no bird's-eye grid" in stderr


def test_two_runs_are_compared(make_run_of: MakeRun, make_logs_of: MakeLogs, tmp_path: Path) -> None:
    a, b = make_run_of(name="a"), make_run_of("temporal=null", name="b")
    few = ("--compare", a, b, "--maps", "F1", "--episodes", 2, "--steps", 1, "--no-untrained")
    result = _decode(*few)
    assert result["runs"] == [str(a), str(b)]
    assert result["episodes"] == 2
    rows = {(row["mask"], row["class"]): row for row in result["rows"]}
    assert rows["remembered", "moving"]["cells"] <= rows["remembered", "mean"]["cells"]
    total = sum(rows[mask, "mean"]["cells"] for mask in ("remembered", "never_seen", "seen"))
    assert total == 40_000 * result["frames"]
    assert "B - A" in _run(*few)
    logs = make_logs_of(a, "blind", truth=False)
    stderr = _run("--compare", a, b, "--logs", logs, code=2)
    assert "lacks the cameras' depth and semantics" in stderr
    other = make_run_of("observation.width=64", name="other")
    assert "see other cameras" in _run("--compare", a, other, "--steps", 1, code=2)


def test_logs_that_do_not_fit_are_refused(make_run_of: MakeRun, make_logs_of: MakeLogs, tmp_path: Path) -> None:
    run = make_run_of()

    def refused(place: Path) -> str:
        return _run(run, "--logs", place, "--out", tmp_path / "out", code=2)

    (tmp_path / "empty").mkdir()
    assert "holds no MCAP file" in refused(tmp_path / "empty")
    assert "there is no such folder" in refused(tmp_path / "nowhere")
    wide = make_logs_of(run, "wide", width=64)
    assert "recorded with another calibration than the policy's: front: 64 x 16 pixels instead of 32 x 16" in refused(
        wide
    )
    mixed = make_logs_of(run, "mixed")
    next(iter(wide.glob("*.mcap"))).rename(mixed / "zzz.mcap")
    assert "calibrations are mixed" in refused(mixed)
    (mixed / "zzz.mcap").write_bytes(b"")
    assert "the log is empty" in refused(mixed)
    (mixed / "zzz.mcap").write_bytes(b"\x89MCAP0\r\n" + b"x" * 40)
    assert "zzz.mcap" in refused(mixed)
    one = make_logs_of(run, "one", episodes=1)
    assert "at least two episodes" in refused(one)


def test_a_foreign_log_must_have_the_topics(make_run_of: MakeRun, make_logs_of: MakeLogs, tmp_path: Path) -> None:
    run = make_run_of()
    logs = make_logs_of(run)
    mapping = tmp_path / "map.yaml"
    mapping.write_text("cameras: {front: /camera/front/image, back: /camera/back/image}\nbev: /ground/truth\n")
    stderr = _run(run, "--logs", logs, "--mapping", mapping, "--out", tmp_path / "out", code=2)
    assert "the log has no topic /ground/truth, needed for `bev`" in stderr
    mapping.write_text("cameras: {front: /camera/front/image, back: /camera/back/image}\nbev: /tf\n")
    stderr = _run(run, "--logs", logs, "--mapping", mapping, "--out", tmp_path / "out", code=2)
    assert "topic /tf holds foxglove.FrameTransform" in stderr
    mapping.write_text("cameras: {front: /camera/front/image, back: /camera/back/image}\nbev: /bev/truth\n")
    result = _decode(run, "--logs", logs, "--mapping", mapping, "--steps", 1, "--no-untrained")
    assert "seen" not in {row["mask"] for row in result["rows"]}


def test_a_log_that_is_cut_off_is_used_as_far_as_it_goes(
    make_run_of: MakeRun, make_logs_of: MakeLogs, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("me3bev_cli.recording.container.CHUNK_BYTES", 1000)
    run = make_run_of()
    logs = make_logs_of(run)
    first = min(logs.glob("*.mcap"))
    first.write_bytes(first.read_bytes()[: first.stat().st_size // 2])
    with pytest.warns(UserWarning, match="is cut off"):
        assert 0 < _decode(run, "--logs", logs, "--steps", 1, "--no-untrained")["frames"] < 3


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--logs", "x", "--weather", "night"], "--weather: recorded episodes have the weather they were recorded in"),
        (["--logs", "x", "--maps", "F1"], "--maps: recorded episodes have maps of their own"),
        (["--mcap", "x"], "--mcap: there are no logs"),
        (["--source", "latent"], "unknown source 'latent'"),
        (["--frames", "best"], "--frames: 'best' does not say which frames"),
        (["--panel", "p.gif"], "--panel: 'p.gif' is no kind of picture"),
        (["--episodes", "1"], "at least two episodes"),
        (["--pretrained", "no/where.pt"], "--pretrained: there are no weights at 'no/where.pt'"),
        (["--maps", "F9"], "unknown map 'F9'"),
        (["--checkpoint", "step_1"], "has no checkpoint 'step_1'"),
    ],
)
def test_options_that_make_no_sense_are_refused(make_run_of: MakeRun, arguments: list[str], message: str) -> None:
    assert message in _run(make_run_of(), *arguments, code=2)


def test_what_is_no_run_or_has_no_latent_is_refused(make_run_of: MakeRun, tmp_path: Path) -> None:
    assert "is not a run folder" in _run(tmp_path / "nothing", code=2)
    assert "has no bird's-eye latent" in _run(make_run_of("modalities=[vr, nav]"), code=2)

"""Logs that are cut off, damaged or empty, disks that are full, collections that are killed."""

from __future__ import annotations

import errno
import os
import signal
import struct
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from log_files import AUTOPILOT, OBSERVATION, write_foreign, write_log

from me3bev_cli.errors import LogError
from me3bev_cli.evaluation.runner import World
from me3bev_cli.recipe import PluginChoice
from me3bev_cli.recording import container
from me3bev_cli.recording.check import check_log, check_logs
from me3bev_cli.recording.collect import LOCK, Recorder, Take, collect, folder_of_ours
from me3bev_cli.recording.export import recover
from me3bev_cli.recording.logfile import LogFile, LogWarning
from me3bev_cli.recording.reader import read_episode, read_steps

WORLD = World(PluginChoice(name="line"), OBSERVATION)


@pytest.fixture
def log(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Twelve steps in four chunks."""
    monkeypatch.setattr(container, "CHUNK_BYTES", 100_000)
    return write_log(tmp_path / "a.mcap")


def test_a_sound_log_has_no_faults(log: Path, recwarn: pytest.WarningsRecorder) -> None:
    assert check_log(log) == []
    assert not recwarn


def test_a_log_that_is_cut_off_is_read_up_to_its_last_whole_chunk(log: Path) -> None:
    whole = list(read_steps(log))
    chunks = LogFile(log).contents.chunks
    data = log.read_bytes()
    assert len(chunks) == 4
    log.write_bytes(data[: chunks[2].index_offset - 1])  # the third lacks a byte
    with pytest.warns(LogWarning, match=r"cut off: 2 whole chunks .* are read, .* are lost; 6 frames are there"):
        steps = list(read_steps(log))
    assert len(steps) == 6
    np.testing.assert_array_equal(steps[5].observation["images"], whole[5].observation["images"])
    with pytest.warns(LogWarning):
        assert read_episode(log).ended == "stopped"
    with pytest.warns(LogWarning):
        assert "2 whole chunks" in check_log(log)[0]


def test_a_log_can_be_cut_anywhere(log: Path) -> None:
    data = log.read_bytes()
    found = set()
    for size in np.linspace(1, len(data) - 1, 40).astype(int):
        log.write_bytes(data[:size])
        try:
            with pytest.warns(LogWarning) if size < len(data) * 0.98 else open(os.devnull):
                found.add(len(list(read_steps(log))))
        except LogError:
            found.add(0)
        except pytest.fail.Exception:  # cut within the index: everything else is there
            found.add(12)
    assert found <= {0, 3, 6, 9, 12}
    assert {3, 6, 9, 12} <= found


def test_what_is_left_of_a_log_can_be_made_whole(log: Path, tmp_path: Path) -> None:
    steps = list(read_steps(log))
    with pytest.raises(LogError, match="nothing is missing"):
        recover(log, tmp_path / "b.mcap")
    log.write_bytes(log.read_bytes()[: LogFile(log).contents.chunks[3].offset])
    with pytest.warns(LogWarning):
        recover(log, tmp_path / "b.mcap")
    assert check_log(tmp_path / "b.mcap") == []
    saved = list(read_steps(tmp_path / "b.mcap"))
    assert len(saved) == 9
    np.testing.assert_array_equal(saved[8].bev, steps[8].bev)
    with pytest.warns(LogWarning), pytest.raises(LogError, match="there is such a file already"):
        recover(log, tmp_path / "b.mcap")


def test_a_turned_bit_is_found(log: Path) -> None:
    place = LogFile(log).contents.chunks[1]
    data = bytearray(log.read_bytes())
    data[place.offset + place.packed // 2] ^= 1
    log.write_bytes(data)
    with pytest.raises(LogError, match=r"a.mcap: the log is damaged \(chunk 2 of 4"):
        list(read_steps(log))
    assert "chunk 2 of 4" in check_log(log)[0]


def test_lengths_are_not_trusted(log: Path) -> None:
    whole = bytearray(log.read_bytes())
    for offset, value in ((9, 2**63), (9, 2**40)):
        data = bytearray(whole)
        struct.pack_into("<Q", data, offset, value)  # the header record claims to be huge
        log.write_bytes(data[:-40])
        with pytest.raises(LogError, match=r"0 whole chunks .* no frame is there"):
            list(read_steps(log))
    place = LogFile(write_log(log)).contents.chunks[0]
    data = bytearray(log.read_bytes())
    struct.pack_into("<Q", data, place.offset - 8 - 8 - 4 - 8, 2**50)  # and so does a chunk, once it is unpacked
    log.write_bytes(data)
    with pytest.raises(LogError, match="a chunk's length is wrong"):
        list(read_steps(log))


def test_empty_foreign_and_missing_files(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    path.write_bytes(b"")
    assert check_log(path) == [f"{path}: the log is empty: it has no byte"]
    path.write_bytes(b"RIFF" * 30)
    assert check_log(path) == [f"{path}: this is no MCAP file"]
    assert "No such file" in check_log(tmp_path / "b.mcap")[0]
    assert "this is a folder" in check_log(tmp_path)[0]
    write_foreign(path)
    assert "no topic /camera/NAME/image" in check_log(path)[0]
    with pytest.raises(LogError, match="has no topic"):
        read_episode(path)


def test_checks_find_what_does_not_fit(tmp_path: Path) -> None:
    for number, lens in enumerate((1.0, 1.0, 2.0)):
        write_log(tmp_path / f"{number}.mcap", lens=lens)
    faults = list(check_logs(sorted(tmp_path.glob("*.mcap"))).values())
    assert faults[:2] == [[], []]
    assert "calibrations are mixed: front: other intrinsics" in faults[2][0]
    data = bytearray((tmp_path / "0.mcap").read_bytes())
    start = struct.unpack_from("<Q", data, len(data) - 8 - 20)[0]
    data[start + 30] ^= 1  # in the summary's first schema
    (tmp_path / "0.mcap").write_bytes(data)
    assert any("checksum does not fit" in fault for fault in check_log(tmp_path / "0.mcap"))


def test_a_full_disk_is_a_mistake_with_a_name(
    line_plugins: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    written = 0

    def put(self: container.LogWriter, data: bytes, real: object = container.LogWriter._put) -> None:
        nonlocal written
        written += len(data)
        if written > 20_000:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        real(self, data)  # type: ignore[operator]

    monkeypatch.setattr(container.LogWriter, "_put", put)
    recorder = Recorder(WORLD, AUTOPILOT, 0, tmp_path)
    with pytest.raises(LogError, match=r"F1-low-00000.mcap: cannot be written: No space left on device"):
        collect(recorder, [Take("F1", "low", 0)], workers=0)
    assert not list(tmp_path.iterdir())
    (tmp_path / "file").write_text("")
    recorder.folder = tmp_path / "file"
    with pytest.raises(LogError, match="file: cannot be written: File exists"):
        collect(recorder, [Take("F1", "low", 0)], workers=0)


def test_two_collections_do_not_share_a_folder(line_plugins: None, tmp_path: Path) -> None:
    recorder = Recorder(WORLD, AUTOPILOT, 0, tmp_path)
    with folder_of_ours(tmp_path), pytest.raises(LogError, match="another collection is at work"):
        collect(recorder, [Take("F1", "low", 0)], workers=0)
    assert not list(tmp_path.iterdir())
    (tmp_path / LOCK).write_bytes(b"")  # of one that was killed
    assert collect(recorder, [Take("F1", "low", 0)], workers=0) == 1


KILLED = """
import sys, time, pytest
from pathlib import Path
from fakes import LineEnv, installed
from log_files import OBSERVATION
from me3bev_cli.evaluation.drivers import DriverSpec
from me3bev_cli.evaluation.runner import World
from me3bev_cli.recipe import PluginChoice
from me3bev_cli.recording import container
from me3bev_cli.recording.collect import Recorder, Take, collect
container.CHUNK_BYTES = 1
real = LineEnv.step
def step(self, action):
    if self.steps == 8 and self.seed_used == recorder.episode_seed(takes[1]):
        print("half way", flush=True)
        time.sleep(60)
    return real(self, action)
LineEnv.step = step
takes = [Take("F1", "low", i) for i in range(3)]
world = World(PluginChoice(name="line"), OBSERVATION)
recorder = Recorder(world, DriverSpec("autopilot", "autopilot"), 0, Path(sys.argv[1]))
with installed(pytest.MonkeyPatch()):
    collect(recorder, takes, 0)
"""


def test_a_killed_collection_goes_on_and_gets_the_same_bytes(
    line_plugins: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(container, "CHUNK_BYTES", 1)
    takes = [Take("F1", "low", index) for index in range(3)]
    collect(Recorder(WORLD, AUTOPILOT, 0, tmp_path / "calm"), takes, workers=0)
    folder = tmp_path / "killed"
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[1])}
    with subprocess.Popen([sys.executable, "-c", KILLED, folder], stdout=subprocess.PIPE, env=environment) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == b"half way\n"
        time.sleep(0.05)
        process.send_signal(signal.SIGKILL)
    assert sorted(path.name for path in folder.glob("*.mcap")) == ["F1-low-00000.mcap"]
    assert collect(Recorder(WORLD, AUTOPILOT, 0, folder), takes, workers=0) == 2
    assert sorted(path.name for path in folder.iterdir()) == [take.path(folder).name for take in takes]
    for take in takes:
        assert take.path(folder).read_bytes() == take.path(tmp_path / "calm").read_bytes()

"""Frames and sequences by number, from our logs and from others'."""

from __future__ import annotations

import pickle
from pathlib import Path

import numpy as np
import pytest
import torch
from log_files import OBSERVATION, write_foreign, write_log
from mcap.writer import CompressionType
from torch.utils.data import DataLoader

from me3bev_cli.errors import LogError
from me3bev_cli.recording import container
from me3bev_cli.recording.dataset import OPEN_FILES, LogDataset
from me3bev_cli.recording.frames import TRAINING_PARTS, FrameLog
from me3bev_cli.recording.logfile import CHUNKS_KEPT
from me3bev_cli.recording.mapping import TopicMapping, load_mapping
from me3bev_cli.recording.reader import read_steps

MAPPING = TopicMapping(cameras={"l": "/left", "r": "/right"})


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Three logs of 12 steps, in chunks of two or three."""
    monkeypatch.setattr(container, "CHUNK_BYTES", 100_000)
    for number in range(3):
        write_log(tmp_path / f"{number}.mcap", seed=number)
    return tmp_path


def test_frames_are_the_steps_in_order(folder: Path) -> None:
    dataset = LogDataset(folder)
    steps = [step for path in sorted(folder.glob("*.mcap")) for step in read_steps(path)]
    assert len(dataset) == len(steps) == 36
    assert dataset.parts == TRAINING_PARTS
    for item, step in zip([dataset[i] for i in range(36)], steps, strict=True):
        for name, value in step.observation.items():
            np.testing.assert_array_equal(item[name], value)
        np.testing.assert_array_equal(item["bev"], step.bev)
        np.testing.assert_array_equal(item["action"], step.action)
        assert item["speed"] == torch.tensor(step.record["speed"], dtype=torch.float32)
    np.testing.assert_array_equal(dataset[-1]["images"], steps[-1].observation["images"])
    with pytest.raises(IndexError):
        dataset[36]


def test_sequences_stay_within_an_episode(folder: Path) -> None:
    frames, dataset = LogDataset(folder), LogDataset(folder, length=5, stride=3)
    assert len(dataset) == 9
    assert [dataset.where(i) for i in range(9)] == [(log, first) for log in range(3) for first in (0, 3, 6)]
    item = dataset[4]  # from frame 3 of the second log
    assert item["images"].shape == (5, 2, 3, 16, 32)
    assert item["reward"].shape == (5,)
    for t in range(5):
        for part in dataset.parts:
            assert torch.equal(item[part][t], frames[12 + 3 + t][part])


def test_workers_read_the_same(folder: Path) -> None:
    dataset = LogDataset(folder, parts=("bev", "road"))
    _ = dataset[3]  # an open file is not handed on
    alone = list(DataLoader(dataset, batch_size=7))
    together = list(DataLoader(dataset, batch_size=7, num_workers=2))
    assert [list(batch) for batch in alone] == [["bev", "road"]] * 6
    for one, other in zip(alone, together, strict=True):
        assert all(torch.equal(one[part], other[part]) for part in one)
    copy = pickle.loads(pickle.dumps(dataset))  # noqa: S301 - our own bytes
    assert torch.equal(copy[30]["bev"], dataset[30]["bev"])


def test_little_is_held_in_memory(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("me3bev_cli.recording.dataset.OPEN_FILES", 2)
    assert OPEN_FILES > 2
    dataset = LogDataset(folder)
    for index in (0, 11, 14, 25, 3, 30):
        _ = dataset[index]
    opened = [log.file for log in dataset.logs if log.file._file is not None]
    assert len(opened) == 2
    assert all(0 < len(log.file._kept) <= CHUNKS_KEPT for log in dataset.logs if log.file in opened)
    assert not any(log.file._kept for log in dataset.logs if log.file not in opened)


def test_a_frame_reads_one_chunk_and_decodes_what_is_asked(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    log = FrameLog(folder / "0.mcap", ("bev", "action"))
    assert len(log.file.contents.chunks) >= 4
    read = []
    monkeypatch.setattr(log.file, "chunk", lambda number, real=log.file.chunk: read.append(number) or real(number))
    monkeypatch.setattr("cv2.imdecode", None)
    assert set(log.frame(7)) == {"bev", "action"}
    assert len(set(read)) == 1


@pytest.mark.parametrize(
    ("compression", "options"),
    [
        (CompressionType.LZ4, {}),
        (CompressionType.ZSTD, {"repeat_channels": False, "repeat_schemas": False}),
        (CompressionType.NONE, {"use_chunking": False}),
    ],
)
def test_logs_of_others_are_read_by_a_mapping(
    tmp_path: Path, compression: CompressionType, options: dict[str, bool]
) -> None:
    images = write_foreign(tmp_path / "a.mcap", late=0.01, compression=compression, **options)
    dataset = LogDataset(tmp_path, mapping=MAPPING)
    assert (len(dataset), dataset.parts) == (10, ("images",))
    np.testing.assert_array_equal(np.stack([dataset[i]["images"] for i in range(10)]), images)
    narrow = MAPPING.model_copy(update={"tolerance": 0.005})
    with pytest.raises(LogError, match="the log holds no whole frame of /left, /right"):
        LogDataset(tmp_path, mapping=narrow)


def test_a_frame_needs_all_its_cameras(tmp_path: Path) -> None:
    images = write_foreign(tmp_path / "a.mcap", late=0.5)  # the right camera begins a frame later
    dataset = LogDataset(tmp_path, mapping=MAPPING)
    assert len(dataset) == 9
    np.testing.assert_array_equal(dataset[0]["images"][0], images[1, 0])
    np.testing.assert_array_equal(dataset[0]["images"][1], images[0, 1])


def test_a_mapping_comes_from_yaml(tmp_path: Path) -> None:
    path = tmp_path / "topics.yaml"
    path.write_text("cameras: {l: /left, r: /right}\ntolerance: 0.05\n")
    assert load_mapping(path) == MAPPING
    for text, message in (
        ("cameras: {}", "cameras: dictionary should have at least 1 item"),
        ("cameras: {l: /left}\ncolour: /x", "colour: extra inputs are not permitted"),
        ("- 1", "a mapping of topics is made of keys"),
        ("a: [", "this is no YAML"),
    ):
        path.write_text(text)
        with pytest.raises(LogError, match=message):
            load_mapping(path)
    with pytest.raises(LogError, match=r"cannot be read: No such file"):
        load_mapping(tmp_path / "none.yaml")


def test_missing_and_wrong_topics_are_named(tmp_path: Path, folder: Path) -> None:
    foreign = tmp_path / "foreign"
    foreign.mkdir()
    write_foreign(foreign / "a.mcap")
    with pytest.raises(LogError, match=r"no topic /camera/NAME/image, needed for `images`. It has: /left, /right"):
        LogDataset(foreign)
    with pytest.raises(LogError, match=r"no topic /middle, needed for `images`"):
        LogDataset(foreign, mapping=TopicMapping(cameras={"l": "/left", "m": "/middle"}))
    with pytest.raises(LogError, match=r"the mapping names 0 of 1 topics for `bev`"):
        LogDataset(foreign, parts=("bev",), mapping=MAPPING)
    wrong = TopicMapping(cameras={"l": "/left"}, bev="/right")
    with pytest.raises(LogError, match=r"/right holds foxglove.CompressedImage.*cannot be read as `bev`"):
        LogDataset(foreign, mapping=wrong)
    with pytest.raises(LogError, match=r"an item has no part 'sound'"):
        LogDataset(folder, parts=("sound",))
    with pytest.raises(LogError, match=r"no log is as long as a sequence of 13 frames. The longest has 12"):
        LogDataset(folder, length=13)


def test_mixed_calibrations_are_refused(folder: Path) -> None:
    write_log(folder / "9.mcap", lens=1.1)
    with pytest.raises(LogError, match=r"9.mcap: calibrations are mixed: front: other intrinsics in .*0.mcap"):
        LogDataset(folder)
    write_log(folder / "9.mcap", observation=OBSERVATION.model_copy(update={"height": 20}))
    with pytest.raises(LogError, match="front: 32 x 20 pixels instead of 32 x 16"):
        LogDataset(folder)
    write_log(folder / "9.mcap", observation=OBSERVATION.model_copy(update={"cameras": ("front",)}))
    with pytest.raises(LogError, match="cameras front instead of front, back"):
        LogDataset(folder)

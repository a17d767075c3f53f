"""Frames of logs as PNG files or a video, and logs that were cut off as whole ones."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from mcap.opcode import Opcode
from numpy.typing import NDArray

from me3bev_cli.driving.video import check_target, video_file
from me3bev_cli.errors import LogError
from me3bev_cli.files import atomic_write_bytes
from me3bev_cli.pictures import colour_map, tile
from me3bev_cli.recording.container import LogWriter
from me3bev_cli.recording.frames import FrameLog
from me3bev_cli.recording.mapping import TopicMapping
from me3bev_cli.recording.records import MESSAGE_HEAD, walk
from me3bev_cli.recording.writer import OUTCOME, partial_path, unwritable

Picture = NDArray[np.uint8]


def open_for_export(path: Path, cameras: Sequence[str], mapping: TopicMapping | None) -> tuple[FrameLog, list[int]]:
    """A log with its images, and its map if it has one; and the numbers of the chosen cameras, all by default.

    Raises:
        LogError: it cannot be read, or has no such camera.
    """
    log = FrameLog(path, ("images",), mapping)
    topics = log.mapping.topics_of("bev")
    if topics and topics[0] in log.file.channels:
        log = FrameLog(path, ("images", "bev"), mapping)
    for name in cameras:
        if name not in log.cameras:
            raise LogError(f"there is no camera '{name}'", where=str(path), allowed=", ".join(log.cameras))
    return log, [log.cameras.index(name) for name in cameras or log.cameras]


def export_pictures(
    paths: Sequence[Path], out: Path, cameras: Sequence[str] = (), every: int = 1, mapping: TopicMapping | None = None
) -> int:
    """Every `every`-th frame of each log as OUT/LOG/NUMBER-CAMERA.png and NUMBER-bev.png; how many files.

    Raises:
        LogError: as `open_for_export`.
        UserError: the system does not let us write.
    """
    written = 0
    for path in paths:
        log, chosen = open_for_export(path, cameras, mapping)
        for number in range(0, len(log), every):
            frame = log.frame(number)
            pictures = {log.cameras[i]: frame["images"][i].transpose(1, 2, 0) for i in chosen}
            if "bev" in frame:
                pictures["bev"] = colour_map(frame["bev"])
            for name, picture in pictures.items():
                atomic_write_bytes(out / path.stem / f"{number:05d}-{name}.png", _png(picture))
            written += len(pictures)
        log.close()
    return written


def _png(picture: Picture) -> bytes:
    data: bytes = cv2.imencode(".png", np.ascontiguousarray(picture[:, :, ::-1]))[1].tobytes()
    return data


def export_video(
    paths: Sequence[Path], out: Path, cameras: Sequence[str] = (), every: int = 1, mapping: TopicMapping | None = None
) -> int:
    """The logs one after another as a video of their cameras, the map beside them; how many frames.

    Raises:
        LogError: as `open_for_export`, or a log has images of another size than the first.
        UserError: the system does not let us write, or there is no such kind of video.
    """
    logs = [open_for_export(path, cameras, mapping) for path in paths]
    total = sum(-(-len(log) // every) for log, _ in logs)
    check_target(out, total)
    first = sheet(logs[0][0].frame(0), logs[0][1])
    with video_file(out, first.shape[1], first.shape[0]) as video:
        for log, chosen in logs:
            for number in range(0, len(log), every):
                picture = sheet(log.frame(number), chosen)
                if picture.shape != first.shape:
                    raise LogError("the log has images of another size than the first one", where=str(log.path))
                video.add(picture)
            log.close()
    return total


def sheet(frame: dict[str, Any], cameras: Sequence[int]) -> Picture:
    """The cameras' images in rows of three, the map at their right; sides of even length, as videos need."""
    picture = tile(frame["images"][list(cameras)])
    if "bev" in frame:
        height = picture.shape[0]
        drawn = cv2.resize(colour_map(frame["bev"]), (height, height), interpolation=cv2.INTER_NEAREST)
        picture = np.concatenate([picture, drawn], axis=1)
    return np.ascontiguousarray(picture[: picture.shape[0] // 2 * 2, : picture.shape[1] // 2 * 2])


def recover(path: Path, out: Path) -> int:
    """Write what can be read of a log that was cut off as a whole log; how many messages.

    Raises:
        LogError: nothing of it can be read, it is whole, or the system does not let us write.
    """
    log = FrameLog(path, ("images",))
    if log.file.indexed:
        raise LogError("nothing is missing", where=str(path))
    if out.exists():
        raise LogError("there is such a file already", where=str(out))
    temporary = partial_path(out)
    try:
        with open(temporary, "wb") as file:
            count = _copy(log, LogWriter(file))
        os.replace(temporary, out)
    except OSError as error:
        raise unwritable(out, error) from error
    finally:
        temporary.unlink(missing_ok=True)
    return count


def _copy(log: FrameLog, writer: LogWriter) -> int:
    contents = log.file.contents
    for name, values in log.file.metadata.items():
        writer.metadata(name, values)
    schemas = {i: writer.schema(s.name, s.encoding, s.data) for i, s in contents.schemas.items()}
    channels = {}
    for i, c in contents.channels.items():
        channels[i] = writer.channel(c.topic, c.message_encoding, schemas.get(c.schema_id, 0))
    count = 0
    for number in range(len(contents.chunks)):
        data = log.file.chunk(number)
        for opcode, place, length in walk(data):
            if opcode == Opcode.MESSAGE:
                channel, _, time, _ = MESSAGE_HEAD.unpack_from(data, place)
                writer.message(channels[channel], time, data[place + MESSAGE_HEAD.size : place + length])
                count += 1
        writer.end_chunk()
    writer.metadata(OUTCOME, {"steps": str(len(log)), "ended": "stopped", "recovered": "yes"})
    writer.finish()
    return count

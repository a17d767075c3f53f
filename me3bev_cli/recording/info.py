"""What is in logs: episodes, steps, maps, size, what happened."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from me3bev_cli.errors import LogError
from me3bev_cli.recording.frames import FrameLog
from me3bev_cli.recording.mapping import TopicMapping
from me3bev_cli.recording.reader import RECORD, record_of
from me3bev_cli.recording.writer import OUTCOME

EVENTS = ("red_light", "stop_sign", "lane_departure")
"""Infractions that happen in one step."""


@dataclass(frozen=True)
class LogInfo:
    """One log."""

    file: str
    map: str
    density: str
    weather: str
    driver: str
    steps: int
    seconds: float
    bytes: int
    images: str
    ended: str
    """Why it ended; `cut off` where the file is."""
    collisions: int | None
    red_light: int | None
    stop_sign: int | None
    lane_departure: int | None
    off_road_steps: int | None
    """None in logs that do not say."""


def log_info(path: Path, mapping: TopicMapping | None = None) -> LogInfo:
    """What is in a log, without decoding an image.

    Raises:
        LogError: it is damaged, or lacks the cameras' topics.
    """
    frames = FrameLog(path, ("images",), mapping)
    told: dict[str, Any] = {}
    records = [topic for part in RECORD for topic in frames.mapping.topics_of(part)]
    if mapping is None and all(topic in frames.file.channels for topic in records):
        told = _events(FrameLog(path, RECORD))
    about = frames.metadata
    outcome = frames.file.metadata.get(OUTCOME, {})
    first, last = int(frames.times[0]), int(frames.times[-1])
    info = LogInfo(
        file=path.name,
        map=about.get("map", ""),
        density=about.get("density", ""),
        weather=about.get("weather", ""),
        driver=about.get("driver", ""),
        steps=len(frames),
        seconds=(last - first) / 1e9,
        bytes=frames.file.size,
        images=f"{len(frames.cameras)} {about.get('images', '')}".strip(),
        ended="cut off" if frames.note else outcome.get("ended", ""),
        **{name: told.get(name) for name in ("collisions", *EVENTS, "off_road_steps")},
    )
    frames.close()
    return info


def _events(log: FrameLog) -> dict[str, int]:
    records = [record_of(log.frame(number)) for number in range(len(log))]
    log.close()
    return {
        "collisions": sum(bool(record["collision"]) for record in records),
        **{name: sum(bool(record[name]) for record in records) for name in EVENTS},
        "off_road_steps": sum(bool(record["off_road"]) for record in records),
    }


@dataclass(frozen=True)
class Total:
    """The logs of one map, density and weather together."""

    map: str
    density: str
    weather: str
    episodes: int
    steps: int
    bytes: int
    collisions: int
    red_light: int
    stop_sign: int
    lane_departure: int
    off_road_steps: int


def totals(infos: Sequence[LogInfo]) -> list[Total]:
    """One row for each map, density and weather, in order."""
    cells = sorted({(info.map, info.density, info.weather) for info in infos})
    counted = ("steps", "bytes", "collisions", *EVENTS, "off_road_steps")
    rows = []
    for place, density, weather in cells:
        some = [vars(info) for info in infos if (info.map, info.density, info.weather) == (place, density, weather)]
        counts = {key: sum(one[key] or 0 for one in some) for key in counted}
        rows.append(Total(map=place, density=density, weather=weather, episodes=len(some), **counts))
    return rows


def folder_info(
    paths: Sequence[Path], mapping: TopicMapping | None = None
) -> tuple[list[LogInfo], list[tuple[Path, LogError]]]:
    """What is in logs, and those that cannot be read."""
    infos, bad = [], []
    for path in paths:
        try:
            infos.append(log_info(path, mapping))
        except LogError as error:
            bad.append((path, error))
    return infos, bad

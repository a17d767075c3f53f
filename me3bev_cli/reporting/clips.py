"""Clips of failures: the last seconds before each, with what the cameras see, the plan and the bird's-eye view."""

from __future__ import annotations

import io
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from me3bev_cli.driving import canvas
from me3bev_cli.driving.canvas import DIM, NIGHT, RED, TEXT, Box, Picture
from me3bev_cli.driving.frame import bev_picture, events_of
from me3bev_cli.driving.video import video_file
from me3bev_cli.errors import UserError
from me3bev_cli.evaluation.runner import World
from me3bev_cli.files import atomic_write_bytes
from me3bev_cli.pictures import CAMERA_COLUMNS
from me3bev_cli.reporting.failures import KINDS, Failure
from me3bev_cli.reporting.replay import Instant, replay

BEFORE, AFTER = 40, 8
"""Steps shown before and after the event: four seconds and nearly one."""
HOLD = 8
"""Frames for which the last one stands."""
WIDTH = 640
_HEADER = 30
_GAP = 4
_SIDE = (WIDTH - _GAP) // 2
KMH = 3.6
SMALL = {"crf": "44", "deadline": "good", "cpu-used": "4"}
"""A page has many clips: a quarter of a megabyte is enough for each."""


@dataclass(frozen=True)
class Clip:
    """A clip that was made, or the reason why it was not."""

    failure: Failure
    method: str
    """The label in the report."""
    video: str | None = None
    poster: str | None = None
    """Names in the report's folder."""
    width: int = 0
    height: int = 0
    reason: str = ""


@dataclass(frozen=True)
class Wanted:
    """A failure, the world it happened in, and the label of who drove."""

    failure: Failure
    world: World
    method: str


@dataclass
class Gallery:
    """The clips by kind of failure."""

    clips: list[Clip] = field(default_factory=list)

    def of(self, kind: str) -> list[Clip]:
        """Those of one kind."""
        return [clip for clip in self.clips if clip.failure.kind == kind]


def make_clips(wanted: Sequence[Wanted], folder: Path, base: Path, told: Callable[[int], None]) -> Gallery:
    """Film every failure that is wanted; one that cannot be filmed is kept with the reason.

    Args:
        folder: where the clips go.
        base: the report's folder, that names are relative to.
        told: called with the number of clips that are done.
    """
    gallery = Gallery()
    for number, one in enumerate(wanted):
        episode = one.failure.episode
        stem = f"{one.failure.kind}-{number + 1:02d}-{episode.map}-{episode.density}-{episode.index:05d}"
        try:
            gallery.clips.append(_film(one, folder / stem, base))
        except UserError as error:
            gallery.clips.append(Clip(one.failure, one.method, reason=str(error)))
        told(number + 1)
    return gallery


def _film(wanted: Wanted, stem: Path, base: Path) -> Clip:
    failure = wanted.failure
    first = max(0, failure.step - BEFORE)
    last = min(len(failure.episode) - 1, failure.step + AFTER)
    cameras = wanted.world.observation.cameras
    height = _height(len(cameras))
    video, poster = stem.with_name(f"{stem.name}.webm"), stem.with_name(f"{stem.name}.webp")
    with video_file(video, WIDTH, height, SMALL) as film:
        for instant in replay(wanted.world, failure.episode, first, last, _SIDE):
            picture = compose(instant, failure, cameras)
            film.add(picture)
            if instant.step == failure.step:
                atomic_write_bytes(poster, _webp(picture))
        film.add(picture, HOLD)
    names = [path.relative_to(base).as_posix() for path in (video, poster)]
    return Clip(failure, wanted.method, names[0], names[1], WIDTH, height)


def _grid(count: int) -> tuple[int, int, int]:
    """(columns, width, height) of camera pictures."""
    columns = min(CAMERA_COLUMNS, count)
    width = (WIDTH - (columns - 1) * _GAP) // columns
    return columns, width, min(220, round(width * 128 / 352))


def _height(count: int) -> int:
    columns, _, height = _grid(count)
    rows = -(-count // columns)
    total = _HEADER + rows * (height + _GAP) + _SIDE
    return total + total % 2


def compose(instant: Instant, failure: Failure, cameras: Sequence[str]) -> Picture:
    """One frame: a line of words, the cameras, the plan and the semantic map."""
    height = _height(len(cameras))
    picture = np.full((height, WIDTH, 3), NIGHT, np.uint8)
    record = instant.record
    left = round(float(failure.episode["time"][failure.step]) - record["time"], 3)
    when = "now" if left == 0 else f"in {left:.1f} s" if left > 0 else f"{-left:.1f} s ago"
    canvas.write(picture, (8, _HEADER / 2), f"{failure.episode.map}  {record['time']:.1f} s", 15, TEXT, anchor="lm")
    canvas.write(
        picture, (WIDTH / 2, _HEADER / 2), f"{KMH * record['speed']:.0f} km/h", 15, TEXT, bold=True, anchor="mm"
    )
    canvas.write(picture, (WIDTH - 8, _HEADER / 2), when, 15, RED if left <= 0 else DIM, bold=left <= 0, anchor="rm")
    columns, width, tall = _grid(len(cameras))
    for index, (image, name) in enumerate(zip(instant.images, cameras, strict=True)):
        x, y = (index % columns) * (width + _GAP), _HEADER + (index // columns) * (tall + _GAP)
        there = picture[y : y + tall, x : x + width]
        there[:] = cv2.resize(
            np.ascontiguousarray(image.transpose(1, 2, 0)), (width, tall), interpolation=cv2.INTER_AREA
        )
        canvas.label(there, (0, 0), name.replace("_", " "), 10)
    top = height - _SIDE
    for x, part, name in ((0, instant.plan, "plan"), (_SIDE + _GAP, _bev(instant), "semantic BEV, truth")):
        Box(x, top, _SIDE, _SIDE).cut(picture)[:] = part
        canvas.label(picture, (x, top), name, 11)
    happened = events_of(record)
    if not happened and instant.step >= failure.step:
        happened = [KINDS[failure.kind].lower()]
    if happened:
        canvas.pill(picture, (WIDTH / 2, top - 22), "  ·  ".join(happened), 16, RED)
    return picture


def _bev(instant: Instant) -> Picture:
    return np.asarray(cv2.resize(bev_picture(instant.bev), (_SIDE, _SIDE), interpolation=cv2.INTER_AREA), np.uint8)


def _webp(picture: Picture) -> bytes:
    from PIL import Image

    buffer = io.BytesIO()
    image: Any = Image.fromarray(picture)
    image.save(buffer, "WEBP", quality=70, method=4)
    return buffer.getvalue()

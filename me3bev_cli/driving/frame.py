"""One frame of a drive: what the cameras see, the plan, the semantic truth and the instruments."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from me3bev_cli.api import StepRecord
from me3bev_cli.driving import canvas
from me3bev_cli.driving.canvas import BLUE, DIM, GREEN, NIGHT, RED, TEXT, Box, Colour, Picture
from me3bev_cli.driving.dashboard import Dashboard
from me3bev_cli.evaluation.episode import Ending
from me3bev_cli.pictures import CAMERA_COLUMNS, colour_map

WIDTH, HEIGHT = 1600, 900
PLAN = 446
"""Side of the plan view and of the semantic map, pixels."""
ENDINGS: dict[Ending, Colour] = {"finished": GREEN, "collision": RED}
"""Colours of outcomes."""
FLASH = 1.0
"""Seconds for which an event is shown."""

_MARGIN, _GAP = 10, 6
_HEADER = Box(_MARGIN, 0, WIDTH - 2 * _MARGIN, 48)
_CAMERAS = Box(_MARGIN, 48, WIDTH - 2 * _MARGIN, 386)
_LOWER = _CAMERAS.y + _CAMERAS.height + _MARGIN
_PLAN = Box(_MARGIN, _LOWER, PLAN, PLAN)
_BEV = Box(2 * _MARGIN + PLAN, _LOWER, PLAN, PLAN)
_INSTRUMENTS = Box(3 * _MARGIN + 2 * PLAN, _LOWER, WIDTH - 4 * _MARGIN - 2 * PLAN, PLAN)


@dataclass(frozen=True)
class Caption:
    """What is said of an episode."""

    map: str
    density: str
    weather: str
    driver: str
    seed: int
    number: int
    """Of the episode, from 1."""
    episodes: int

    @property
    def words(self) -> tuple[str, ...]:
        """For the header, the place first."""
        which = f"episode {self.number} of {self.episodes}" if self.episodes > 1 else ""
        words = (f"{self.density} density", self.weather.replace("_", " "), self.driver, f"seed {self.seed}", which)
        return (self.map, *(word for word in words if word))


@dataclass(frozen=True, eq=False)
class View:
    """One instant as it is shown."""

    images: NDArray[np.uint8]
    """(C, 3, H, W)."""
    bev: NDArray[np.uint8]
    """(X, Y), classes as `api.BEV_CLASSES`."""
    plan: Picture
    """(`PLAN`, `PLAN`, 3)."""
    record: StepRecord
    light: str
    """Of `api.LIGHT_STATES`."""


class Frames:
    """Composes the frames (`HEIGHT`, `WIDTH`, 3) of one episode after another.

    Args:
        cameras: their names, in the order of the images.
    """

    def __init__(self, cameras: Sequence[str]) -> None:
        self.cameras = [name.replace("_", " ") for name in cameras]
        self.dashboard = Dashboard(_INSTRUMENTS.width, _INSTRUMENTS.height)

    def begin(self, caption: Caption) -> None:
        """A new episode."""
        self.caption = caption
        self.dashboard.begin()
        self.events: list[tuple[float, str]] = []
        self.before: list[str] = []

    def card(self) -> Picture:
        """A title for the episode."""
        picture = np.full((HEIGHT, WIDTH, 3), NIGHT, np.uint8)
        place, *words = self.caption.words
        canvas.write(picture, (WIDTH / 2, HEIGHT / 2 - 30), place, 96, TEXT, bold=True, anchor="mm")
        canvas.write(picture, (WIDTH / 2, HEIGHT / 2 + 66), "  ·  ".join(words), 26, DIM, anchor="mm")
        return picture

    def step(self, view: View) -> Picture:
        """The frame after a step."""
        happened = events_of(view.record)
        now = view.record["time"]
        begun = bool(set(happened) - set(self.before))
        self.before = happened
        self.events += [(now, text) for text in happened]
        picture = np.full((HEIGHT, WIDTH, 3), NIGHT, np.uint8)
        self._header(_HEADER.cut(picture), now)
        self._images(_CAMERAS.cut(picture), view.images)
        _PLAN.cut(picture)[:] = view.plan
        _BEV.cut(picture)[:] = bev_picture(view.bev)
        _INSTRUMENTS.cut(picture)[:] = self.dashboard.draw(view.record, view.light, begun)
        canvas.label(picture, (_PLAN.x, _PLAN.y), "plan")
        canvas.label(picture, (_BEV.x, _BEV.y), "semantic BEV, truth")
        shown = list(dict.fromkeys(text for time, text in self.events if now - time < FLASH - 1e-6))
        if shown:
            at = _CAMERAS.x + _CAMERAS.width / 2, _CAMERAS.y + _CAMERAS.height - 36
            canvas.pill(picture, at, "  ·  ".join(shown), 24, RED)
        return picture

    def end(self, last: Picture, ended: Ending, text: str) -> Picture:
        """The last frame of an episode with its outcome."""
        picture = last.copy()
        at = _CAMERAS.x + _CAMERAS.width / 2, _CAMERAS.y + _CAMERAS.height / 2
        canvas.pill(picture, at, text, 40, ENDINGS.get(ended, BLUE))
        return picture

    def _header(self, picture: Picture, time: float) -> None:
        place, *words = self.caption.words
        width = canvas.write(picture, (2, 25), place, 28, TEXT, bold=True, anchor="lm")
        canvas.write(picture, (width + 24, 26), "  ·  ".join(words), 18, DIM, anchor="lm")
        canvas.write(picture, (_HEADER.width - 2, 25), f"{time:.1f} s", 26, TEXT, bold=True, anchor="rm")

    def _images(self, picture: Picture, images: NDArray[np.uint8]) -> None:
        """The cameras in rows of three, as large as fits."""
        count, _, height, width = images.shape
        columns = min(CAMERA_COLUMNS, count)
        rows = -(-count // columns)
        room = (_CAMERAS.width - (columns - 1) * _GAP) / columns, (_CAMERAS.height - (rows - 1) * _GAP) / rows
        scale = min(room[0] / width, room[1] / height)
        w, h = int(width * scale), int(height * scale)
        x0 = (_CAMERAS.width - columns * w - (columns - 1) * _GAP) // 2
        y0 = (_CAMERAS.height - rows * h - (rows - 1) * _GAP) // 2
        way = cv2.INTER_CUBIC if scale > 1 else cv2.INTER_AREA
        for index, (image, name) in enumerate(zip(images, self.cameras, strict=True)):
            x, y = x0 + (index % columns) * (w + _GAP), y0 + (index // columns) * (h + _GAP)
            there = picture[y : y + h, x : x + w]
            there[:] = cv2.resize(np.ascontiguousarray(image.transpose(1, 2, 0)), (w, h), interpolation=way)
            canvas.label(there, (0, 0), name)


def events_of(record: StepRecord) -> list[str]:
    """What should be seen of a step, for people."""
    events = []
    if record["collision"]:
        fault = ", at fault" if record["at_fault"] else ""
        events.append(f"collision: {record['collision']}{fault}")
    if record["red_light"]:
        events.append("ran a red light")
    if record["stop_sign"]:
        events.append("ran a stop sign")
    if record["off_road"]:
        events.append("off the road")
    elif record["lane_departure"]:
        events.append("left its lane")
    return events


def bev_picture(classes: NDArray[np.uint8]) -> Picture:
    """The semantic map (X, Y) in colour with the ego in its middle, (`PLAN`, `PLAN`, 3)."""
    # Whole multiples first: cells keep their edges and their size.
    multiple = max(1, -(-PLAN // min(classes.shape)))
    large = np.repeat(np.repeat(colour_map(classes), multiple, 0), multiple, 1)
    picture = np.array(cv2.resize(large, (PLAN, PLAN), interpolation=cv2.INTER_AREA), np.uint8)
    half = PLAN / 2
    arrow = half + np.array([(0.0, -11.0), (7.0, 9.0), (0.0, 5.0), (-7.0, 9.0)])
    canvas.polygon(picture, half + 1.35 * (arrow - half), (16, 18, 22))
    canvas.polygon(picture, arrow, (255, 255, 255))
    return picture

"""The instruments of a frame: speed and limit, light, pedals, the drive so far, what the colours mean."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from me3bev_cli.api import BEV_CLASSES, StepRecord
from me3bev_cli.driving import canvas
from me3bev_cli.driving.canvas import AMBER, BLUE, DIM, GREEN, GROOVE, PANEL, RED, TEXT, Picture
from me3bev_cli.pictures import BEV_COLOURS

KMH = 3.6
SPAN = 12.8
"""Seconds that the chart shows at least."""
LAMPS = {"red": RED, "amber": AMBER, "green": GREEN}
"""From the top."""

_LEFT, _RIGHT = 24, 24
_BARS, _CHART, _ROUTE, _LEGEND = 142, 216, 340, 372
"""Where each row begins, pixels from the top; laid out for 446 in height."""


class Moment(NamedTuple):
    """What the chart keeps of a step."""

    time: float
    speed: float
    limit: float
    event: bool


class Dashboard:
    """Draws the instruments; remembers the episode for its chart.

    Args:
        width, height: pixels.
    """

    def __init__(self, width: int, height: int) -> None:
        self.width = width
        self.blank = np.full((height, width, 3), PANEL, np.uint8)
        self._still(self.blank)
        self.begin()

    def begin(self) -> None:
        """A new episode."""
        self.moments: list[Moment] = []
        self.total = 0.0

    def draw(self, record: StepRecord, light: str, event: bool) -> Picture:
        """The instruments after one more step.

        Args:
            light: of `api.LIGHT_STATES`.
            event: whether to mark this step in the chart.
        """
        self.moments.append(Moment(record["time"], KMH * record["speed"], KMH * record["speed_limit"], event))
        self.total += record["reward"]
        picture = self.blank.copy()
        self._speed(picture, record)
        _lamps(picture, (330.0, 66.0), light)
        self._reward(picture, record["reward"])
        self._pedals(picture, record)
        self._chart(picture)
        self._route(picture, record)
        return picture

    def _still(self, picture: Picture) -> None:
        """What is the same in every frame."""
        names = ("steering", "brake / throttle")
        for row, name in enumerate(names):
            canvas.write(picture, (_LEFT, _BARS + 30 * row + 8), name, 14, DIM, anchor="lm")
        canvas.write(picture, (_LEFT, _CHART), "speed and limit, km/h", 13, DIM, anchor="la")
        canvas.write(picture, (_LEFT, _ROUTE + 6), "route", 14, DIM, anchor="lm")
        columns = 4
        step = (self.width - _LEFT - _RIGHT) / columns
        for index, name in enumerate(BEV_CLASSES):
            x, y = _LEFT + step * (index % columns), _LEGEND + 30 * (index // columns)
            red, green, blue = (int(c) for c in BEV_COLOURS[index])
            canvas.bar(picture, (x, y, 20, 20), (red, green, blue), 4)
            canvas.write(picture, (x + 28, y + 10), name.replace("_", " "), 14, TEXT, anchor="lm")

    def _speed(self, picture: Picture, record: StepRecord) -> None:
        speed, limit = KMH * record["speed"], KMH * record["speed_limit"]
        colour = RED if speed > 1.1 * limit + 1 else TEXT
        canvas.write(picture, (138, 100), f"{speed:.0f}", 80, colour, bold=True, anchor="rs")
        canvas.write(picture, (146, 100), "km/h", 18, DIM)
        for radius, ring in ((44.0, RED), (35.0, (245, 245, 245))):
            canvas.disc(picture, (252, 68), radius, ring)
        text = f"{limit:.0f}"
        size = 34 if len(text) < 3 else 26
        canvas.write(picture, (252, 69), text, size, (20, 22, 26), bold=True, anchor="mm")

    def _reward(self, picture: Picture, reward: float) -> None:
        x = self.width - _RIGHT
        canvas.write(picture, (x, 38), "reward", 14, DIM, anchor="rs")
        colour = TEXT if reward >= 0 else RED
        canvas.write(picture, (x, 82), f"{reward:,.2f}", 38, colour, bold=True, anchor="rs")
        canvas.write(picture, (x, 108), f"so far {self.total:,.1f}", 14, DIM, anchor="rs")

    def _pedals(self, picture: Picture, record: StepRecord) -> None:
        # Positive steering turns left.
        pedal = record["longitudinal"]
        rows = ((-record["steering"], BLUE), (pedal, GREEN if pedal >= 0 else RED))
        left = 170.0
        half = (self.width - _RIGHT - left) / 2
        for row, (value, colour) in enumerate(rows):
            y = _BARS + 30.0 * row
            canvas.bar(picture, (left, y, 2 * half, 16), GROOVE, 8)
            reach = half * min(1.0, abs(value))
            if reach >= 1:
                canvas.bar(picture, (left + half - (reach if value < 0 else 0), y, reach, 16), colour, 3)
            canvas.bar(picture, (left + half - 1, y - 3, 2, 22), DIM, 0)

    def _chart(self, picture: Picture) -> None:
        x0, y0, width, height = 56.0, _CHART + 24.0, self.width - 56.0 - _RIGHT, 84.0
        top = 10 * math.ceil(max(10.0, *(1.1 * max(m.speed, m.limit) for m in self.moments)) / 10)
        for value in (0, top // 2, top):
            y = y0 + height * (1 - value / top)
            canvas.bar(picture, (x0, y, width, 1), GROOVE, 0)
            canvas.write(picture, (x0 - 8, y), f"{value}", 12, DIM, anchor="rm")
        table = np.array(self.moments, np.float64)
        x = x0 + width * table[:, 0] / max(SPAN, table[-1, 0])
        for column, colour, thickness in ((2, DIM, 1), (1, BLUE, 2)):
            y_line = y0 + height * (1 - table[:, column] / top)
            canvas.line(picture, np.stack([x, y_line], 1), colour, thickness)
        for at in x[table[:, 3] > 0]:
            canvas.bar(picture, (at - 1, y0, 2, height), RED, 0)
        canvas.disc(picture, (x[-1], y0 + height * (1 - table[-1, 1] / top)), 4, TEXT)

    def _route(self, picture: Picture, record: StepRecord) -> None:
        done, length = record["route_done"], record["route_length"]
        share = min(1.0, max(0.0, done / length)) if length > 0 else 0.0
        left, right = 80.0, self.width - _RIGHT - 110.0
        canvas.bar(picture, (left, _ROUTE, right - left, 12), GROOVE, 6)
        if share > 0:
            canvas.bar(picture, (left, _ROUTE, max(12.0, share * (right - left)), 12), BLUE, 6)
        text = f"{max(0.0, done):.0f} of {length:.0f} m"
        canvas.write(picture, (self.width - _RIGHT, _ROUTE + 6), text, 14, TEXT, anchor="rm")


def _lamps(picture: Picture, at: tuple[float, float], light: str) -> None:
    """A traffic light that shows the state; all lamps are dark for `none` and `off`."""
    x, y = at
    canvas.bar(picture, (x - 20, y - 50, 40, 102), (12, 13, 16), 10)
    for index, (name, colour) in enumerate(LAMPS.items()):
        canvas.disc(picture, (x, y - 31 + 32 * index), 12, colour if name == light else GROOVE)

"""A small chart as inline SVG: axes, lines, bars, whiskers. Colours are the page's own, so they follow its theme.

Every chart has the same size in units, so that its letters are as large on a phone as on a desk.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

from markupsafe import Markup, escape

WIDTH, HEIGHT = 380, 250
"""Units; about as many CSS pixels."""
LEFT, RIGHT, TOP, BOTTOM = 46, 10, 12, 40
UNTITLED = 24
"""The room below an axis that has no title."""
SERIES = 12
"""Colours that the page has for series."""

Point = tuple[float, float]


def tick_values(low: float, high: float, most: int = 5) -> list[float]:
    """Round numbers from `low` to `high`, at most `most` + 1 of them."""
    if not high > low:
        return [low]
    rough = (high - low) / most
    power = 10.0 ** math.floor(math.log10(rough))
    step = next(m * power for m in (1, 2, 2.5, 5, 10) if m * power >= rough * (1 - 1e-9))
    first = math.ceil(low / step - 1e-9)
    return [n * step for n in range(first, math.floor(high / step + 1e-9) + 1)]


def number_text(value: float) -> str:
    """A tick's label: `20k` for 20,000."""
    for size, letter in ((1e9, "G"), (1e6, "M"), (1e3, "k")):
        if abs(value) >= size:
            return f"{value / size:g}{letter}"
    return f"{round(value, 10):g}"


def colour(series: int) -> str:
    """The class that gives a series its colour; beyond the page's colours they come again, paler."""
    return f"s{series % SERIES}" + (" again" if series >= SERIES else "")


@dataclass
class Chart:
    """A chart in the making; numbers are in the units of its axes.

    Args:
        x, y: ends of the axes.
        label: what a screen reader says of it.
        bottom: room below the axis.
    """

    x: Point
    y: Point
    label: str
    bottom: int = BOTTOM
    parts: list[Markup] = field(default_factory=list)

    @property
    def height(self) -> int:
        """Of the whole."""
        return HEIGHT - BOTTOM + self.bottom

    def at(self, x: float, y: float) -> Point:
        """Where a point is drawn."""
        across = (x - self.x[0]) / (self.x[1] - self.x[0])
        up = (y - self.y[0]) / (self.y[1] - self.y[0])
        return LEFT + across * (WIDTH - LEFT - RIGHT), HEIGHT - BOTTOM - up * (HEIGHT - TOP - BOTTOM)

    def axes(self, x_title: str = "", y_title: str = "", *, x_ticks: bool = True) -> None:
        """Grid and numbers."""
        for value in tick_values(*self.y):
            _, y = self.at(self.x[0], value)
            self._add('<line class="grid" x1="{}" x2="{}" y1="{:.1f}" y2="{:.1f}"/>', LEFT, WIDTH - RIGHT, y, y)
            self._text(LEFT - 6, y + 4, number_text(value), "end")
        bottom = HEIGHT - BOTTOM
        for value in tick_values(*self.x) if x_ticks else ():
            x, _ = self.at(value, self.y[0])
            self._add('<line class="axis" x1="{:.1f}" x2="{:.1f}" y1="{}" y2="{}"/>', x, x, bottom, bottom + 4)
            self._text(x, bottom + 16, number_text(value), "middle")
        self._add('<line class="axis" x1="{}" x2="{}" y1="{}" y2="{}"/>', LEFT, WIDTH - RIGHT, bottom, bottom)
        if x_title:
            self._text((LEFT + WIDTH - RIGHT) / 2, HEIGHT - 6, x_title, "middle")
        if y_title:
            where = f"rotate(-90) translate({-(TOP + bottom) / 2:.0f} 11)"
            self._add('<text transform="{}" text-anchor="middle">{}</text>', where, y_title)

    def bar(self, left: float, right: float, value: float, series: int, title: str) -> None:
        """A bar from 0, or from the axis' lower end where that is above 0."""
        x0, y0 = self.at(left, min(max(0.0, self.y[0]), self.y[1]))
        x1, y1 = self.at(right, value)
        self._add(
            '<rect class="fill {}" x="{:.1f}" y="{:.1f}" width="{:.1f}" height="{:.1f}"><title>{}</title></rect>',
            colour(series), x0, min(y0, y1), x1 - x0, max(0.8, abs(y1 - y0)), title,
        )  # fmt: skip

    def whisker(self, x: float, low: float, high: float, *, caps: bool = True) -> None:
        """An interval, upright."""
        (x0, y0), (_, y1) = self.at(x, low), self.at(x, high)
        ends = f"M{x0 - 2:.1f} {y0:.1f}h4M{x0 - 2:.1f} {y1:.1f}h4" if caps else ""
        self._add('<path class="whisker" d="M{:.1f} {:.1f}V{:.1f}{}"/>', x0, y0, y1, ends)

    def whisker_across(self, y: float, low: float, high: float) -> None:
        """An interval, level."""
        (x0, y0), (x1, _) = self.at(low, y), self.at(high, y)
        self._add('<path class="whisker" d="M{:.1f} {:.1f}H{:.1f}"/>', x0, y0, x1)

    def line(self, points: Sequence[Point], kind: str) -> None:
        """A line through points, of the classes `kind`."""
        words = " ".join(f"{x:.1f},{y:.1f}" for x, y in (self.at(*point) for point in points))
        self._add('<polyline class="{}" points="{}"/>', kind, words)

    def band(self, x: Sequence[float], low: Sequence[float], high: Sequence[float], series: int) -> None:
        """What lies between two lines."""
        upper = [self.at(a, b) for a, b in zip(x, high, strict=True)]
        lower = [self.at(a, b) for a, b in zip(x, low, strict=True)]
        words = " ".join(f"{a:.1f},{b:.1f}" for a, b in (*upper, *reversed(lower)))
        self._add('<polygon class="band {}" points="{}"/>', colour(series), words)

    def dot(self, x: float, y: float, series: int, title: str, *, hollow: bool = False) -> None:
        """A point; another shape for each lap of colours."""
        a, b = self.at(x, y)
        kind = f"dot {'hollow' if hollow else 'fill'} {colour(series)}"
        if series < SERIES:
            self._add('<circle class="{}" cx="{:.1f}" cy="{:.1f}" r="5"><title>{}</title></circle>', kind, a, b, title)
        else:
            path = f"M{a - 5:.1f} {b - 5:.1f}h10v10h-10z"
            self._add('<path class="{}" d="{}"><title>{}</title></path>', kind, path, title)

    def name(self, x: float, text: str) -> None:
        """A word below the axis."""
        a, _ = self.at(x, self.y[0])
        self._text(a, HEIGHT - BOTTOM + 16, text, "middle")

    def svg(self) -> Markup:
        """The whole."""
        inside = Markup("").join(self.parts)
        return Markup('<svg class="chart" viewBox="0 0 {} {}" role="img" aria-label="{}">{}</svg>').format(
            WIDTH, self.height, self.label, inside
        )

    def _text(self, x: float, y: float, text: str, anchor: str) -> None:
        self._add('<text x="{:.1f}" y="{:.1f}" text-anchor="{}">{}</text>', x, y, anchor, text)

    def _add(self, form: str, *values: object) -> None:
        self.parts.append(Markup(form).format(*(v if isinstance(v, int | float) else escape(v) for v in values)))

"""Shapes and letters on a picture (H, W, 3) r, g, b, in place."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

Picture = NDArray[np.uint8]
Colour = tuple[int, int, int]
Place = tuple[float, float]
"""(x, y) from the upper left, pixels."""

NIGHT: Colour = (15, 17, 21)
PANEL: Colour = (27, 30, 37)
GROOVE: Colour = (47, 52, 62)
DIM: Colour = (140, 148, 160)
TEXT: Colour = (232, 235, 240)
BLUE: Colour = (72, 150, 255)
GREEN: Colour = (72, 200, 118)
AMBER: Colour = (250, 182, 60)
RED: Colour = (236, 66, 62)

_SHIFT = 4
"""Fraction bits of cv2's coordinates."""


class Box(NamedTuple):
    """A rectangle of whole pixels."""

    x: int
    y: int
    width: int
    height: int

    def cut(self, picture: Picture) -> Picture:
        """The part of the picture that it holds, to be drawn on."""
        return picture[self.y : self.y + self.height, self.x : self.x + self.width]


class _Stamp(NamedTuple):
    x: int
    y: int
    ink: NDArray[np.float32]
    """(h, w, 1) coverage in [0, 1]."""


@lru_cache(maxsize=16)
def _font(size: int, bold: bool) -> ImageFont.FreeTypeFont:
    import matplotlib as mpl

    name = "DejaVuSans-Bold.ttf" if bold else "DejaVuSans.ttf"
    return ImageFont.truetype(str(Path(mpl.get_data_path(), "fonts", "ttf", name)), size)


@lru_cache(maxsize=2048)
def _stamp(text: str, size: int, bold: bool, anchor: str) -> _Stamp:
    font = _font(size, bold)
    left, top, right, bottom = (round(n) for n in font.getbbox(text, anchor=anchor))
    image = Image.new("L", (max(1, right - left), max(1, bottom - top)))
    ImageDraw.Draw(image).text((-left, -top), text, fill=255, font=font, anchor=anchor)
    ink = np.asarray(image).astype(np.float32) / np.float32(255)
    return _Stamp(left, top, ink[:, :, None])


def write(
    picture: Picture, at: Place, text: str, size: int, colour: Colour = TEXT, *, bold: bool = False, anchor: str = "ls"
) -> int:
    """Write a line of text; returns its width. What would stand outside the picture is left out.

    Args:
        size: of the letters, pixels.
        anchor: which point of the text is at `at`, as PIL names them: l, m, r and a, m, s (top, middle, baseline).
    """
    stamp = _stamp(text, size, bold, anchor)
    x, y = round(at[0]) + stamp.x, round(at[1]) + stamp.y
    height, width = stamp.ink.shape[:2]
    top, left = max(0, -y), max(0, -x)
    under = picture[y + top : max(0, y + height), x + left : max(0, x + width)]
    ink = stamp.ink[top : top + under.shape[0], left : left + under.shape[1]]
    under[:] = (under + ink * (np.array(colour, np.float32) - under) + 0.5).astype(np.uint8)
    return width


def width_of(text: str, size: int, *, bold: bool = False) -> int:
    """How wide a line of text is, pixels."""
    return int(_stamp(text, size, bold, "ls").ink.shape[1])


def bar(picture: Picture, box: tuple[float, float, float, float], colour: Colour, radius: float = 4.0) -> None:
    """A filled rectangle (x, y, width, height) with round corners."""
    x, y, width, height = box
    radius = min(radius, width / 2, height / 2)
    if radius < 1:
        cv2.rectangle(picture, _fixed(x, y), _fixed(x + width, y + height), colour, -1, cv2.LINE_AA, _SHIFT)
        return
    corners = []
    for cx, cy, start in (
        (x + width - radius, y + height - radius, 0), (x + radius, y + height - radius, 90),
        (x + radius, y + radius, 180), (x + width - radius, y + radius, 270),
    ):  # fmt: skip
        angles = np.radians(np.linspace(start, start + 90, 8))
        corners.append(np.stack([cx + radius * np.cos(angles), cy + radius * np.sin(angles)], 1))
    polygon(picture, np.concatenate(corners), colour)


def polygon(picture: Picture, points: NDArray[np.float64], colour: Colour) -> None:
    """A filled polygon (N, 2)."""
    cv2.fillPoly(picture, [_all_fixed(points)], colour, cv2.LINE_AA, _SHIFT)


def line(picture: Picture, points: NDArray[np.float64], colour: Colour, thickness: int = 2) -> None:
    """A line through points (N, 2)."""
    cv2.polylines(picture, [_all_fixed(points)], False, colour, thickness, cv2.LINE_AA, _SHIFT)


def disc(picture: Picture, at: Place, radius: float, colour: Colour) -> None:
    """A filled circle."""
    cv2.circle(picture, _fixed(*at), round(radius * 2**_SHIFT), colour, -1, cv2.LINE_AA, _SHIFT)


def pill(picture: Picture, at: Place, text: str, size: int, fill: Colour, colour: Colour = TEXT) -> None:
    """A word on a coloured ground, its middle at `at`."""
    width, height = width_of(text, size, bold=True) + 2 * size, 1.9 * size
    bar(picture, (at[0] - width / 2, at[1] - height / 2, width, height), fill, height / 2)
    write(picture, at, text, size, colour, bold=True, anchor="mm")


def label(picture: Picture, at: Place, text: str, size: int = 13) -> None:
    """A small dark plate with a name, its upper left corner at `at`."""
    width = width_of(text, size) + 12
    x, y = round(at[0]), round(at[1])
    plate = picture[y : y + size + 9, x : x + width]
    plate[:] = plate // 4
    write(picture, (x + 6, y + (size + 9) / 2), text, size, TEXT, anchor="lm")


def _fixed(x: float, y: float) -> tuple[int, int]:
    return round(x * 2**_SHIFT), round(y * 2**_SHIFT)


def _all_fixed(points: NDArray[np.float64]) -> NDArray[np.int32]:
    return np.asarray(np.round(np.asarray(points) * 2**_SHIFT), np.int32)

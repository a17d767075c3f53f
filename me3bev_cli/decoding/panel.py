"""The paper's figure: six camera images, the true map and the decoded ones, side by side."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from me3bev_cli.api import BEV_CLASSES
from me3bev_cli.errors import UserError
from me3bev_cli.files import atomic_write_bytes
from me3bev_cli.pictures import BEV_COLOURS, colour_map, tile

Picture = NDArray[np.uint8]

GAP = 6
MAP = 300
"""Pixels per side of a map."""
LINE = 18
"""Pixels of a line of text."""
INK, PAPER = (30, 30, 34), (255, 255, 255)
KINDS = (".png", ".webp")


def check_panel(path: Path) -> None:
    """Raises UserError for a kind of picture that is not made, before anything is computed."""
    if path.suffix.lower() not in KINDS:
        raise UserError(f"'{path.name}' is no kind of picture that is made", where="--panel", allowed=", ".join(KINDS))


def panel(images: Picture, maps: Mapping[str, Picture], title: str = "") -> Picture:
    """Cameras (C, 3, H, W) on the left, maps (200, 200) by name on the right, all as high as the maps.

    The ego stands in the middle of each map, heading up.
    """
    mosaic = tile(images)
    width = round(mosaic.shape[1] * MAP / mosaic.shape[0])
    # Of cameras of odd shapes, the rows keep their shape and are not blown up beyond three maps' width.
    width = max(1, min(width, 3 * MAP))
    cameras = cv2.resize(mosaic, (width, MAP), interpolation=cv2.INTER_AREA if width < mosaic.shape[1] else 0)
    parts = {"cameras": cameras} | {name: _map(classes) for name, classes in maps.items()}
    total = sum(part.shape[1] for part in parts.values()) + GAP * (len(parts) + 1)
    sheet = Image.new("RGB", (total, MAP + 2 * LINE + GAP), PAPER)
    pen, left = ImageDraw.Draw(sheet), GAP
    font = ImageFont.load_default(12)
    pen.text((GAP, 2), title, INK, font)
    for name, part in parts.items():
        pen.text((left, LINE + 1), name, INK, font)
        sheet.paste(Image.fromarray(np.ascontiguousarray(part)), (left, 2 * LINE))
        left += part.shape[1] + GAP
    return np.asarray(sheet)


def _map(classes: Picture) -> Picture:
    drawn = cv2.resize(colour_map(classes), (MAP, MAP), interpolation=cv2.INTER_NEAREST)
    middle = MAP // 2
    outline = np.array([[middle, middle - 7], [middle - 4, middle + 5], [middle + 4, middle + 5]])
    return np.asarray(cv2.fillConvexPoly(np.ascontiguousarray(drawn), outline, (255, 255, 255)), np.uint8)


def stacked(pictures: Sequence[Picture]) -> Picture:
    """Panels under each other, the colours of the classes below them."""
    width = max(picture.shape[1] for picture in pictures)
    rows = [np.pad(p, ((0, 0), (0, width - p.shape[1]), (0, 0)), constant_values=255) for p in pictures]
    return np.concatenate([*rows, _legend(width)])


def _legend(width: int) -> Picture:
    sheet = Image.new("RGB", (width, LINE + GAP), PAPER)
    pen, left, font = ImageDraw.Draw(sheet), GAP, ImageFont.load_default(12)
    for name, colour in zip(BEV_CLASSES, BEV_COLOURS.tolist(), strict=True):
        pen.rectangle((left, 4, left + 11, 15), tuple(colour), INK)
        pen.text((left + 16, 2), name.replace("_", " "), INK, font)
        left += 26 + round(font.getlength(name))
    return np.asarray(sheet)


def write_png(path: Path, picture: Picture) -> None:
    """Write an RGB picture, whole or not at all.

    Raises:
        UserError: the system refuses.
    """
    write_pictures(path, [picture])


def write_pictures(path: Path, pictures: Sequence[Picture], milliseconds: int = 100) -> None:
    """Write one picture, or several as an animation where the kind of file has such.

    Raises:
        UserError: the system refuses.
    """
    frames = [Image.fromarray(np.ascontiguousarray(picture)) for picture in pictures]
    buffer = io.BytesIO()
    if path.suffix.lower() == ".webp":
        more = {"save_all": True, "append_images": frames[1:], "duration": milliseconds, "loop": 0}
        frames[0].save(buffer, "WEBP", quality=80, method=2, **(more if len(frames) > 1 else {}))
    else:
        frames[0].save(buffer, "PNG", optimize=True)
    atomic_write_bytes(path, buffer.getvalue())

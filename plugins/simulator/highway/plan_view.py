"""A plan of the scene for people: painted ground, houses and trees, vehicles, lights, the route."""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from me3bev_plugins.simulator.highway.camera_things import BUILDING, PEDESTRIAN, VEHICLE, Gathering
from me3bev_plugins.simulator.highway.geometry import Shape
from me3bev_plugins.simulator.highway.ground_tiles import Tiles, lookup_mip
from me3bev_plugins.simulator.highway.raster import (
    BLUE,
    COS,
    GREEN,
    LENGTH,
    RED,
    SEMANTIC,
    SHAPE,
    SIN,
    STATE,
    WIDTH,
    X,
    Y,
)
from me3bev_plugins.simulator.highway.raster_colour import SHADES, code_colours
from me3bev_plugins.simulator.highway.scene import Light, Scene
from me3bev_plugins.simulator.highway.town import Town

Bytes = NDArray[np.uint8]
Floats = NDArray[np.float64]
Colour = tuple[int, int, int]

METRES, AHEAD = 80.0, 18.0
"""What `plan_view` shows: its side, and how far ahead of the ego its middle is."""
LEVEL = 2.5
"""What is farther away in height is on another level, metres."""
EGO: Colour = (40, 120, 255)
ROUTE: Colour = (60, 150, 255)
WALKER: Colour = (230, 70, 60)
LAMPS: dict[int, Colour] = {Light.RED: (240, 50, 40), Light.AMBER: (250, 180, 40), Light.GREEN: (50, 210, 90)}
_SHIFT = 4
"""Fraction bits of cv2's coordinates."""


def plan_view(scene: Scene, route: Floats, size: int) -> Bytes:
    """What lies around the ego and, more of it, ahead: (size, size, 3) r, g, b, smooth.

    Args:
        route: (P, 2 or 3) what is left of it, world, metres.
        size: side of the picture, pixels.
    """
    image = plan_image(scene, route, 2 * size, METRES, AHEAD)
    return np.asarray(cv2.resize(image, (size, size), interpolation=cv2.INTER_AREA), np.uint8)


def plan_image(
    scene: Scene, route: Floats | None = None, pixels: int = 512, metres: float = 100.0, ahead: float = 0.0
) -> Bytes:
    """The surroundings from above, the ego heading up: (pixels, pixels, 3) r, g, b.

    Args:
        route: (P, 2 or 3) world points to draw as a line that ends in a ring.
        pixels: side of the picture.
        metres: side of what it shows.
        ahead: how far ahead of the ego the middle of the picture is, metres.
    """
    near = Gathering(scene.town)
    pose, count, level = near.collect(scene, 0.75 * metres + ahead)
    colours = code_colours()[SHADES // 2 :: SHADES].round().astype(np.uint8)
    sheet = Sheet(np.empty((pixels, pixels, 3), np.uint8), pixels / metres, ahead)
    _paint_ground(near.ground.tiles, level, pose, metres / pixels, ahead, colours, sheet.image)
    _stop_lines(sheet, scene, pose)
    if route is not None and len(route) > 1:
        path = _to_ego(np.asarray(route, np.float64), pose)
        sheet.line(path, ROUTE, 0.5)
        sheet.disc(path[-1], 1.3, ROUTE)
        sheet.disc(path[-1], 0.7, (255, 255, 255))
    for n, label in zip(near.things.number[:count], near.things.label[:count], strict=True):
        _draw_thing(sheet, n, label)
    ego = scene.ego
    sheet.box(np.zeros(2), (1.0, 0.0), (ego.length, ego.width), EGO)
    sheet.fill(
        np.array([(ego.length / 2, 0.0), (ego.length / 5, ego.width / 2), (ego.length / 5, -ego.width / 2)]),
        (255, 255, 255),
    )
    return sheet.image


class Sheet(NamedTuple):
    """A picture in the making; places are in the ego frame, metres."""

    image: Bytes
    scale: float
    """Pixels per metre."""
    ahead: float

    def line(self, points: Floats, colour: Colour, width: float) -> None:
        """A line of a width in metres."""
        cv2.polylines(
            self.image, [self._pixels(points)], False, colour, max(1, round(width * self.scale)), cv2.LINE_AA, _SHIFT
        )

    def fill(self, corners: Floats, colour: Colour) -> None:
        """A polygon."""
        cv2.fillPoly(self.image, [self._pixels(corners)], colour, cv2.LINE_AA, _SHIFT)

    def disc(self, at: Floats, radius: float, colour: Colour) -> None:
        """A filled circle."""
        ((column, row),) = self._pixels(at[None, :2])
        place = (int(column), int(row))
        cv2.circle(self.image, place, int(radius * self.scale * 2**_SHIFT), colour, -1, cv2.LINE_AA, _SHIFT)

    def box(self, at: Floats, turn: tuple[float, float], size: tuple[float, float], colour: Colour) -> None:
        """A turned rectangle with a darker edge."""
        along = np.array(turn) * size[0] / 2
        left = np.array([-turn[1], turn[0]]) * size[1] / 2
        corners = at + np.array([along + left, along - left, -along - left, -along + left])
        self.fill(corners, colour)
        edge = (colour[0] // 2, colour[1] // 2, colour[2] // 2)
        cv2.polylines(self.image, [self._pixels(corners)], True, edge, 1, cv2.LINE_AA, _SHIFT)

    def _pixels(self, local: Floats) -> NDArray[np.int32]:
        """Places (N, 2) as cv2's fixed-point (column, row)."""
        place = len(self.image) / 2 - self.scale * (local[:, ::-1] - (0.0, self.ahead)) - 0.5
        return np.asarray((place * 2**_SHIFT).round().astype(np.int32))


def _to_ego(points: Floats, pose: Floats) -> Floats:
    """World points (N, 2 or 3) -> (N, 2) in the ego frame."""
    d = points[:, :2] - pose[:2]
    return np.stack([pose[2] * d[:, 0] + pose[3] * d[:, 1], pose[2] * d[:, 1] - pose[3] * d[:, 0]], axis=1)


@lru_cache(maxsize=4)
def _governed(town: Town) -> tuple[Floats, Floats, NDArray[np.int32]]:
    """Stop lines under a traffic light: both ends (K, 2, 2), heights (K,), signals (K,)."""
    pairs = [(town.lanes[lane], signal.id) for signal in town.signals for lane in signal.lanes]
    ends = np.array([lane.points[-1] for lane, _ in pairs]).reshape(-1, 3)
    heading = np.array([lane.heading[-1] for lane, _ in pairs])
    reach = np.stack([-np.sin(heading), np.cos(heading)], 1) * np.array([[0.45 * lane.width] for lane, _ in pairs])
    return (
        np.stack([ends[:, :2] - reach, ends[:, :2] + reach], 1),
        ends[:, 2],
        np.array([signal for _, signal in pairs], np.int32),
    )


def _stop_lines(sheet: Sheet, scene: Scene, pose: Floats) -> None:
    """Stop lines in the colour of their light."""
    if not scene.town.signals:
        return
    ends, height, signal = _governed(scene.town)
    far = np.hypot(*(ends[:, 0] - pose[:2]).T) > len(sheet.image) / sheet.scale
    for i in np.flatnonzero(~far & (np.abs(height - scene.ego.z) < LEVEL)):
        colour = LAMPS.get(int(scene.lights[signal[i]]))
        if colour is not None:
            sheet.line(_to_ego(ends[i], pose), colour, 0.8)


def _draw_thing(sheet: Sheet, n: Floats, label: NDArray[np.int64]) -> None:
    at, turn, size = n[[X, Y]], (float(n[COS]), float(n[SIN])), (float(n[LENGTH]), float(n[WIDTH]))
    colour = (int(n[RED]), int(n[GREEN]), int(n[BLUE]))
    if label[SEMANTIC] in (BUILDING, VEHICLE):
        sheet.box(at, turn, size, colour)
        if label[SEMANTIC] == VEHICLE:
            sheet.box(at + 0.1 * size[0] * np.array(turn), turn, (0.14 * size[0], 0.8 * size[1]), (38, 46, 56))
        return
    if label[SEMANTIC] == PEDESTRIAN:
        sheet.disc(at, 0.75, (255, 255, 255))
        sheet.disc(at, 0.5, WALKER)
    elif label[SHAPE] in (Shape.TREE, Shape.CONIFER, Shape.POPLAR):
        sheet.disc(at, 0.5 * size[0], colour)
    elif label[SHAPE] == Shape.SIGNAL:
        sheet.disc(at, 0.8, (24, 26, 30))
        sheet.disc(at, 0.5, LAMPS.get(int(label[STATE]), (60, 60, 60)))


@njit(cache=True, error_model="numpy")
def _paint_ground(
    tiles: Tiles, town_level: int, pose: Floats, cell: float, ahead: float, colours: Bytes, out: Bytes
) -> None:
    size = out.shape[0]
    level = 0
    while level < 5 and tiles.cell * 2 ** (level + 1) <= cell:
        level += 1
    for row in range(size):
        for column in range(size):
            x, y = (0.5 * size - row - 0.5) * cell + ahead, (0.5 * size - column - 0.5) * cell
            east = (pose[0] + pose[2] * x - pose[3] * y - tiles.origin[0]) / tiles.cell
            north = (pose[1] + pose[3] * x + pose[2] * y - tiles.origin[1]) / tiles.cell
            index = tiles.table[town_level]
            code = lookup_mip(index, tiles.data, int(np.floor(north)), int(np.floor(east)), level)
            for k in range(3):
                out[row, column, k] = colours[code, k]

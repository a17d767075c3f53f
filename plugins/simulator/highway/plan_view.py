"""A plan of the scene for people: painted ground, houses and trees, vehicles, lights, the route."""

from __future__ import annotations

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

Bytes = NDArray[np.uint8]
Floats = NDArray[np.float64]
Colour = tuple[int, int, int]

EGO: Colour = (40, 120, 255)
ROUTE: Colour = (60, 150, 255)
_LAMPS: dict[int, Colour] = {Light.RED: (240, 50, 40), Light.AMBER: (250, 180, 40), Light.GREEN: (50, 210, 90)}
_SHIFT = 4
"""Fraction bits of cv2's coordinates."""


def plan_image(scene: Scene, route: Floats | None = None, pixels: int = 512, metres: float = 100.0) -> Bytes:
    """The surroundings from above, the ego in the middle heading up: (pixels, pixels, 3) r, g, b.

    Args:
        route: (P, 2 or 3) world points to draw as a line.
        pixels: side of the picture.
        metres: side of what it shows.
    """
    near = Gathering(scene.town)
    pose, count, level = near.collect(scene, 0.75 * metres)
    colours = code_colours()[SHADES // 2 :: SHADES].round().astype(np.uint8)
    image = np.empty((pixels, pixels, 3), np.uint8)
    _paint_ground(near.ground.tiles, level, pose, metres / pixels, colours, image)
    scale = pixels / metres
    if route is not None and len(route) > 1:
        d = np.asarray(route, np.float64)[:, :2] - pose[:2]
        local = np.stack([pose[2] * d[:, 0] + pose[3] * d[:, 1], pose[2] * d[:, 1] - pose[3] * d[:, 0]], axis=1)
        cv2.polylines(image, [_to_pixels(local, pixels, scale)], False, ROUTE, max(1, round(0.5 * scale)), 16, _SHIFT)
    numbers, labels = near.things.number[:count], near.things.label[:count]
    for n, label in zip(numbers, labels, strict=True):
        _draw_thing(image, n, label, pixels, scale)
    ego = scene.ego
    _box(image, np.array([0.0, 0.0]), (1.0, 0.0), (ego.length, ego.width), EGO, pixels, scale)
    nose = np.array([(ego.length / 2, 0.0), (ego.length / 5, ego.width / 2), (ego.length / 5, -ego.width / 2)])
    cv2.fillPoly(image, [_to_pixels(nose, pixels, scale)], (255, 255, 255), 16, _SHIFT)
    return image


def _draw_thing(image: Bytes, n: Floats, label: NDArray[np.int64], pixels: int, scale: float) -> None:
    at, turn, size = n[[X, Y]], (float(n[COS]), float(n[SIN])), (float(n[LENGTH]), float(n[WIDTH]))
    colour = (int(n[RED]), int(n[GREEN]), int(n[BLUE]))
    if label[SEMANTIC] in (BUILDING, VEHICLE):
        _box(image, at, turn, size, colour, pixels, scale)
        if label[SEMANTIC] == VEHICLE:
            glass = at + 0.1 * size[0] * np.array(turn)
            _box(image, glass, turn, (0.14 * size[0], 0.8 * size[1]), (38, 46, 56), pixels, scale)
        return
    radius = {Shape.TREE: 0.5 * size[0], Shape.CONIFER: 0.5 * size[0], Shape.SIGNAL: 0.9}.get(Shape(label[SHAPE]))
    if label[SEMANTIC] == PEDESTRIAN:
        radius, colour = 0.45, (230, 70, 60)
    if radius is None:
        return
    if label[SHAPE] == Shape.SIGNAL:
        colour = _LAMPS.get(int(label[STATE]), (60, 60, 60))
    (centre,) = _to_pixels(at[None], pixels, scale)
    where, size_px = (int(centre[0]), int(centre[1])), int(radius * scale * 2**_SHIFT)
    cv2.circle(image, where, size_px, colour, -1, 16, _SHIFT)


def _box(
    image: Bytes, at: Floats, turn: tuple[float, float], size: tuple[float, float], colour: Colour, n: int, scale: float
) -> None:
    along = np.array(turn) * size[0] / 2
    left = np.array([-turn[1], turn[0]]) * size[1] / 2
    corners = _to_pixels(at + np.array([along + left, along - left, -along - left, -along + left]), n, scale)
    cv2.fillPoly(image, [corners], colour, 16, _SHIFT)
    edge = (colour[0] // 2, colour[1] // 2, colour[2] // 2)
    cv2.polylines(image, [corners], True, edge, 1, 16, _SHIFT)


def _to_pixels(local: Floats, pixels: int, scale: float) -> NDArray[np.int32]:
    """Ego-frame points (N, 2) as cv2's fixed-point (column, row)."""
    place = pixels / 2 - scale * local[:, ::-1] - 0.5
    return np.asarray((place * 2**_SHIFT).round().astype(np.int32))


@njit(cache=True, error_model="numpy")
def _paint_ground(tiles: Tiles, town_level: int, pose: Floats, cell: float, colours: Bytes, out: Bytes) -> None:
    size = out.shape[0]
    level = 0
    while level < 5 and tiles.cell * 2 ** (level + 1) <= cell:
        level += 1
    for row in range(size):
        for column in range(size):
            x, y = (0.5 * size - row - 0.5) * cell, (0.5 * size - column - 0.5) * cell
            east = (pose[0] + pose[2] * x - pose[3] * y - tiles.origin[0]) / tiles.cell
            north = (pose[1] + pose[3] * x + pose[2] * y - tiles.origin[1]) / tiles.cell
            index = tiles.table[town_level]
            code = lookup_mip(index, tiles.data, int(np.floor(north)), int(np.floor(east)), level)
            for k in range(3):
                out[row, column, k] = colours[code, k]

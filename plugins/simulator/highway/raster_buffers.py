"""The arrays that the rasteriser works on: things to draw, cameras, the visibility buffer."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Ints = NDArray[np.int64]

X, Y, COS, SIN, LENGTH, WIDTH, HEIGHT, RED, GREEN, BLUE, SECOND, BASE, RADIUS = range(13)
"""Columns of `Things.number`: pose in the ego frame, size, first colour (0..255), second colour packed as
65536 r + 256 g + b, height of the underside above the ground, bounding radius."""
NUMBERS = 13
SHAPE, SEMANTIC, IDENTITY, STATE = range(4)
"""Columns of `Things.label`: mesh, class, who it is (-1: scenery), and braking (0, 1) or light state."""
LABELS = 4

BARE, SHADED = -1, -2
"""In `Canvas.face`: no face there, but sky or ground; ground in the shade."""
WALL_NUMBERS = 20
"""Of a wall: 0-2 direction along it in the camera frame, 3 offset, 4-5 window bays and storeys per metre, 6 height,
7 how 1/z changes per column, 8 style, 9 its own number, 10-12 colour in its light, 13 the light, 15 the own beam's,
16-17 1/z at the first column and row and how it changes per row, 18-19 its columns."""
_STRIPS = 128
_CORNER_ROOM = 16
_VERTEX_ROOM = 512


class Things(NamedTuple):
    """What is to be drawn; the first so many rows count."""

    number: Floats
    label: Ints
    order: Ints
    """(N,) rows from near to far."""
    key: Floats
    """(N,) what they are sorted by."""


class Lenses(NamedTuple):
    """The rig's C cameras."""

    rotation: Floats
    """(C, 3, 3) ego frame -> camera frame."""
    position: Floats
    """(C, 3) in the ego frame."""
    pinhole: Floats
    """(C, 4) fx, fy, cx, cy."""


class Canvas(NamedTuple):
    """One camera's visibility buffer and the faces in it, and room to work in."""

    inverse: Singles
    """(H, W) 1/z; 0 where no face is."""
    face: NDArray[np.int32]
    """(H, W) row of the arrays below, or BARE or SHADED."""
    colour: NDArray[np.uint8]
    """(F, 3) as it is painted; of walls, without what `wall` adds."""
    style: NDArray[np.int32]
    """(F,) PLAIN, WALL or GLOW."""
    owner: NDArray[np.int32]
    """(F,) row of `Things`."""
    wall: Singles
    """(F, WALL_NUMBERS) of walls."""
    local: Floats
    polygon: Floats
    spans: Floats
    row: Floats
    """(8,) of the row that is being painted."""
    gain: NDArray[np.int32]
    """(W,) how much brighter lamps make a run, of 256."""
    lamp: NDArray[np.uint8]
    """(H, W) light of lamps on the ground, of 255."""
    warmth: NDArray[np.int32]
    """(W,) how much of a low sun's glow each column of the sky has, of 256."""
    packed: NDArray[np.int32]
    """(W + 16,) colours of a row of a wall, r + 256 g + 65536 b."""
    slot: Ints
    """(F,) where a wall's strip may be."""
    strips: Ints
    """(1,) how many strips are in use."""
    strip_face: Ints
    """(STRIPS,) whose they are."""
    strip: NDArray[np.int32]
    """(STRIPS, 6, W + 16) as `raster_walls` says."""
    strip_depth: Singles
    """(STRIPS, W + 16) metres."""


def make_canvas(size: tuple[int, int], faces: int) -> Canvas:
    """An empty canvas of (H, W) pixels with room for so many faces."""
    return Canvas(
        inverse=np.zeros(size, np.float32),
        face=np.full(size, BARE, np.int32),
        colour=np.zeros((faces, 3), np.uint8),
        style=np.zeros(faces, np.int32),
        owner=np.zeros(faces, np.int32),
        wall=np.zeros((faces, WALL_NUMBERS), np.float32),
        local=np.zeros((_VERTEX_ROOM, 5)),
        polygon=np.zeros((_CORNER_ROOM, 2)),
        spans=np.zeros((size[0], 2)),
        row=np.zeros(8),
        gain=np.zeros(size[1], np.int32),
        lamp=np.zeros(size, np.uint8),
        warmth=np.zeros(size[1], np.int32),
        packed=np.zeros(size[1] + 16, np.int32),
        slot=np.zeros(faces, np.int64),
        strips=np.zeros(1, np.int64),
        strip_face=np.zeros(_STRIPS, np.int64),
        strip=np.zeros((_STRIPS, 6, size[1] + 16), np.int32),
        strip_depth=np.zeros((_STRIPS, size[1] + 16), np.float32),
    )


def make_things(rows: int) -> Things:
    """Room for so many things."""
    return Things(
        number=np.zeros((rows, NUMBERS)),
        label=np.zeros((rows, LABELS), np.int64),
        order=np.zeros(rows, np.int64),
        key=np.zeros(rows),
    )

"""The shapes that cameras draw: meshes in unit boxes, stretched to each thing's size.

A mesh lives in x -0.5..0.5 (forward), y -0.5..0.5 (left), z 0..1 (up). Faces are convex, their corners
counter-clockwise seen from outside. A face has a `Role`, which decides its colour, and a range beyond which
it is too small to draw.
"""

from __future__ import annotations

from enum import IntEnum
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from me3bev_plugins.simulator.highway.materials import Role
from me3bev_plugins.simulator.highway.mesh_builder import FINE, MeshBuilder, Point

CORNERS = 8
"""Most corners of a face."""


class Shape(IntEnum):
    """Meshes, by their place in `Meshes`. The first five follow `scene.Kind`."""

    CAR = 0
    VAN = 1
    TRUCK = 2
    MOTORCYCLE = 3
    PEDESTRIAN = 4
    BUILDING = 5
    TREE = 6
    CONIFER = 7
    POLE = 8
    SIGNAL = 9
    STOP = 10
    YIELD = 11
    BOX = 12
    STRIDE = 13
    """A pedestrian with the legs apart."""


class Meshes(NamedTuple):
    """All meshes, packed. Vertices of shape k are `vertex[vertex_start[k]:vertex_start[k + 1]]`, faces alike."""

    vertex: NDArray[np.float64]
    vertex_start: NDArray[np.int64]
    corner: NDArray[np.int64]
    """(F, CORNERS) vertices within the shape."""
    corners: NDArray[np.int64]
    """(F,) how many of them count."""
    role: NDArray[np.int64]
    reach: NDArray[np.float64]
    face_start: NDArray[np.int64]


def _car() -> MeshBuilder:
    b = MeshBuilder()
    b.shadow((-0.53, 0.53), (-0.58, 0.58))
    b.box((-0.46, 0.46), (-0.44, 0.44), (0.0, 0.2), Role.DARK)
    b.frustum(((-0.5, 0.5), (-0.5, 0.5), 0.16), ((-0.49, 0.47), (-0.48, 0.48), 0.58), Role.FIRST, Role.FIRST)
    b.frustum(((-0.36, 0.24), (-0.46, 0.46), 0.58), ((-0.26, 0.06), (-0.37, 0.37), 1.0), Role.GLASS, Role.FIRST)
    for sign in (-1.0, 1.0):
        low, high, lift = sign * 0.463, sign * 0.372, 1.0
        pillar = [(-0.06, low, 0.58), (-0.02, low, 0.58), (-0.03, high, lift), (-0.07, high, lift)]
        b.face(pillar if sign < 0 else pillar[::-1], Role.FIRST, FINE)
        for x in (-0.3, 0.31):
            b.wheel(x, sign * 0.503, (0.07, 0.21), sign)
    b.lamps(0.502, (0.38, 0.5))
    b.front(0.503, (-0.24, 0.24), (0.22, 0.42), Role.DARK, FINE)
    b.rear(-0.503, (-0.13, 0.13), (0.34, 0.42), Role.PLATE, FINE)
    return b


def _van() -> MeshBuilder:
    b = MeshBuilder()
    b.shadow((-0.52, 0.52), (-0.56, 0.56))
    b.box((-0.46, 0.46), (-0.44, 0.44), (0.0, 0.14), Role.DARK)
    b.frustum(((-0.5, 0.5), (-0.5, 0.5), 0.1), ((-0.5, 0.47), (-0.5, 0.5), 0.5), Role.FIRST, Role.FIRST)
    b.frustum(((-0.5, 0.38), (-0.5, 0.5), 0.5), ((-0.49, 0.24), (-0.46, 0.46), 1.0), Role.FIRST, Role.FIRST)
    b.face([(0.372, -0.44, 0.54), (0.372, 0.44, 0.54), (0.262, 0.41, 0.94), (0.262, -0.41, 0.94)], Role.GLASS)
    b.rear(-0.503, (-0.36, 0.36), (0.56, 0.86), Role.GLASS)
    for sign in (-1.0, 1.0):
        glass = [(0.1, 0.503 * sign, 0.54), (0.33, 0.503 * sign, 0.54), (0.24, 0.478 * sign, 0.84)]
        glass.append((0.1, 0.478 * sign, 0.84))
        b.face(glass if sign < 0 else glass[::-1], Role.GLASS)
        for x in (-0.3, 0.32):
            b.wheel(x, sign * 0.503, (0.065, 0.16), sign)
    b.lamps(0.502, (0.3, 0.4))
    b.front(0.503, (-0.24, 0.24), (0.18, 0.34), Role.DARK, FINE)
    b.rear(-0.503, (-0.12, 0.12), (0.24, 0.3), Role.PLATE, FINE)
    return b


def _truck() -> MeshBuilder:
    b = MeshBuilder()
    b.shadow((-0.52, 0.52), (-0.55, 0.55))
    b.box((-0.48, 0.48), (-0.42, 0.42), (0.0, 0.2), Role.DARK)
    b.box((-0.5, 0.24), (-0.5, 0.5), (0.2, 1.0), Role.SECOND)
    b.frustum(((0.27, 0.5), (-0.48, 0.48), 0.1), ((0.27, 0.485), (-0.47, 0.47), 0.78), Role.FIRST, Role.FIRST)
    b.face([(0.498, -0.43, 0.44), (0.498, 0.43, 0.44), (0.491, 0.42, 0.7), (0.491, -0.42, 0.7)], Role.GLASS)
    for sign in (-1.0, 1.0):
        b.side(sign * 0.483, (0.34, 0.46), (0.46, 0.68), Role.GLASS)
        for x in (-0.38, -0.22, 0.38):
            b.wheel(x, sign * 0.503, (0.06, 0.14), sign, 2 * FINE)
    b.lamps(0.503, (0.18, 0.26))
    b.front(0.503, (-0.24, 0.24), (0.14, 0.34), Role.DARK, FINE)
    b.rear(-0.503, (-0.02, 0.02), (0.24, 0.96), Role.DARK, FINE)
    return b


def _motorcycle() -> MeshBuilder:
    b = MeshBuilder()
    b.shadow((-0.5, 0.5), (-0.35, 0.35))
    for x in (-0.34, 0.34):
        b.box((x - 0.15, x + 0.15), (-0.08, 0.08), (0.0, 0.38), Role.DARK)
    b.box((-0.42, 0.3), (-0.16, 0.16), (0.28, 0.52), Role.FIRST)
    b.box((0.24, 0.32), (-0.5, 0.5), (0.56, 0.62), Role.METAL)
    for sign in (-1.0, 1.0):
        b.box((-0.12, 0.14), (sign * 0.26 - 0.1, sign * 0.26 + 0.1), (0.22, 0.54), Role.DARK)
    b.frustum(((-0.18, 0.08), (-0.3, 0.3), 0.5), ((-0.08, 0.12), (-0.34, 0.34), 0.84), Role.SECOND, Role.SECOND)
    b.box((-0.02, 0.13), (-0.16, 0.16), (0.85, 1.0), Role.FIRST)
    b.front(0.36, (-0.14, 0.14), (0.42, 0.54), Role.HEADLAMP, 120.0)
    b.rear(-0.43, (-0.14, 0.14), (0.42, 0.52), Role.TAIL, 120.0)
    return b


def _pedestrian(stride: float) -> MeshBuilder:
    b = MeshBuilder()
    b.shadow((-0.5, 0.5), (-0.55, 0.55))
    for sign in (-1.0, 1.0):
        y = (sign * 0.2 - 0.14, sign * 0.2 + 0.14)
        x = sign * stride
        b.frustum(((x - 0.16, x + 0.16), y, 0.0), ((-0.17, 0.17), y, 0.5), Role.SECOND, Role.SECOND)
        arm = (sign * 0.44 - 0.08, sign * 0.44 + 0.08)
        b.frustum(((-x - 0.1, -x + 0.1), arm, 0.44), ((-0.12, 0.12), arm, 0.8), Role.FIRST, Role.FIRST, 2 * FINE)
        b.box((-x - 0.1, -x + 0.1), arm, (0.4, 0.44), Role.SKIN, FINE)
    b.frustum(((-0.24, 0.24), (-0.34, 0.34), 0.47), ((-0.22, 0.22), (-0.4, 0.4), 0.84), Role.FIRST, Role.FIRST)
    b.box((-0.2, 0.2), (-0.19, 0.19), (0.86, 0.97), Role.SKIN)
    b.box((-0.22, 0.16), (-0.21, 0.21), (0.95, 1.0), Role.DARK)
    return b


def _building() -> MeshBuilder:
    b = MeshBuilder()
    b.frustum(((-0.5, 0.5), (-0.5, 0.5), 0.0), ((-0.5, 0.5), (-0.5, 0.5), 1.0), Role.WALL, Role.SECOND)
    return b


def _tree() -> MeshBuilder:
    b = MeshBuilder()
    b.shadow((-0.36, 0.36), (-0.36, 0.36))
    b.lathe([(0.06, 0.0), (0.045, 0.4)], 5, Role.BARK)
    b.lathe([(0.12, 0.3), (0.42, 0.42), (0.5, 0.62), (0.36, 0.86), (0.12, 1.0)], 7, Role.FIRST)
    return b


def _conifer() -> MeshBuilder:
    b = MeshBuilder()
    b.shadow((-0.36, 0.36), (-0.36, 0.36))
    b.lathe([(0.06, 0.0), (0.06, 0.2)], 5, Role.BARK)
    b.lathe([(0.5, 0.14), (0.2, 0.5)], 7, Role.FIRST)
    b.lathe([(0.4, 0.42), (0.14, 0.74)], 7, Role.FIRST)
    b.lathe([(0.28, 0.68), (0.02, 1.0)], 7, Role.FIRST)
    return b


def _pole() -> MeshBuilder:
    b = MeshBuilder()
    b.lathe([(0.5, 0.0), (0.32, 1.0)], 5, Role.METAL)
    return b


def _signal() -> MeshBuilder:
    """Driven towards +x: the lamps face -x."""
    b = MeshBuilder()
    b.box((-0.3, 0.3), (-0.34, 0.34), (0.03, 0.97), Role.DARK)
    plate: list[Point] = [(0.0, 0.5, 0.0), (0.0, -0.5, 0.0), (0.0, -0.5, 1.0), (0.0, 0.5, 1.0)]
    b.sheet(plate, Role.DARK)
    for z, role in ((0.82, Role.RED), (0.5, Role.AMBER), (0.18, Role.GREEN)):
        turn = 2 * np.pi * (np.arange(8) + 0.5) / 8
        b.face([(-0.31, -0.27 * float(np.cos(t)), z + 0.135 * float(np.sin(t))) for t in turn], role)
    return b


def _sign(sides: int, turn: float, inner: Role) -> MeshBuilder:
    """A plate that faces -x, red with an inner part."""
    b = MeshBuilder()
    angles = 2 * np.pi * np.arange(sides) / sides + turn
    for x, size, role in ((0.0, 0.5, Role.SIGN_RED), (-0.02, 0.3 if inner is Role.SIGN_WHITE else 0.44, inner)):
        rim: list[Point] = [(x, -size * float(np.cos(t)), 0.5 + size * float(np.sin(t))) for t in angles]
        b.face(rim, role)
    b.face([(0.01, 0.5 * float(np.cos(t)), 0.5 + 0.5 * float(np.sin(t))) for t in angles + np.pi], Role.METAL)
    return b


def _box() -> MeshBuilder:
    b = MeshBuilder()
    b.box((-0.5, 0.5), (-0.5, 0.5), (0.0, 1.0), Role.FIRST)
    b.face([(-0.5, 0.5, 0.0), (0.5, 0.5, 0.0), (0.5, -0.5, 0.0), (-0.5, -0.5, 0.0)], Role.FIRST)
    return b


@cache
def meshes() -> Meshes:
    """All shapes, in the order of `Shape`."""
    stop = _sign(8, np.pi / 8, Role.SIGN_RED)
    bar: list[Point] = [(-0.03, 0.36, 0.42), (-0.03, -0.36, 0.42), (-0.03, -0.36, 0.58), (-0.03, 0.36, 0.58)]
    stop.face(bar, Role.SIGN_WHITE)
    built = {
        Shape.CAR: _car(),
        Shape.VAN: _van(),
        Shape.TRUCK: _truck(),
        Shape.MOTORCYCLE: _motorcycle(),
        Shape.PEDESTRIAN: _pedestrian(0.0),
        Shape.BUILDING: _building(),
        Shape.TREE: _tree(),
        Shape.CONIFER: _conifer(),
        Shape.POLE: _pole(),
        Shape.SIGNAL: _signal(),
        Shape.STOP: stop,
        Shape.YIELD: _sign(3, -np.pi / 2, Role.SIGN_WHITE),
        Shape.BOX: _box(),
        Shape.STRIDE: _pedestrian(0.3),
    }
    parts = [built[shape] for shape in Shape]
    faces = [face for part in parts for face in part.faces]
    corner = np.zeros((len(faces), CORNERS), np.int64)
    for row, (points, _, _) in zip(corner, faces, strict=True):
        row[: len(points)] = points
    return Meshes(
        vertex=np.array([vertex for part in parts for vertex in part.vertices], np.float64),
        vertex_start=np.cumsum([0, *(len(part.vertices) for part in parts)]).astype(np.int64),
        corner=corner,
        corners=np.array([len(points) for points, _, _ in faces], np.int64),
        role=np.array([role for _, role, _ in faces], np.int64),
        reach=np.array([reach for _, _, reach in faces], np.float64),
        face_start=np.cumsum([0, *(len(part.faces) for part in parts)]).astype(np.int64),
    )

"""The shapes that cameras draw: meshes in unit boxes, stretched to each thing's size.

A mesh lives in x -0.5..0.5 (forward), y -0.5..0.5 (left), z 0..1 (up). Faces are convex, their corners
counter-clockwise seen from outside. A face has a `Role`, which decides its colour, and a range beyond which
it is too small to draw; some shapes have a plainer one for far away.
"""

from __future__ import annotations

from enum import IntEnum
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from me3bev_plugins.simulator.highway import geometry_scenery as scenery
from me3bev_plugins.simulator.highway import geometry_vehicles as vehicles
from me3bev_plugins.simulator.highway.mesh_builder import MeshBuilder

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
    HATCHBACK = 14
    SUV = 15
    HOUSE = 16
    LAMP = 17
    POPLAR = 18
    FAR_CAR = 19
    FAR_VAN = 20
    FAR_TRUCK = 21
    FAR_PEDESTRIAN = 22
    FAR_TREE = 23
    FAR_CONIFER = 24


BODIES = (Shape.CAR, Shape.HATCHBACK, Shape.SUV)
"""Of cars."""
_FAR = {
    Shape.CAR: Shape.FAR_CAR,
    Shape.HATCHBACK: Shape.FAR_CAR,
    Shape.SUV: Shape.FAR_CAR,
    Shape.VAN: Shape.FAR_VAN,
    Shape.TRUCK: Shape.FAR_TRUCK,
    Shape.PEDESTRIAN: Shape.FAR_PEDESTRIAN,
    Shape.STRIDE: Shape.FAR_PEDESTRIAN,
    Shape.TREE: Shape.FAR_TREE,
    Shape.CONIFER: Shape.FAR_CONIFER,
}
_CASTS = {
    Shape.CAR: (1.0, 1.0, 0.0, 0.55, 0.75, 0.95),
    Shape.HATCHBACK: (1.0, 1.0, 0.0, 0.65, 0.75, 0.95),
    Shape.SUV: (1.0, 1.0, 0.0, 0.75, 0.8, 0.97),
    Shape.VAN: (1.0, 1.0, 0.0, 0.8, 0.92, 0.98),
    Shape.TRUCK: (1.0, 1.0, 0.0, 0.95, 1.0, 1.0),
    Shape.MOTORCYCLE: (0.9, 0.3, 0.0, 0.2, 0.6, 0.95),
    Shape.PEDESTRIAN: (0.5, 0.7, 0.0, 0.4, 0.7, 0.98),
    Shape.STRIDE: (0.7, 0.7, 0.0, 0.4, 0.7, 0.98),
    Shape.BUILDING: (1.0, 1.0, 0.0, 1.0, 1.0, 1.0),
    Shape.HOUSE: (1.0, 1.0, 0.0, 1.0, 0.5, 0.85),
    Shape.TREE: (0.1, 0.1, 0.0, 0.7, 0.7, 0.75),
    Shape.CONIFER: (0.6, 0.6, 0.1, 0.05, 0.05, 1.0),
    Shape.POPLAR: (0.3, 0.3, 0.0, 0.5, 0.5, 0.8),
    Shape.POLE: (1.0, 1.0, 0.0, 0.7, 0.7, 1.0),
    Shape.LAMP: (0.04, 0.5, 0.0, 0.03, 0.3, 1.0),
    Shape.SIGNAL: (0.5, 0.8, 0.0, 0.5, 0.8, 1.0),
    Shape.STOP: (0.05, 0.9, 0.0, 0.05, 0.9, 1.0),
    Shape.YIELD: (0.05, 0.9, 0.0, 0.05, 0.9, 1.0),
}
SHADOWS = np.array([(1.0, *_CASTS[shape]) if shape in _CASTS else (0.0,) * 7 for shape in Shape])
"""By shape: whether it casts a shadow; length, width and height (shares) of the lower end of what casts it; of the
upper end."""


class Meshes(NamedTuple):
    """All meshes, packed. Vertices of shape k are `vertex[vertex_start[k]:vertex_start[k + 1]]`, faces alike."""

    vertex: NDArray[np.float64]
    vertex_start: NDArray[np.int64]
    corner: NDArray[np.int64]
    """(F, CORNERS) vertices within the shape."""
    corners: NDArray[np.int64]
    """(F,) how many of them count."""
    plane: NDArray[np.float64]
    """(F, 4) outward normal and its product with the face's points, in the unit box."""
    role: NDArray[np.int64]
    reach: NDArray[np.float64]
    face_start: NDArray[np.int64]
    plainer: NDArray[np.int64]
    """(shapes,) what stands for each shape far away."""


_SEDAN = ((-0.37, 0.25), (-0.25, 0.08), 0.6)
_HATCHBACK = ((-0.485, 0.26), (-0.41, 0.07), 0.58)
_SUV = ((-0.485, 0.25), (-0.45, 0.1), 0.58)


def _build() -> dict[Shape, MeshBuilder]:
    return {
        Shape.CAR: vehicles.car(*_SEDAN, lamps=(0.38, 0.5), wheel=0.21, rear_pillar=0.12),
        Shape.VAN: vehicles.van(),
        Shape.TRUCK: vehicles.truck(),
        Shape.MOTORCYCLE: vehicles.motorcycle(),
        Shape.PEDESTRIAN: vehicles.pedestrian(0.0),
        Shape.BUILDING: scenery.building(),
        Shape.TREE: scenery.tree(),
        Shape.CONIFER: scenery.conifer(),
        Shape.POLE: scenery.pole(),
        Shape.SIGNAL: scenery.signal(),
        Shape.STOP: scenery.stop_sign(),
        Shape.YIELD: scenery.yield_sign(),
        Shape.BOX: scenery.box(),
        Shape.STRIDE: vehicles.pedestrian(0.3),
        Shape.HATCHBACK: vehicles.car(*_HATCHBACK, lamps=(0.38, 0.52), wheel=0.21, rear_pillar=0.2),
        Shape.SUV: vehicles.car(*_SUV, lamps=(0.42, 0.53), wheel=0.23, rear_pillar=0.1),
        Shape.HOUSE: scenery.house(),
        Shape.LAMP: scenery.street_lamp(),
        Shape.POPLAR: scenery.poplar(),
        Shape.FAR_CAR: vehicles.far_car(*_SEDAN),
        Shape.FAR_VAN: vehicles.far_van(),
        Shape.FAR_TRUCK: vehicles.far_truck(),
        Shape.FAR_PEDESTRIAN: vehicles.far_pedestrian(),
        Shape.FAR_TREE: scenery.far_tree(),
        Shape.FAR_CONIFER: scenery.far_conifer(),
    }


@cache
def meshes() -> Meshes:
    """All shapes, in the order of `Shape`."""
    built = _build()
    parts = [built[shape] for shape in Shape]
    faces = [face for part in parts for face in part.faces]
    corner = np.zeros((len(faces), CORNERS), np.int64)
    for row, (points, _, _) in zip(corner, faces, strict=True):
        row[: len(points)] = points
    planes = [_plane(np.array(list(part.vertices))[points[:3]]) for part in parts for points, _, _ in part.faces]
    return Meshes(
        vertex=np.array([vertex for part in parts for vertex in part.vertices], np.float64),
        vertex_start=np.cumsum([0, *(len(part.vertices) for part in parts)]).astype(np.int64),
        corner=corner,
        corners=np.array([len(points) for points, _, _ in faces], np.int64),
        plane=np.array(planes, np.float64),
        role=np.array([role for _, role, _ in faces], np.int64),
        reach=np.array([reach for _, _, reach in faces], np.float64),
        face_start=np.cumsum([0, *(len(part.faces) for part in parts)]).astype(np.int64),
        plainer=np.array([_FAR.get(shape, shape) for shape in Shape], np.int64),
    )


def _plane(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Normal (unit) and offset (4,) of the plane through three points in counter-clockwise order."""
    normal = np.cross(points[1] - points[0], points[2] - points[1])
    normal /= np.linalg.norm(normal)
    return np.array([*normal, normal @ points[0]])

"""The six cameras: pictures and truth of a scene, drawn from the town's ground and meshes.

Everything is drawn on a flat ground at the ego's height, so hills are felt by the vehicles but not seen, and
only what is on the ego's own level appears.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from me3bev_cli.api import Rig
from me3bev_plugins.simulator.highway.camera_things import Gathering
from me3bev_plugins.simulator.highway.geometry import meshes
from me3bev_plugins.simulator.highway.ground import ground_of
from me3bev_plugins.simulator.highway.raster import SHAPE, Canvas, Lenses, draw
from me3bev_plugins.simulator.highway.raster_colour import AMBIENT, DIRECT, SUN, backdrop, paint
from me3bev_plugins.simulator.highway.raster_truth import read_truth
from me3bev_plugins.simulator.highway.scene import Scene
from me3bev_plugins.simulator.highway.town import Town

SIGHT = 220.0
"""Nothing farther than this is drawn, metres."""


class Cameras:
    """Draws what a rig sees in one town. Ground and scenery are shared by all instances of a process.

    Args:
        town: the world's fixed part; scenes must be of the same town.
        rig: C cameras of one size.
    """

    def __init__(self, town: Town, rig: Rig) -> None:
        self.rig = rig
        self._tiles = ground_of(town).tiles
        self._near = Gathering(town)
        self._meshes = meshes()
        self._faces_of = np.diff(self._meshes.face_start)
        self._lenses = _lenses(rig)
        self._backdrop = backdrop(rig, self._tiles.cell)
        self._canvas = _canvas(rig.image_size, 1024)

    def render(self, scene: Scene, out: NDArray[np.uint8]) -> None:
        """Writes the pictures, r g b, into `out` (C, 3, H, W)."""
        pose, count, level, sun = self._frame(scene)
        for i in range(len(self.rig.cameras)):
            draw(i, self._lenses, self._meshes, self._near.things, count, sun, self._canvas)
            paint(i, self._lenses, self._backdrop, self._tiles, level, pose, self._canvas, out[i])

    def truth(self, scene: Scene) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
        """Depth along the optical axis (C, H, W), metres, inf in the sky; classes (C, H, W) as `BEV_CLASSES`."""
        depth, semantics, _ = self.full_truth(scene)
        return depth, semantics

    def full_truth(self, scene: Scene) -> tuple[NDArray[np.float32], NDArray[np.uint8], NDArray[np.int32]]:
        """As `truth`, and which actor each pixel shows (C, H, W), -1 for none."""
        shape = (len(self.rig.cameras), *self.rig.image_size)
        depth, semantics = np.empty(shape, np.float32), np.empty(shape, np.uint8)
        instances = np.empty(shape, np.int32)
        pose, count, level, sun = self._frame(scene)
        fixed = (self._lenses, self._backdrop, self._tiles, level, pose, self._near.things, self._canvas)
        for i in range(shape[0]):
            draw(i, self._lenses, self._meshes, self._near.things, count, sun, self._canvas)
            read_truth(i, *fixed, depth[i], semantics[i], instances[i])
        return depth, semantics, instances

    def _frame(self, scene: Scene) -> tuple[NDArray[np.float64], int, int, NDArray[np.float64]]:
        """Gathers what is near: the ego's pose, how many things, the ground level, the sun in the ego frame."""
        pose, count, level = self._near.collect(scene, SIGHT)
        faces = int(self._faces_of[self._near.things.label[:count, SHAPE]].sum())
        if faces > len(self._canvas.style):
            self._canvas = _canvas(self.rig.image_size, 2 * faces)
        cos, sin = pose[2], pose[3]
        sun = np.array([cos * SUN[0] + sin * SUN[1], cos * SUN[1] - sin * SUN[0], SUN[2], AMBIENT, DIRECT])
        return pose, count, level, sun


def _lenses(rig: Rig) -> Lenses:
    poses = np.array([camera.camera_to_ego() for camera in rig.cameras], np.float64)
    return Lenses(
        rotation=np.ascontiguousarray(poses[:, :3, :3].transpose(0, 2, 1)),
        position=np.ascontiguousarray(poses[:, :3, 3]),
        pinhole=np.array([(c.fx, c.fy, c.cx, c.cy) for c in rig.cameras], np.float64),
    )


def _canvas(size: tuple[int, int], faces: int) -> Canvas:
    return Canvas(
        inverse=np.zeros(size, np.float32),
        face=np.full(size, -1, np.int32),
        colour=np.zeros((faces, 3), np.float32),
        style=np.zeros(faces, np.int32),
        owner=np.zeros(faces, np.int32),
        wall=np.zeros((faces, 10), np.float32),
    )

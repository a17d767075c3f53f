"""The six cameras: pictures and truth of a scene, drawn from the town's ground and meshes.

Everything is drawn on a flat ground at the ego's height, so hills are felt by the vehicles but not seen. Where
roads cross above one another, the ego's own level is drawn, and of the other one its deck, piers and parapets.
"""

from __future__ import annotations

import zlib

import numpy as np
from numpy.typing import NDArray

from me3bev_cli.api import Rig
from me3bev_plugins.simulator.highway.camera_things import Gathering
from me3bev_plugins.simulator.highway.geometry import meshes
from me3bev_plugins.simulator.highway.ground import ground_of
from me3bev_plugins.simulator.highway.raster import draw
from me3bev_plugins.simulator.highway.raster_backdrop import backdrop
from me3bev_plugins.simulator.highway.raster_buffers import SHAPE, Lenses, make_canvas
from me3bev_plugins.simulator.highway.raster_dress import light_of
from me3bev_plugins.simulator.highway.raster_lamps import LAMP_NUMBERS
from me3bev_plugins.simulator.highway.raster_picture import Air, pictures
from me3bev_plugins.simulator.highway.raster_shadow import make_shadows
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
        self._canvas = make_canvas(rig.image_size, 1024)
        self._shadows, self._lamps = make_shadows(256), np.zeros((1024, LAMP_NUMBERS))

    def render(self, scene: Scene, out: NDArray[np.uint8]) -> None:
        """Writes the pictures, r g b, into `out` (C, 3, H, W)."""
        pose, count, level, light = self._frame(scene)
        things = self._near.things
        if count > len(self._shadows.corners):
            self._shadows, self._lamps = make_shadows(2 * count), np.zeros((4 * count, LAMP_NUMBERS))
        drop = backdrop(self.rig, scene.weather, self._tiles.cell)
        fixed = (self._tiles, level, pose, light, _air(scene, self.rig.image_size), drop)
        pictures(self._lenses, self._meshes, things, count, *fixed, self._shadows, self._lamps, self._canvas, out)

    def truth(self, scene: Scene) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
        """Depth along the optical axis (C, H, W), metres, inf in the sky; classes (C, H, W) as `BEV_CLASSES`."""
        depth, semantics, _ = self.full_truth(scene)
        return depth, semantics

    def full_truth(self, scene: Scene) -> tuple[NDArray[np.float32], NDArray[np.uint8], NDArray[np.int32]]:
        """As `truth`, and which actor each pixel shows (C, H, W), -1 for none."""
        shape = (len(self.rig.cameras), *self.rig.image_size)
        depth, semantics = np.empty(shape, np.float32), np.empty(shape, np.uint8)
        instances = np.empty(shape, np.int32)
        pose, count, level, light = self._frame(scene)
        drop = backdrop(self.rig, scene.weather, self._tiles.cell)
        fixed = (self._lenses, drop, self._tiles, level, pose, self._near.things, self._canvas)
        for i in range(shape[0]):
            draw(i, self._lenses, self._meshes, self._near.things, count, light, self._canvas)
            read_truth(i, *fixed, depth[i], semantics[i], instances[i])
        return depth, semantics, instances

    def _frame(self, scene: Scene) -> tuple[NDArray[np.float64], int, int, NDArray[np.float64]]:
        """Gathers what is near: the ego's pose, how many things, the ground level, the light in the ego frame."""
        pose, count, level = self._near.collect(scene, SIGHT)
        faces = int(self._faces_of[self._near.things.label[:count, SHAPE]].sum())
        if faces > len(self._canvas.style):
            self._canvas = make_canvas(self.rig.image_size, 2 * faces)
        return pose, count, level, light_of(scene.weather, float(pose[2]), float(pose[3]))


def _air(scene: Scene, size: tuple[int, int]) -> Air:
    """The weather's part in the pictures. Rain depends on where everything is, so that equal scenes look equal."""
    weather, ego = scene.weather, scene.ego
    seed = 0
    if weather.streaks:
        where = (ego.x, ego.y, ego.heading, float(scene.actors.x.sum()), float(scene.actors.y.sum()))
        seed = zlib.crc32(np.array(where, np.float64).tobytes())
    return Air(
        shadows=weather.shadow < 1.0,
        slanted=weather.cast,
        low_sun=weather.cast and weather.sun[2] < 0.5,
        glare=weather.glare,
        wetness=weather.wetness,
        streaks=weather.streaks * size[0] * size[1] // (128 * 352),
        seed=seed,
    )


def _lenses(rig: Rig) -> Lenses:
    poses = np.array([camera.camera_to_ego() for camera in rig.cameras], np.float64)
    return Lenses(
        rotation=np.ascontiguousarray(poses[:, :3, :3].transpose(0, 2, 1)),
        position=np.ascontiguousarray(poses[:, :3, 3]),
        pinhole=np.array([(c.fx, c.fy, c.cx, c.cy) for c in rig.cameras], np.float64),
    )

"""What would be seen from elsewhere, in another size, in other clothes: for eyes that learn more than one town."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from me3bev_cli.api import Rig, View
from me3bev_plugins.simulator.highway.bev import bev_semantics
from me3bev_plugins.simulator.highway.cameras import Cameras
from me3bev_plugins.simulator.highway.dress import dressed
from me3bev_plugins.simulator.highway.rig import shrunk
from me3bev_plugins.simulator.highway.scene import Scene
from me3bev_plugins.simulator.highway.town import Town


class Views:
    """Looks at scenes of one town; cameras are made when they are first looked through.

    Args:
        cameras: of the town as it is.
    """

    def __init__(self, town: Town, rig: Rig, cameras: Cameras) -> None:
        self.town, self.rig = town, rig
        self._towns = {0: town}
        self._cameras = {(1.0, 0): cameras}

    def look(self, scene: Scene, ahead: float, left: float, turn: float, scale: float, dress: int) -> View:
        """See `TownEnv.look_from`."""
        here = scene.ego
        c, s = math.cos(here.heading), math.sin(here.heading)
        x, y = here.x + c * ahead - s * left, here.y + s * ahead + c * left
        town = self._dressed(dress)
        scene = replace(scene, town=town, ego=replace(here, x=x, y=y, heading=here.heading + turn))
        key = scale, dress
        if key not in self._cameras:
            self._cameras[key] = Cameras(town, self.rig if scale == 1.0 else shrunk(self.rig, scale))
        cameras = self._cameras[key]
        images = np.empty((len(self.rig.cameras), 3, *self.rig.image_size), np.uint8)
        cameras.render(scene, images)
        depth, classes = cameras.truth(scene)
        return View(images, depth * np.float32(scale), classes, bev_semantics(scene, cell=0.5 / scale))

    def _dressed(self, dress: int) -> Town:
        if dress not in self._towns:
            self._towns[dress] = dressed(self.town, dress)
        return self._towns[dress]

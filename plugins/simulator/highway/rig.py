"""The surround rig: six calibrated pinhole cameras that look all around the ego."""

from __future__ import annotations

import math

from me3bev_cli.api import CAMERA_NAMES, Camera, ObservationConfig, Rig
from me3bev_cli.errors import unknown_name

FIELD_OF_VIEW = math.radians(70.0)
"""Horizontal; neighbours are 60 degrees apart, so each pair shares 10 degrees."""
HORIZON = 0.38
"""Height of the horizon in the image as a share of H: more road than sky."""
MOUNTS: dict[str, tuple[tuple[float, float, float], float]] = {
    "front_left": ((0.7, 0.6, 1.7), 60.0),
    "front": ((1.0, 0.0, 1.7), 0.0),
    "front_right": ((0.7, -0.6, 1.7), -60.0),
    "back_left": ((-0.9, 0.6, 1.7), 120.0),
    "back": ((-1.3, 0.0, 1.7), 180.0),
    "back_right": ((-0.9, -0.6, 1.7), -120.0),
}
"""Position in the ego frame (metres) and yaw (degrees): at the roof's edges, so the own body stays out of view."""


def surround_rig(observation: ObservationConfig) -> Rig:
    """The cameras that `observation` names, in its order, with square pixels.

    Raises:
        UserError: for a camera that the rig does not have.
    """
    return Rig(cameras=tuple(_camera(name, observation.width, observation.height) for name in observation.cameras))


def shrunk(rig: Rig, scale: float) -> Rig:
    """The rig at 1 / `scale` of its size: to it the world looks `scale` times as large."""
    places = [camera.position for camera in rig.cameras]
    smaller = [(x / scale, y / scale, z / scale) for x, y, z in places]
    return Rig(
        cameras=tuple(
            camera.model_copy(update={"position": place}) for camera, place in zip(rig.cameras, smaller, strict=True)
        )
    )


def _camera(name: str, width: int, height: int) -> Camera:
    if name not in MOUNTS:
        raise unknown_name("camera", name, CAMERA_NAMES, where="observation.cameras")
    position, yaw = MOUNTS[name]
    focal = 0.5 * width / math.tan(0.5 * FIELD_OF_VIEW)
    return Camera(
        name=name,
        width=width,
        height=height,
        fx=focal,
        fy=focal,
        cx=0.5 * width,
        cy=HORIZON * height,
        position=position,
        yaw=math.radians(yaw),
    )

"""Calibrated cameras and what an observation holds."""

from __future__ import annotations

import math
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field

CAMERA_NAMES = ("front_left", "front", "front_right", "back_left", "back", "back_right")
"""The surround rig, in the order of the image tensor's first axis."""

Matrix = tuple[tuple[float, ...], ...]


class Camera(BaseModel):
    """One calibrated pinhole camera.

    Pixel (row v, column u) has its centre at (u + 0.5, v + 0.5). Mounted at `position` in the ego frame
    and turned by `yaw` (about z, left positive), then `pitch` (nose up positive).
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    name: str
    width: int = Field(gt=0, description="pixels")
    height: int = Field(gt=0, description="pixels")
    fx: float = Field(gt=0, description="focal length, pixels")
    fy: float = Field(gt=0, description="focal length, pixels")
    cx: float = Field(description="principal point, pixels")
    cy: float = Field(description="principal point, pixels")
    position: tuple[float, float, float] = Field(description="in the ego frame, metres")
    yaw: float = Field(description="radians, left positive")
    pitch: float = Field(default=0.0, description="radians, up positive")

    def intrinsics(self) -> Matrix:
        """K (3 x 3): camera frame -> pixels."""
        return ((self.fx, 0.0, self.cx), (0.0, self.fy, self.cy), (0.0, 0.0, 1.0))

    def camera_to_ego(self) -> Matrix:
        """The extrinsics (4 x 4): camera frame -> ego frame."""
        sy, cy = math.sin(self.yaw), math.cos(self.yaw)
        sp, cp = math.sin(self.pitch), math.cos(self.pitch)
        right = (sy, -cy, 0.0)
        down = (cy * sp, sy * sp, -cp)
        forward = (cy * cp, sy * cp, sp)
        rows = zip(right, down, forward, self.position, strict=True)
        return (*(tuple(row) for row in rows), (0.0, 0.0, 0.0, 1.0))


class Rig(BaseModel):
    """The cameras that an observation holds, in the order of the image tensor. All of one size."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    cameras: tuple[Camera, ...] = Field(min_length=1)

    @property
    def image_size(self) -> tuple[int, int]:
        """(H, W), pixels."""
        return self.cameras[0].height, self.cameras[0].width


class ObservationConfig(BaseModel):
    """What the policy is given at each step (Section 3.1)."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    cameras: tuple[str, ...] = Field(
        default=CAMERA_NAMES, min_length=1, description="which cameras of the surround rig, in order"
    )
    height: int = Field(default=128, ge=16, le=2048, description="image height, pixels")
    width: int = Field(default=352, ge=16, le=4096, description="image width, pixels")
    navigation: Literal["distance", "offset"] = Field(
        default="distance",
        description=(
            "N(5). distance: metres to each of the next five waypoints (the baseline's). offset: the next "
            "waypoints in the ego frame: y of the 1st, x and y of the 3rd, x and y of the 5th, metres"
        ),
    )
    waypoint_spacing: float = Field(default=5.0, gt=0.2, le=50, description="metres between waypoints")

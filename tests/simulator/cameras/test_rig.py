"""The rig: names, order, calibration."""

import math

import numpy as np
import pytest

from me3bev_cli.api import CAMERA_NAMES, ObservationConfig
from me3bev_cli.errors import UserError
from me3bev_plugins.simulator.highway.rig import surround_rig


def test_six_cameras_look_all_around():
    rig = surround_rig(ObservationConfig())
    assert tuple(camera.name for camera in rig.cameras) == CAMERA_NAMES
    assert rig.image_size == (128, 352)
    yaws = [round(math.degrees(camera.yaw)) for camera in rig.cameras]
    assert yaws == [60, 0, -60, 120, 180, -120]


def test_calibration():
    front = surround_rig(ObservationConfig(height=100, width=400)).cameras[1]
    assert front.fx == front.fy == pytest.approx(200 / math.tan(math.radians(35)))
    assert (front.cx, front.cy) == (200.0, pytest.approx(38.0))
    assert front.position[2] == 1.7
    forward = np.array(front.camera_to_ego())[:3, 2]
    np.testing.assert_allclose(forward, (1, 0, 0), atol=1e-12)


def test_own_car_is_out_of_view():
    for camera in surround_rig(ObservationConfig()).cameras:
        at, turn = np.array(camera.position), np.array(camera.camera_to_ego())[:3, :3]
        corners = np.array([(x, y, 1.0) for x in (-2.35, 2.35) for y in (-0.95, 0.95)])
        x, y, z = turn.T @ (corners - at).T
        u, v = camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy
        seen = (z > 0.15) & (u > 0) & (u < camera.width) & (v > 0) & (v < camera.height)
        assert not seen.any()


def test_subset_keeps_its_order():
    rig = surround_rig(ObservationConfig(cameras=("back", "front"), height=64, width=176))
    assert [camera.name for camera in rig.cameras] == ["back", "front"]


def test_unknown_camera_is_named_with_what_is_allowed():
    with pytest.raises(UserError, match=r"unknown camera 'fron'; did you mean 'front'\?.*Allowed: back, back_left"):
        surround_rig(ObservationConfig(cameras=("fron",)))

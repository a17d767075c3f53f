"""Where things appear: projection, depth of the ground, sides, neighbours, states."""

import numpy as np
import pytest

from me3bev_cli.api import BEV_CLASSES, Camera, ObservationConfig
from me3bev_plugins.simulator.highway.cameras import Cameras
from me3bev_plugins.simulator.highway.rig import surround_rig
from me3bev_plugins.simulator.highway.scene import Kind, Light

VEHICLE = BEV_CLASSES.index("vehicle")
ORDER = ("front_left", "front", "front_right", "back_left", "back", "back_right")


def cameras_of(town, **size):
    return Cameras(town, surround_rig(ObservationConfig(**size)))


def project(camera: Camera, points: np.ndarray) -> np.ndarray:
    """Ego-frame points (N, 3) to u, v, z (N, 3)."""
    inverse = np.linalg.inv(np.array(camera.camera_to_ego()))
    inside = inverse @ np.concatenate([points, np.ones((len(points), 1))], axis=1).T
    pixels = np.array(camera.intrinsics()) @ inside[:3]
    return np.stack([pixels[0] / pixels[2], pixels[1] / pixels[2], pixels[2]], axis=1)


@pytest.mark.parametrize("size", [{}, {"height": 64, "width": 176}, {"height": 90, "width": 90}])
def test_projected_box_covers_its_pixels(street, scene_of, size):
    cameras = cameras_of(street, **size)
    at = {"front": (15.0, 0.0), "front_left": (6.0, 10.0), "back_right": (-8.0, -12.0), "back": (-20.0, 2.0)}
    for name, (x, y) in at.items():
        scene = scene_of(street, [(x, y - 1.75, 0.4, Kind.VAN)])
        depth, semantics, instances = cameras.full_truth(scene)
        index = ORDER.index(name)
        camera = cameras.rig.cameras[index]
        u, v, z = project(camera, np.array([(x, y, 1.0)]))[0]
        row, column = int(v), int(u)
        assert instances[index, row, column] == 0
        assert semantics[index, row, column] == VEHICLE
        assert 0 < z - depth[index, row, column] < 3.0
        c, s = np.cos(0.4), np.sin(0.4)
        box = [(a * 2.6, b * 1.0) for a in (-1, 1) for b in (-1, 1)]
        corners = np.array([(x + c * a - s * b, y + s * a + c * b, h) for a, b in box for h in (0.0, 2.3)])
        pixels = project(camera, corners)
        rows, columns = np.nonzero(instances[index] == 0)
        assert rows.min() >= pixels[:, 1].min() - 1
        assert rows.max() <= pixels[:, 1].max() + 1
        assert columns.min() >= pixels[:, 0].min() - 1
        assert columns.max() <= pixels[:, 0].max() + 1
        assert columns.max() - columns.min() > 0.9 * (np.ptp(pixels[:, 0])) - 2


def test_depth_of_the_ground_is_that_of_the_plane(street, scene_of):
    cameras = cameras_of(street)
    depth, _ = cameras.truth(scene_of(street, [], ego=(-100.0, -1.75, 0.3)))
    for camera, image in zip(cameras.rig.cameras, depth, strict=True):
        v = np.arange(camera.height) + 0.5
        below = v > camera.cy + 1
        expected = camera.position[2] * camera.fy / (v[below] - camera.cy)
        column = image[below, 10]
        near = column < 0.999 * expected
        np.testing.assert_allclose(column[~near], expected[~near], rtol=0.01)
        assert near.mean() < 0.2
    assert np.isinf(depth[1, 0, 200])


def test_left_is_left(street, scene_of):
    cameras = cameras_of(street)
    scene = scene_of(street, [(9.0, 12.0, 0.0, Kind.TRUCK)])
    _, semantics = cameras.truth(scene)
    seen = dict(zip(ORDER, (semantics == VEHICLE).sum((1, 2)), strict=True))
    assert seen["front_left"] > 200
    assert seen["front_right"] == seen["back_right"] == seen["back"] == 0


def test_what_leaves_one_camera_enters_its_neighbour(street, scene_of):
    """A pedestrian walking round the car is in view all the time, and in two cameras only where they overlap."""
    cameras = cameras_of(street)
    around = ("front", "front_left", "back_left", "back", "back_right", "front_right")
    for degrees in range(0, 360, 5):
        turn = np.radians(degrees)
        scene = scene_of(street, [(8 * np.cos(turn), 8 * np.sin(turn) - 1.75, 0.0, Kind.PEDESTRIAN)])
        _, _, instances = cameras.full_truth(scene)
        seen = {name for name, image in zip(ORDER, instances, strict=True) if (image == 0).any()}
        assert 1 <= len(seen) <= 2
        if len(seen) == 2:
            a, b = sorted(around.index(name) for name in seen)
            assert b - a in (1, 5)


def test_signal_state_changes_its_pixels(street, scene_of):
    cameras = cameras_of(street)
    scene = scene_of(street, [], ego=(20.0, -1.75, 0.0))
    pictures = {}
    for light in (Light.RED, Light.AMBER, Light.GREEN, Light.OFF):
        scene.lights[:] = light
        pictures[light] = np.zeros((6, 3, 128, 352), np.uint8)
        cameras.render(scene, pictures[light])
    off = pictures[Light.OFF].astype(int)
    for light, channel in ((Light.RED, 0), (Light.GREEN, 1)):
        changed = pictures[light].astype(int) - off
        lamp = (np.abs(changed[1]).max(0) > 60).sum()
        assert 4 <= lamp < 200
        assert changed[1, channel].max() > 150
    assert (pictures[Light.RED] != pictures[Light.GREEN]).any()
    assert (pictures[Light.AMBER] != pictures[Light.RED]).any()


def test_signal_heads_show_nothing_to_those_they_do_not_govern(street, scene_of):
    """From behind the head, red and green look the same."""
    cameras = cameras_of(street)
    scene = scene_of(street, [], ego=(60.0, 1.75, np.pi))
    images = []
    for light in (Light.RED, Light.GREEN):
        scene.lights[:] = light
        images.append(np.zeros((6, 3, 128, 352), np.uint8))
        cameras.render(scene, images[-1])
    np.testing.assert_array_equal(images[0], images[1])


def test_braking_lights_up_the_rear(street, scene_of):
    cameras = cameras_of(street)
    scene = scene_of(street, [(12.0, -1.75, 0.0, Kind.CAR)])
    before, after = np.zeros((6, 3, 128, 352), np.uint8), np.zeros((6, 3, 128, 352), np.uint8)
    cameras.render(scene, before)
    scene.actors.braking[:] = True
    cameras.render(scene, after)
    changed = after.astype(int) - before
    assert changed[1, 0].max() > 60
    assert not changed[[0, 2, 3, 4, 5]].any()


def test_road_lines_run_to_the_vanishing_point(street, scene_of):
    """The yellow line (y = 0) and the edge line (y = -3.5) close in on (cx, cy) in the front camera."""
    cameras = cameras_of(street)
    camera = cameras.rig.cameras[1]
    _, semantics = cameras.truth(scene_of(street, [], ego=(-60.0, -1.75, 0.0)))
    marking = semantics[1] == BEV_CLASSES.index("lane_marking")
    for row in range(60, 128, 5):
        z = camera.position[2] * camera.fy / (row + 0.5 - camera.cy)
        columns = np.flatnonzero(marking[row]) + 0.5
        for y in (1.75 - 0.16, -1.75):
            u = camera.cx - camera.fx * y / z
            assert np.abs(columns - u).min() < 1.5 + camera.fx * 0.11 / z

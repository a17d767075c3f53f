"""The pictures: the same bytes every time, any size, any number of actors."""

import numpy as np
import pytest

from me3bev_cli.api import ObservationConfig
from me3bev_plugins.simulator.highway.cameras import Cameras
from me3bev_plugins.simulator.highway.rig import surround_rig
from me3bev_plugins.simulator.highway.scene import Kind


def render(cameras, scene):
    height, width = cameras.rig.image_size
    out = np.zeros((len(cameras.rig.cameras), 3, height, width), np.uint8)
    cameras.render(scene, out)
    return out


def crowd(count, seed=0):
    rng = np.random.default_rng(seed)
    at = rng.uniform((-60, -8, -3), (60, 8, 3), (count, 3))
    return [(x, y, h, Kind(int(k))) for (x, y, h), k in zip(at, rng.integers(0, 5, count), strict=True)]


def test_same_scene_same_bytes(street, town_of, scene_of):
    rig = surround_rig(ObservationConfig())
    scene = scene_of(street, crowd(30))
    first = Cameras(street, rig)
    once = render(first, scene)
    render(first, scene_of(street, crowd(30, 1), ego=(20.0, 1.75, 2.0)))
    np.testing.assert_array_equal(render(first, scene), once)
    np.testing.assert_array_equal(render(Cameras(street, rig), scene), once)
    again = town_of()
    np.testing.assert_array_equal(render(Cameras(again, rig), scene_of(again, crowd(30))), once)


def test_ground_and_scenery_are_shared(street):
    rig = surround_rig(ObservationConfig())
    one, two = Cameras(street, rig), Cameras(street, rig)
    assert one._near.ground is two._near.ground
    assert one._near.scenery is two._near.scenery


@pytest.mark.parametrize(("height", "width"), [(16, 16), (64, 176), (128, 352), (300, 200)])
def test_other_sizes_and_subsets(street, scene_of, height, width):
    rig = surround_rig(ObservationConfig(cameras=("back", "front"), height=height, width=width))
    whole = Cameras(street, surround_rig(ObservationConfig(height=height, width=width)))
    scene = scene_of(street, crowd(20))
    out = render(Cameras(street, rig), scene)
    np.testing.assert_array_equal(out, render(whole, scene)[[4, 1]])
    assert out.std() > 10


def test_many_actors_and_none(street, scene_of):
    cameras = Cameras(street, surround_rig(ObservationConfig(height=32, width=88)))
    render(cameras, scene_of(street, []))
    render(cameras, scene_of(street, crowd(900)))


def test_inside_another_vehicle_nothing_breaks(street, scene_of):
    cameras = Cameras(street, surround_rig(ObservationConfig()))
    scene = scene_of(street, [(x, -1.75, 0.2, Kind.TRUCK) for x in (-2.0, 0.0, 1.0, 3.0)])
    render(cameras, scene)
    depth, _ = cameras.truth(scene)
    assert depth.min() > 0.14


def test_off_the_map_there_is_grass(street, scene_of):
    cameras = Cameras(street, surround_rig(ObservationConfig()))
    out = render(cameras, scene_of(street, [], ego=(5000.0, -9000.0, 1.0)))
    below = out[:, :, 100:].astype(int)
    assert (below[:, 1] > below[:, 0]).all()
    assert (below[:, 1] > below[:, 2]).all()

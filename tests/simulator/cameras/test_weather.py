"""Weather: its names and what each draws."""

import subprocess
import sys
import zlib
from pathlib import Path

import numpy as np
import pytest

from me3bev_cli.api import BEV_CLASSES, ObservationConfig
from me3bev_cli.errors import UserError
from me3bev_plugins.simulator.highway.bev import bev_semantics
from me3bev_plugins.simulator.highway.cameras import Cameras
from me3bev_plugins.simulator.highway.rig import surround_rig
from me3bev_plugins.simulator.highway.scene import Kind
from me3bev_plugins.simulator.highway.weather import WEATHERS, weather_named


def test_every_name_has_a_weather():
    assert WEATHERS[0] == "clear_noon"
    for name in WEATHERS:
        weather = weather_named(name)
        assert weather.name == name
        assert sum(part * part for part in weather.sun) == pytest.approx(1.0, abs=1e-3)


def test_unknown_weather_is_refused_with_the_nearest_name():
    with pytest.raises(UserError, match="did you mean 'cloudy'"):
        weather_named("clowdy")


def test_a_scene_is_at_clear_noon_unless_told(street, scene_of):
    assert scene_of(street, []).weather is weather_named("clear_noon")


def render(cameras, scene, name):
    scene.weather = weather_named(name)
    out = np.zeros((6, 3, *cameras.rig.image_size), np.uint8)
    cameras.render(scene, out)
    return out


@pytest.fixture(scope="module")
def view(street, scene_of):
    """Cameras and a scene with vehicles, people, a light, a tree and a lamp."""
    rows = [(12.0, -1.75, 0.0, Kind.CAR), (18.0, 1.75, np.pi, Kind.VAN), (9.0, 5.0, 1.0, Kind.PEDESTRIAN)]
    return Cameras(street, surround_rig(ObservationConfig())), scene_of(street, rows)


@pytest.mark.parametrize("name", WEATHERS)
def test_same_scene_same_bytes_in_every_weather(view, name):
    cameras, scene = view
    once = render(cameras, scene, name)
    render(cameras, scene, "night")
    np.testing.assert_array_equal(render(cameras, scene, name), once)
    again = Cameras(scene.town, cameras.rig)
    np.testing.assert_array_equal(render(again, scene, name), once)


def test_no_two_weathers_look_alike(view):
    pictures = [render(*view, name).astype(int) for name in WEATHERS]
    for i, one in enumerate(pictures):
        for other in pictures[:i]:
            assert np.abs(one - other).mean() > 2.0


def test_truth_does_not_depend_on_the_weather(view):
    cameras, scene = view
    truths = []
    for name in WEATHERS:
        scene.weather = weather_named(name)
        truths.append((*cameras.full_truth(scene), bev_semantics(scene)))
    for truth in truths[1:]:
        for one, other in zip(truth, truths[0], strict=True):
            np.testing.assert_array_equal(one, other)


def test_night_is_dark_but_for_lamps(view):
    cameras, scene = view
    noon, night = render(cameras, scene, "clear_noon").astype(int), render(cameras, scene, "night").astype(int)
    assert night.mean() < 0.45 * noon.mean()
    depth, _ = cameras.truth(scene)
    near, behind = (depth[1] < 9.0), (depth[4] < 9.0)
    assert night[1][:, near].mean() > 2.0 * night[4][:, behind].mean()
    van = cameras.full_truth(scene)[2][1] == 1
    assert night[1][:, van].max() > 230


def test_fog_hides_what_is_far(view):
    cameras, scene = view
    depth, _ = cameras.truth(scene)
    noon, fog = render(cameras, scene, "clear_noon").astype(float), render(cameras, scene, "fog").astype(float)
    far, near = (depth[1] > 90) & np.isfinite(depth[1]), depth[1] < 10
    for where, least, most in ((far, 0.0, 0.5), (near, 0.5, 1.2)):
        assert least <= fog[1][:, where].std() / noon[1][:, where].std() <= most


def test_shadows_fall_away_from_the_sun(street, scene_of):
    """At clear noon the sun stands in the north-east: the ground south-west of a truck is darker than in the cloud."""
    cameras = Cameras(street, surround_rig(ObservationConfig()))
    out = {}
    for rows in ((), ((14.0, 2.0, 0.0, Kind.TRUCK),)):
        picture = render(cameras, scene_of(street, list(rows)), "clear_noon")[1].astype(int)
        out[len(rows)] = picture
    _, semantics = cameras.truth(scene_of(street, [(14.0, 2.0, 0.0, Kind.TRUCK)]))
    darker = (out[0] - out[1]).min(0) > 12
    ground = np.isin(semantics[1], [BEV_CLASSES.index("road"), BEV_CLASSES.index("lane_marking")])
    assert (darker & ground).sum() > 200
    assert ((out[1] - out[0]).max(0)[ground] <= 0).all()
    _, columns = np.nonzero(darker & ground)
    _, truck = np.nonzero(semantics[1] == BEV_CLASSES.index("vehicle"))
    assert columns.mean() > truck.mean()


def test_rain_moves_with_the_world(view, street, scene_of):
    cameras, scene = view
    once = render(cameras, scene, "rain")
    other = scene_of(street, [(12.0, -1.75, 0.0, Kind.CAR), (18.1, 1.75, np.pi, Kind.VAN)])
    sky = (slice(None), slice(None), slice(0, 20))
    assert (render(cameras, other, "rain")[sky] != once[sky]).any()


_OTHER_PROCESS = """
import zlib, numpy as np
from conftest import make_scene, make_town
from me3bev_cli.api import ObservationConfig
from me3bev_plugins.simulator.highway.cameras import Cameras
from me3bev_plugins.simulator.highway.rig import surround_rig
from me3bev_plugins.simulator.highway.scene import Kind
from me3bev_plugins.simulator.highway.weather import WEATHERS, weather_named
scene = make_scene(make_town(), [(12.0, -1.75, 0.0, Kind.CAR), (9.0, 5.0, 1.0, Kind.PEDESTRIAN)])
out = np.zeros((6, 3, 64, 176), np.uint8)
cameras = Cameras(scene.town, surround_rig(ObservationConfig(height=64, width=176)))
for name in WEATHERS:
    scene.weather = weather_named(name)
    cameras.render(scene, out)
    print(zlib.crc32(out.tobytes()))
"""


def test_another_process_draws_the_same_bytes(town_of, scene_of):
    told = subprocess.run(
        [sys.executable, "-c", _OTHER_PROCESS], cwd=Path(__file__).parent, capture_output=True, text=True, check=True
    )
    scene = scene_of(town_of(), [(12.0, -1.75, 0.0, Kind.CAR), (9.0, 5.0, 1.0, Kind.PEDESTRIAN)])
    cameras = Cameras(scene.town, surround_rig(ObservationConfig(height=64, width=176)))
    own = [zlib.crc32(render(cameras, scene, name).tobytes()) for name in WEATHERS]
    assert [int(line) for line in told.stdout.split()] == own

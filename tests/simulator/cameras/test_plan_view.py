"""The plan for people."""

import numpy as np

from me3bev_plugins.simulator.highway.plan_view import AHEAD, EGO, LAMPS, METRES, ROUTE, plan_image, plan_view
from me3bev_plugins.simulator.highway.scene import Kind, Light


def test_plan_shows_ego_route_vehicles_and_lights(street, scene_of):
    scene = scene_of(street, [(20.0, 8.25, 0.0, Kind.TRUCK)], ego=(20.0, -1.75, 0.0))
    scene.lights[:] = Light.GREEN
    image = plan_image(scene, route=np.array([(20.0, -1.75), (60.0, -1.75)]), pixels=400, metres=80.0)
    assert image.shape == (400, 400, 3)
    assert image.dtype == np.uint8

    def at(x: float, y: float) -> tuple[int, ...]:
        return tuple(int(v) for v in image[int(200 - 5 * x), int(200 - 5 * y)])

    assert at(-1.5, 0.0) == EGO
    assert at(10.0, 0.0) == ROUTE
    assert at(-2.0, 10.0) == (200, 30, 30)
    red, green, blue = at(20.0, -3.25)
    assert green > red + 80
    assert green > blue + 80


def test_stop_lines_have_the_colour_of_their_light(street, scene_of):
    scene = scene_of(street, [], ego=(20.0, -1.75, 0.0))
    for light, colour in LAMPS.items():
        scene.lights[:] = light
        image = plan_image(scene, pixels=400, metres=80.0)
        # The line ends the lane, 20 m ahead.
        assert tuple(image[100, 195]) == colour


def test_the_middle_may_lie_ahead(street, scene_of):
    image = plan_image(scene_of(street, []), pixels=400, metres=80.0, ahead=10.0)
    assert tuple(image[200 + 5 * 10 + 7, 200]) == EGO


def test_a_plan_view_is_as_large_as_asked_for(street, scene_of):
    scene = scene_of(street, [])
    route = np.array([(0.0, -1.75, 0.0), (60.0, -1.75, 0.0)])
    view = plan_view(scene, route, 300)
    assert (view.shape, view.dtype) == ((300, 300, 3), np.uint8)
    scale = 300 / METRES
    assert np.abs(view[int(150 + (AHEAD - 20) * scale), 150].astype(int) - ROUTE).max() < 10
    # A route that is driven to its end is no line.
    assert plan_view(scene, route[:0], 64).shape == (64, 64, 3)

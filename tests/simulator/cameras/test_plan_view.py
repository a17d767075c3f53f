"""The plan for people."""

import numpy as np

from me3bev_plugins.simulator.highway.plan_view import EGO, ROUTE, plan_image
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

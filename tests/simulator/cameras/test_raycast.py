"""Depth and classes of random scenes against a brute-force ray caster that shares no code with the rasteriser."""

import numpy as np
import pytest

from me3bev_cli.api import BEV_CLASSES, ObservationConfig
from me3bev_plugins.simulator.highway.cameras import Cameras
from me3bev_plugins.simulator.highway.geometry import Shape, meshes
from me3bev_plugins.simulator.highway.materials import Role
from me3bev_plugins.simulator.highway.rig import surround_rig
from me3bev_plugins.simulator.highway.scene import Kind, Scene
from me3bev_plugins.simulator.highway.town import Building

SIZE = (48, 132)
ROAD, SIDEWALK = BEV_CLASSES.index("road"), BEV_CLASSES.index("sidewalk")
BUILDING, VEHICLE, PEDESTRIAN = (BEV_CLASSES.index(name) for name in ("building", "vehicle", "pedestrian"))


def rays(camera):
    """Origin (3,) and directions (H * W, 3) in the ego frame, one metre deep along the optical axis."""
    v, u = np.mgrid[0 : camera.height, 0 : camera.width] + 0.5
    flat = np.stack([u.ravel(), v.ravel(), np.ones(u.size)])
    pose = np.array(camera.camera_to_ego())
    return pose[:3, 3], (pose[:3, :3] @ np.linalg.inv(np.array(camera.intrinsics())) @ flat).T


def hit_box(origin, directions, centre, size, heading):
    """Entry distance of rays into a box that stands on the ground (slab method); inf for a miss."""
    c, s = np.cos(heading), np.sin(heading)
    turn = np.array([(c, s, 0.0), (-s, c, 0.0), (0.0, 0.0, 1.0)])
    start, way = turn @ (origin - np.array((*centre, 0.0))), directions @ turn.T
    half = np.array((size[0] / 2, size[1] / 2, size[2]))
    low = np.array((-half[0], -half[1], 0.0))
    with np.errstate(divide="ignore"):
        one, two = (low - start) / way, (half - start) / way
    enter, leave = np.minimum(one, two).max(1), np.maximum(one, two).min(1)
    return np.where((enter < leave) & (enter > 0.15), enter, np.inf)


def hit_triangle(origin, directions, a, b, c):
    """Distance of rays to a triangle seen from its front (Moller and Trumbore); inf for a miss."""
    e1, e2 = b - a, c - a
    p = np.cross(directions, e2)
    det = p @ e1
    front = det > 1e-12
    with np.errstate(divide="ignore", invalid="ignore"):
        t = origin - a
        u = p @ t / det
        q = np.cross(t, e1)
        v = directions @ q / det
        distance = e2 @ q / det
        inside = front & (u >= 0) & (v >= 0) & (u + v <= 1) & (distance > 0.15)
    return np.where(inside, distance, np.inf)


def actor_triangles(actors, i, ego):
    """The triangles (N, 3, 3) of an actor's mesh in the ego frame, without its shadow."""
    mesh, shape = meshes(), Shape(int(actors.kind[i]))
    c, s = np.cos(actors.heading[i]), np.sin(actors.heading[i])
    first, end = mesh.vertex_start[shape], mesh.vertex_start[shape + 1]
    points = mesh.vertex[first:end] * (actors.length[i], actors.width[i], actors.height[i])
    x, y = actors.x[i] + c * points[:, 0] - s * points[:, 1], actors.y[i] + s * points[:, 0] + c * points[:, 1]
    c, s = np.cos(ego.heading), np.sin(ego.heading)
    dx, dy = x - ego.x, y - ego.y
    local = np.stack([c * dx + s * dy, c * dy - s * dx, points[:, 2]], axis=1)
    triangles = []
    for face in range(mesh.face_start[shape], mesh.face_start[shape + 1]):
        if mesh.role[face] != Role.SHADOW:
            corner = mesh.corner[face]
            triangles += [local[[corner[0], corner[k], corner[k + 1]]] for k in range(1, mesh.corners[face] - 1)]
    return np.array(triangles)


def cast(scene: Scene, camera):
    """Depth and class of every pixel, (H, W) each."""
    ego, actors = scene.ego, scene.actors
    origin, directions = rays(camera)
    with np.errstate(divide="ignore"):
        depth = np.where(directions[:, 2] < 0, -origin[2] / directions[:, 2], np.inf)
    near = np.where(np.isinf(depth), 0.0, depth)
    c, s = np.cos(ego.heading), np.sin(ego.heading)
    x, y = (origin + directions * near[:, None])[:, :2].T
    wx, wy = ego.x + c * x - s * y, ego.y + s * x + c * y
    across, on_map = np.abs(wy), (np.abs(wx) < 150) & np.isfinite(depth)
    semantics = np.where(on_map & (across < 4), ROAD, np.where(on_map & (across > 4) & (across < 6), SIDEWALK, 0))
    found = []
    for building in scene.town.buildings:
        dx, dy = building.centre[0] - ego.x, building.centre[1] - ego.y
        centre, size = (c * dx + s * dy, c * dy - s * dx), (*building.size, building.height)
        found.append((hit_box(origin, directions, centre, size, building.heading - ego.heading), BUILDING))
    for i in range(len(actors)):
        label = PEDESTRIAN if actors.kind[i] == Kind.PEDESTRIAN else VEHICLE
        found += [(hit_triangle(origin, directions, *corners), label) for corners in actor_triangles(actors, i, ego)]
    for distance, label in found:
        semantics = np.where(distance < depth, label, semantics)
        depth = np.minimum(depth, distance)
    return depth.reshape(camera.height, camera.width), semantics.reshape(camera.height, camera.width)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_truth_is_what_rays_hit(town_of, scene_of, seed):
    rng = np.random.default_rng(seed)
    buildings = tuple(
        Building(
            (float(rng.uniform(-50, 50)), float(side * rng.uniform(14, 40))),
            (float(rng.uniform(6, 16)), float(rng.uniform(6, 16))),
            float(rng.uniform(0, 3)),
            float(rng.uniform(4, 25)),
            (150, 140, 130),
        )
        for side in (-1, 1)
        for _ in range(6)
    )
    town = town_of(markings=False, buildings=buildings)
    rows = []
    while len(rows) < 16:
        x, y = rng.uniform(-25, 25), rng.uniform(-6, 6)
        if np.hypot(x, y + 1.75) > 4.5:
            rows.append((x, y, rng.uniform(-3, 3), Kind(int(rng.integers(5)))))
    scene = scene_of(town, rows, ego=(0.0, -1.75, float(rng.uniform(-3, 3))))
    cameras = Cameras(town, surround_rig(ObservationConfig(height=SIZE[0], width=SIZE[1])))
    depth, semantics = cameras.truth(scene)
    same, count = 0, 0
    for camera, drawn_depth, drawn in zip(cameras.rig.cameras, depth, semantics, strict=True):
        expected_depth, expected = cast(scene, camera)
        agree = drawn == expected
        same, count = same + agree.sum(), count + agree.size
        sky = np.isinf(expected_depth)
        np.testing.assert_array_equal(np.isinf(drawn_depth[agree]), sky[agree])
        both = agree & ~sky
        error = np.abs(drawn_depth[both] / expected_depth[both] - 1)
        assert (error < 0.02).mean() > 0.999
    assert same / count >= 0.995

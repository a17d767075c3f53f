"""Depth and classes of random scenes against a brute-force ray caster that shares no code with the rasteriser."""

from dataclasses import replace

import numpy as np
import pytest

from me3bev_cli.api import BEV_CLASSES, ObservationConfig
from me3bev_plugins.simulator.highway.bev import bev_semantics
from me3bev_plugins.simulator.highway.camera_scenery import scenery_of
from me3bev_plugins.simulator.highway.camera_things import shape_of
from me3bev_plugins.simulator.highway.cameras import Cameras
from me3bev_plugins.simulator.highway.geometry import meshes
from me3bev_plugins.simulator.highway.ground import ground_of
from me3bev_plugins.simulator.highway.ground_levels import hidden
from me3bev_plugins.simulator.highway.ground_tiles import SEMANTIC as GROUND
from me3bev_plugins.simulator.highway.ground_tiles import lookup
from me3bev_plugins.simulator.highway.raster import BASE, COS, HEIGHT, LENGTH, SEMANTIC, SHAPE, SIN, WIDTH, X, Y
from me3bev_plugins.simulator.highway.rig import surround_rig
from me3bev_plugins.simulator.highway.scene import Kind, Scene
from me3bev_plugins.simulator.highway.town import Building, Prop, Sign

VEHICLE, PEDESTRIAN = BEV_CLASSES.index("vehicle"), BEV_CLASSES.index("pedestrian")


def rays(camera):
    """Origin (3,) and directions (H * W, 3) in the ego frame, one metre deep along the optical axis."""
    v, u = np.mgrid[0 : camera.height, 0 : camera.width] + 0.5
    flat = np.stack([u.ravel(), v.ravel(), np.ones(u.size)])
    pose = np.array(camera.camera_to_ego())
    return pose[:3, 3], (pose[:3, :3] @ np.linalg.inv(np.array(camera.intrinsics())) @ flat).T


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


def mesh_triangles(shape, size, pose):
    """The triangles (N, 3, 3) of a mesh of a size at a pose (x, y, z, heading)."""
    mesh = meshes()
    points = mesh.vertex[mesh.vertex_start[shape] : mesh.vertex_start[shape + 1]] * size
    c, s = np.cos(pose[3]), np.sin(pose[3])
    x, y = pose[0] + c * points[:, 0] - s * points[:, 1], pose[1] + s * points[:, 0] + c * points[:, 1]
    placed = np.stack([x, y, pose[2] + points[:, 2]], axis=1)
    triangles = []
    for face in range(mesh.face_start[shape], mesh.face_start[shape + 1]):
        corner = mesh.corner[face]
        triangles += [placed[[corner[0], corner[k], corner[k + 1]]] for k in range(1, mesh.corners[face] - 1)]
    return np.array(triangles)


def world_triangles(scene: Scene, level: int):
    """(triangles (N, 3, 3) in the world, class) of every actor and every standing thing that a ground level shows."""
    actors, scenery, levels = scene.actors, scenery_of(scene.town), ground_of(scene.town).levels
    for i in range(len(actors)):
        if hidden(levels, level, actors.x[i], actors.y[i], actors.z[i]):
            continue
        label = PEDESTRIAN if actors.kind[i] == Kind.PEDESTRIAN else VEHICLE
        size = (actors.length[i], actors.width[i], actors.height[i])
        pose = (actors.x[i], actors.y[i], 0.0, actors.heading[i])
        yield mesh_triangles(shape_of(int(actors.kind[i]), i), size, pose), label
    for number, label, side in zip(scenery.number, scenery.label, scenery.side, strict=True):
        if side in (-1, level):
            pose = (number[X], number[Y], number[BASE], np.arctan2(number[SIN], number[COS]))
            yield mesh_triangles(label[SHAPE], number[[LENGTH, WIDTH, HEIGHT]], pose), label[SEMANTIC]


def ground_class(town, level, x, y):
    """Class of the ground at points (N,) of the world."""
    tiles = ground_of(town).tiles
    column, row = ((at - low) // tiles.cell for at, low in zip((x, y), tiles.origin, strict=True))
    cells = zip(row.astype(int), column.astype(int), strict=True)
    return np.array([GROUND[lookup(tiles.table[level], tiles.data, r, c)] for r, c in cells])


def cast(scene: Scene, camera, level=0):
    """Depth and class of every pixel, (H, W) each."""
    ego = scene.ego
    origin, directions = rays(camera)
    turn = np.array([(np.cos(ego.heading), -np.sin(ego.heading)), (np.sin(ego.heading), np.cos(ego.heading))])
    origin, directions = origin.copy(), directions.copy()
    origin[:2] = turn @ origin[:2] + (ego.x, ego.y)
    directions[:, :2] = directions[:, :2] @ turn.T
    with np.errstate(divide="ignore"):
        depth = np.where(directions[:, 2] < 0, -origin[2] / directions[:, 2], np.inf)
    seen = np.isfinite(depth)
    semantics = np.zeros(len(depth), int)
    x, y = (origin + directions[seen] * depth[seen, None])[:, :2].T
    semantics[seen] = ground_class(scene.town, level, x, y)
    for triangles, label in world_triangles(scene, level):
        for corners in triangles:
            distance = hit_triangle(origin, directions, *corners)
            semantics = np.where(distance < depth, label, semantics)
            depth = np.minimum(depth, distance)
    return depth.reshape(camera.height, camera.width), semantics.reshape(camera.height, camera.width)


def compare(scene: Scene, height, width, level=0):
    """Truth and ray caster agree."""
    cameras = Cameras(scene.town, surround_rig(ObservationConfig(height=height, width=width)))
    depth, semantics = cameras.truth(scene)
    same, count, far_off, compared = 0, 0, 0, 0
    for camera, drawn_depth, drawn in zip(cameras.rig.cameras, depth, semantics, strict=True):
        expected_depth, expected = cast(scene, camera, level)
        agree = drawn == expected
        same, count = same + agree.sum(), count + agree.size
        both = agree & ~np.isinf(expected_depth) & ~np.isinf(drawn_depth)
        error = np.abs(drawn_depth[both] / expected_depth[both] - 1)
        far_off, compared = far_off + (error >= 0.02).sum(), compared + both.sum()
        assert (np.isinf(drawn_depth) == np.isinf(expected_depth)).mean() > 0.995
    assert same / count >= 0.995
    assert far_off / compared < 0.003


def random_rows(rng, count, reach=25.0):
    rows = []
    while len(rows) < count:
        x, y = rng.uniform(-reach, reach), rng.uniform(-6, 6)
        if np.hypot(x, y + 1.75) > 4.5:
            rows.append((x, y, rng.uniform(-3, 3), Kind(len(rows) % 5)))
    return rows


@pytest.mark.parametrize(("seed", "size"), [(1, (48, 132)), (2, (48, 132)), (3, (64, 96)), (4, (90, 90))])
def test_truth_is_what_rays_hit(town_of, scene_of, seed, size):
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
    town = town_of(buildings=buildings)
    props = [Prop("tree", (8.0 * k - 30.0, 9.0), 7.0, 1.5) for k in range(8)]
    signs = tuple(Sign(kind, 0, (x, -6.5, 0.0), 0.4) for kind, x in (("stop", 8.0), ("yield", 14.0)))
    town = replace(town, props=(*town.props, *props), signs=signs)
    scene = scene_of(town, random_rows(rng, 16), ego=(0.0, -1.75, float(rng.uniform(-3, 3))))
    compare(scene, *size)


def test_far_things_are_where_rays_hit_them(street, scene_of):
    """At the distance of the plainer meshes a few pixels of a thing may differ, not more."""
    rng = np.random.default_rng(7)
    compare(scene_of(street, random_rows(rng, 24, reach=110.0)), 64, 176)


@pytest.mark.parametrize("level", [0, 1])
def test_bridges_are_where_rays_hit_them(bridge, scene_of, level):
    """From below the deck with its piers, from above its parapets, and each level's own vehicles."""
    rows = [(18.0, 0.5, 0.1, Kind.CAR), (-16.0, -0.5, 3.0, Kind.TRUCK), (0.5, 9.0, 1.5, Kind.VAN), (9.0, 3.5, 0.0, 4)]
    place = (-12.0, 0.0, 0.2) if level == 0 else (0.0, -13.0, 1.6)
    scene = scene_of(bridge, [(*row[:3], Kind(row[3])) for row in rows], ego=place)
    scene.actors.z[2] = 6.0
    scene.ego.z = 6.0 * level
    compare(scene, 64, 176, level)
    cameras = Cameras(bridge, surround_rig(ObservationConfig()))
    depth, semantics = cameras.truth(scene)
    front = depth[1][(semantics[1] == 0) & np.isfinite(depth[1])]
    assert (front < 14.0).sum() > 200


def test_decks_do_not_hide_the_road_from_the_map(bridge, scene_of):
    scene = scene_of(bridge, [], ego=(-12.0, 0.0, 0.0))
    road = bev_semantics(scene) == BEV_CLASSES.index("road")
    assert road[60:100, 100].all()

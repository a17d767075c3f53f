"""The painted ground: filling, tiles, lines, kerbs, levels."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from me3bev_plugins.simulator.highway.bev import bev_semantics
from me3bev_plugins.simulator.highway.camera_scenery import scenery_of
from me3bev_plugins.simulator.highway.geometry import Shape
from me3bev_plugins.simulator.highway.ground import ground_of
from me3bev_plugins.simulator.highway.ground_levels import hidden, level_of
from me3bev_plugins.simulator.highway.ground_tiles import (
    BASES,
    CODES,
    MIX,
    MIX_FIRST,
    MIX_PARTS,
    OFFSETS,
    PLAIN_TILES,
    RECORD,
    SHADES,
    TILE,
    Paint,
    close_gaps,
    fill_polygons,
    lookup,
)
from me3bev_plugins.simulator.highway.raster import BASE, SHAPE, X, Y
from me3bev_plugins.simulator.highway.scene import Kind
from me3bev_plugins.simulator.highway.town import Lane, Town


def paint_at(town, x, y, level=0):
    tiles = ground_of(town).tiles
    column, row = int((x - tiles.origin[0]) // tiles.cell), int((y - tiles.origin[1]) // tiles.cell)
    return Paint(int(lookup(tiles.table[level], tiles.data, row, column)))


def inside(points, x, y):
    """Even-odd rule by winding through all edges, for every (x, y)."""
    odd = np.zeros(x.shape, bool)
    for (x0, y0), (x1, y1) in zip(points, np.roll(points, -1, 0), strict=True):
        with np.errstate(divide="ignore", invalid="ignore"):
            odd ^= ((y0 <= y) != (y1 <= y)) & (x < x0 + (y - y0) / (y1 - y0) * (x1 - x0))
    return odd


def test_polygons_cover_the_cells_whose_centres_they_hold():
    rng = np.random.default_rng(3)
    y, x = np.mgrid[0:40, 0:50] + 0.5
    for corners in (3, 4, 7):
        points = rng.uniform((-5, -5), (55, 45), (corners, 2))
        raster = np.zeros((40, 50), np.uint8)
        starts = np.array([0, corners])
        fill_polygons(raster, points, starts, np.array([9], np.uint8), np.array([0]), 0)
        np.testing.assert_array_equal(raster == 9, inside(points, x, y))
        lower = np.zeros((20, 50), np.uint8)
        fill_polygons(lower, points, starts, np.array([9], np.uint8), np.array([0]), 20)
        np.testing.assert_array_equal(lower, raster[20:])


def test_classes_across_the_street(street):
    across = {0.16: Paint.YELLOW, 1.75: Paint.ASPHALT, 3.5: Paint.WHITE, 5.0: Paint.SIDEWALK, 8.0: Paint.GRASS}
    for y, paint in across.items():
        assert paint_at(street, -60.3, y) is paint
        assert paint_at(street, -60.3, -y) is paint


def test_the_gutter_between_road_and_kerb_is_asphalt(street):
    assert [paint_at(street, -60.3, y) for y in (3.8, 4.1, 4.3)] == [Paint.ASPHALT, Paint.KERB, Paint.SIDEWALK]
    assert paint_at(street, -60.3, 6.1) is Paint.GRASS
    raster = np.array([[1, 0, 0, 2, 0, 0, 0, 1, 0, 1]] * 2, np.uint8)
    close_gaps(raster, 0, 1, 2, 2)
    np.testing.assert_array_equal(raster[0], [1, 1, 1, 2, 0, 0, 0, 1, 0, 1])
    column = np.array([[2, 0, 1, 0, 0, 2, 0, 0, 0, 1]] * 2, np.uint8).T.copy()
    close_gaps(column, 0, 1, 2, 2)
    np.testing.assert_array_equal(column[:, 1], [2, 1, 1, 1, 1, 2, 0, 0, 0, 1])


def test_stop_line_ends_the_governed_lane_only(street):
    assert paint_at(street, 39.75, -1.75) is Paint.ZEBRA
    assert paint_at(street, 39.75, 1.75) is Paint.ASPHALT
    assert paint_at(street, 39.2, -1.75) is Paint.ASPHALT


def test_crosswalk_has_stripes_along_the_traffic(street):
    row = [paint_at(street, 31.5, y) for y in np.arange(-3.4, 3.4, 0.05)]
    assert {Paint.ZEBRA, Paint.ZEBRA_GAP} == set(row)
    changes = sum(a is not b for a, b in pairwise(row))
    assert changes >= 10
    y = -3.4 + 0.05 * row.index(Paint.ZEBRA)
    assert {paint_at(street, x, y + 0.1) for x in np.arange(30.1, 32.9, 0.1)} == {Paint.ZEBRA}


def test_broken_line_is_three_on_six_off():
    points = np.stack([np.arange(91.0), np.zeros(91), np.zeros(91)], axis=1)
    lanes = (Lane(0, points, 3.5, 10.0, right_marking="broken"), Lane(1, points - np.array((0, 3.5, 0)), 3.5, 10.0))
    town = Town("dashes", lanes, ())
    painted = np.array([paint_at(town, x, -1.75) is Paint.WHITE for x in np.arange(1.0, 89.0, 0.1)])
    assert painted.mean() == pytest.approx(1 / 3, abs=0.03)
    edges = np.flatnonzero(np.diff(painted.astype(int)))
    np.testing.assert_allclose(np.diff(edges[painted[edges + 1] > 0]) * 0.1, 9.0, atol=0.15)


def test_mips_hold_the_shares_of_their_cells(street):
    """The coarsest level of a tile of two classes is their mix to the nearest eighth."""
    tiles = ground_of(street).tiles
    checked = 0
    for record in range(PLAIN_TILES, len(tiles.data) // RECORD):
        cells = tiles.data[record * RECORD : record * RECORD + TILE * TILE] // SHADES
        kinds, counts = np.unique(cells, return_counts=True)
        if set(kinds) <= {Paint.ASPHALT, Paint.GRASS, Paint.SIDEWALK} and len(kinds) == 2:
            code = int(tiles.data[record * RECORD + OFFSETS[5]])
            _, second, eighths = MIX_PARTS[code // SHADES if code < MIX_FIRST else code - MIX_FIRST + BASES]
            assert eighths / 8 == pytest.approx(counts[list(kinds).index(second)] / 1024, abs=0.0626)
            checked += 1
    assert checked > 5
    assert MIX.max() == CODES - 1


def test_bridge_and_the_road_below_are_levels(bridge):
    levels = ground_of(bridge).levels
    assert level_of(levels, -50.0, 0.0, 0.0) == 0
    assert level_of(levels, 0.0, -30.0, 5.2) == 1
    assert hidden(levels, 0, 0.0, 1.0, 6.0)
    assert not hidden(levels, 0, 1.0, 0.0, 0.0)
    assert hidden(levels, 1, 1.0, 0.0, 0.0)
    assert not hidden(levels, 1, 0.0, 60.0, 3.0)
    assert paint_at(bridge, 6.0, 0.0, 0) is Paint.ASPHALT
    assert paint_at(bridge, 6.0, 0.0, 1) is Paint.GRASS
    assert paint_at(bridge, 0.0, 6.0, 0) is Paint.GRASS
    assert paint_at(bridge, 0.0, 6.0, 1) is Paint.ASPHALT
    assert paint_at(bridge, 60.0, 0.0, 1) is Paint.ASPHALT


def test_actors_of_the_other_level_are_not_seen(bridge, scene_of):
    scene = scene_of(bridge, [(0.0, 1.0, 1.57, Kind.CAR), (10.0, 0.0, 0.0, Kind.CAR)], ego=(-15.0, 0.0, 0.0))
    scene.actors.z[0] = 6.0
    vehicle = bev_semantics(scene) == 6
    assert vehicle[:, :].sum() == pytest.approx(4.6 * 1.85 * 4, rel=0.2)
    assert vehicle[: 100 - 45].any()
    scene.ego.x, scene.ego.y, scene.ego.z, scene.ego.heading = 0.0, -15.0, 6.0, np.pi / 2
    vehicle = bev_semantics(scene) == 6
    rows, _ = np.nonzero(vehicle)
    assert rows.mean() == pytest.approx(99.5 - 32, abs=1)


def test_posts_of_lights_stand_off_the_road(street):
    over_the_lane = replace(street, signals=(replace(street.signals[0], position=(42.0, -1.75, 5.0)),), props=())
    scenery = scenery_of(over_the_lane)
    shapes = scenery.label[:, SHAPE]
    (post,) = scenery.number[shapes == Shape.POLE][:, [X, Y]]
    assert paint_at(over_the_lane, *post) in (Paint.SIDEWALK, Paint.KERB, Paint.GRASS)
    heads = scenery.number[shapes == Shape.SIGNAL]
    assert len(heads) == 2
    np.testing.assert_allclose(heads[np.argmax(heads[:, BASE]), [X, Y]], (42.0, -1.75))
    assert (shapes == Shape.BOX).sum() == 1

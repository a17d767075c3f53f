"""The semantic map from above."""

import numpy as np
import pytest

from me3bev_cli.api import BEV_CLASSES
from me3bev_plugins.simulator.highway.bev import bev_semantics
from me3bev_plugins.simulator.highway.scene import Kind
from me3bev_plugins.simulator.highway.town import Building

CLASS = {name: index for index, name in enumerate(BEV_CLASSES)}


def cell_of(x: float, y: float, cells: int = 200, cell: float = 0.5) -> tuple[int, int]:
    """Row and column of a point of the ego frame."""
    return int(np.floor(cells / 2 - x / cell)), int(np.floor(cells / 2 - y / cell))


def test_cells_are_vehicle_exactly_where_their_centre_is_inside_the_box(street, scene_of):
    scene = scene_of(street, [(12.3, 1.1, 0.7, Kind.VAN)])
    out = bev_semantics(scene)
    row, column = np.mgrid[0:200, 0:200]
    x, y = (99.5 - row) * 0.5, (99.5 - column) * 0.5
    dx, dy = x - 12.3, y - (1.1 + 1.75)
    along, across = np.cos(0.7) * dx + np.sin(0.7) * dy, np.cos(0.7) * dy - np.sin(0.7) * dx
    inside = (np.abs(along) <= 2.6) & (np.abs(across) <= 1.0)
    np.testing.assert_array_equal(out == CLASS["vehicle"], inside)


def test_ahead_left_is_up_left_whatever_the_heading(street, scene_of):
    for heading in (0.0, 1.2, -2.5):
        c, s = np.cos(heading), np.sin(heading)
        x, y = 20.0, 10.0
        scene = scene_of(street, [(c * x - s * y, -1.75 + s * x + c * y, 0.3, Kind.CAR)], ego=(0.0, -1.75, heading))
        rows, columns = np.nonzero(bev_semantics(scene) == CLASS["vehicle"])
        assert rows.mean() == pytest.approx(cell_of(x, y)[0], abs=1)
        assert columns.mean() == pytest.approx(cell_of(x, y)[1], abs=1)


def test_every_class_has_its_place(town_of, scene_of):
    house = Building((10.0, 20.0), (8.0, 8.0), 0.0, 6.0, (100, 100, 100))
    town = town_of(buildings=(house,))
    out = bev_semantics(scene_of(town, [(6.0, -5.0, 0.0, Kind.PEDESTRIAN)]))
    expected = {
        (10.0, 21.75): "building",
        (6.0, -3.25): "pedestrian",
        (3.0, 0.0): "road",
        (20.0, 6.75): "sidewalk",
        (20.0, 15.0): "other",
        (31.5, 0.0): "crosswalk",
        (39.75, 0.0): "crosswalk",
        (-10.0, 1.9): "lane_marking",
        (-10.0, -1.75): "lane_marking",
    }
    assert {at: BEV_CLASSES[out[cell_of(*at)]] for at in expected} == expected


def test_solid_lines_have_no_gaps_at_any_angle(street, scene_of):
    """Walking along the edge line, paint is always within a cell."""
    for heading in (0.0, 0.3, 0.77, 1.4):
        out = bev_semantics(scene_of(street, [], ego=(-60.0, -1.75, heading)))
        marking = np.pad(out == CLASS["lane_marking"], 1)
        wide = np.logical_or.reduce([np.roll(marking, (a, b), (0, 1)) for a in (-1, 0, 1) for b in (-1, 0, 1)])[
            1:-1, 1:-1
        ]
        for step in np.arange(-40, 40, 0.5):
            c, s = np.cos(heading), np.sin(heading)
            x, y = c * step + s * -1.75, -s * step + c * -1.75
            assert wide[cell_of(x, y)]


def test_the_ego_is_not_drawn_and_other_grids_are_possible(street, scene_of):
    out = bev_semantics(scene_of(street, []), cells=80, cell=0.25)
    assert out.shape == (80, 80)
    assert out.dtype == np.uint8
    assert out[cell_of(0.0, 0.0, 80, 0.25)] == CLASS["road"]

"""The authoring kit: the shipped files come from the layouts, and its curves are what they claim to be."""

from __future__ import annotations

import gzip
import math
import xml.etree.ElementTree as ET
from importlib.resources import files

import pytest

from me3bev_plugins.simulator.highway.maps import MAPS
from me3bev_plugins.simulator.highway.towns.author import NAMES, author
from me3bev_plugins.simulator.highway.towns.connect import connect
from me3bev_plugins.simulator.highway.towns.geometry import Path, arcs, bulb, circle, crossing, polyline
from me3bev_plugins.simulator.highway.towns.network import build
from me3bev_plugins.simulator.highway.towns.streets import Layout, Node, Section, Street
from me3bev_plugins.simulator.highway.towns.writer import hermite, write


@pytest.mark.parametrize("name", MAPS)
def test_shipped_files_are_what_the_layouts_say(name: str) -> None:
    shipped = (files("me3bev_plugins.simulator.highway.towns") / f"{name}.xodr.gz").read_bytes()
    # Compared unpacked: compressed bytes differ between zlib versions.
    assert gzip.decompress(author(name)) == gzip.decompress(shipped)
    assert author(name) == author(name)


def test_the_author_knows_every_map() -> None:
    assert NAMES == MAPS


def integrate(path: Path, start: tuple[float, float, float], steps: int = 20000) -> tuple[float, float, float]:
    """Where curvature alone leads, summed in small steps (midpoint rule)."""
    x, y, h = start
    for piece in path.pieces:
        ds = piece.length / steps
        for _ in range(steps):
            middle = h + piece.curvature * ds / 2
            x, y, h = x + ds * math.cos(middle), y + ds * math.sin(middle), h + piece.curvature * ds
    return x, y, h


@pytest.mark.parametrize(
    "end",
    [(30.0, 0.0, 0.0), (30.0, 12.0, math.pi / 2), (40.0, 3.5, 0.0), (20.0, -25.0, -2.0), (35.0, -4.0, 0.3)],
)
def test_a_connector_starts_and_ends_at_its_lanes(end: tuple[float, float, float]) -> None:
    path = connect((0.0, 0.0, 0.0), end)
    assert path is not None
    x, y, h = integrate(path, (0.0, 0.0, 0.0))
    assert (x, y) == pytest.approx(end[:2], abs=1e-4)
    assert math.cos(h - end[2]) == pytest.approx(1.0, abs=1e-9)


def test_a_right_angle_takes_the_largest_radius_that_fits() -> None:
    path = connect((0.0, 0.0, 0.0), (20.0, 8.0, math.pi / 2))
    assert path is not None
    # 20 m to the corner, 8 m beyond it: the arc of radius 8 begins 12 m on.
    assert [round(piece.length, 6) for piece in path.pieces] == [12.0, round(8 * math.pi / 2, 6)]
    assert path.tightest == pytest.approx(8.0)


def test_nothing_leads_straight_back() -> None:
    assert connect((0.0, 0.0, 0.0), (-10.0, 0.0, 0.0)) is None


def test_rounded_corners_and_parallels() -> None:
    square = polyline((0, 0, 10), (100, 0, 10), (100, 100, 10), (0, 100, 10), closed=True)
    assert square.length == pytest.approx(4 * 80 + math.tau * 10)
    assert square.offset(4.0).length == pytest.approx(4 * 80 + math.tau * 6)
    assert square.reversed().length == pytest.approx(square.length)
    assert square.cut(square.length - 5, square.length + 5).length == pytest.approx(10.0)
    with pytest.raises(ValueError, match="no parallel"):
        square.offset(10.0)
    with pytest.raises(ValueError, match="overlap by 20"):
        polyline((0, 0), (30, 0, 50), (30, 30))


def test_points_beside_and_on_paths() -> None:
    round_path = circle((0.0, 0.0), 20.0)
    assert round_path.near((0.0, 20.5), 1.0) == pytest.approx([math.pi * 10], abs=1e-6)
    assert round_path.beside((0.0, 19.0), 30.0) == pytest.approx((math.pi * 10, 1.0), abs=1e-6)
    one, other = polyline((0, 0), (100, 0)), polyline((30, -50), (50, 50))
    assert crossing(one, other, (35.0, 5.0)) == pytest.approx((40.0, 0.0))


def test_a_bulb_ends_where_it_began() -> None:
    path = bulb((3.0, 4.0, 1.0), 20.0, 13.0)
    x, y, h = path.pose(path.length)
    assert (x, y) == pytest.approx((3.0, 4.0), abs=1e-9)
    assert math.cos(h - 1.0) == pytest.approx(-1.0)
    assert arcs((0, 0, 0), (5, 0), (10, -20)).tightest == 20.0


def test_hermite_meets_values_and_slopes() -> None:
    _, a, b, c, d = hermite(0.0, 40.0, (1.0, 0.02), (5.0, -0.01))
    assert a == 1.0
    assert a + 40 * (b + 40 * (c + 40 * d)) == pytest.approx(5.0)
    assert b + 40 * (2 * c + 40 * 3 * d) == pytest.approx(-0.01)


def test_climbs_are_smooth_between_knots() -> None:
    street = Street("hill", polyline((0, 0), (100, 0)), climbs=(((20, 0), 0.0), ((60, 0), 8.0)))
    assert street.height(10.0) == (0.0, 0.0)
    assert street.height(40.0) == pytest.approx((4.0, 0.3))  # Half way: half the height, 1.5 times the mean grade.
    assert street.height(80.0) == (8.0, 0.0)


def test_cross_sections_count_offsets_from_the_middle() -> None:
    both = Section(2, 2, turn_lane=3.0, shoulder=0.5, sidewalk=2.0)
    assert [lane.offset for lane in both.driving(True)] == [-3.25, -6.75]
    assert [lane.offset for lane in both.driving(False)] == [3.25, 6.75]
    assert both.asphalt(1) == 9.0
    one_way = Section(2, 0, sidewalk=0)
    assert [lane.offset for lane in one_way.driving(True)] == [1.75, -1.75]


def crossroads() -> Layout:
    ring = polyline((-100, -100, 10), (100, -100, 10), (100, 100, 10), (-100, 100, 10), closed=True)
    streets = (
        Street("ring", ring, Section(), 30),
        Street("north-south", polyline((0, -100), (0, 100)), Section(2, 2), 50),
        Street("east-west", polyline((-100, 0), (100, 0)), Section(), 50),
    )
    ends = tuple(Node(f"end {i}", at, "yield") for i, at in enumerate([(0, -100), (100, 0), (0, 100), (-100, 0)]))
    return Layout("X", "a cross in a ring", streets, (Node("middle", (0.0, 0.0), "signal", crosswalks=True), *ends))


def test_a_crossroads_joins_lanes_as_drivers_expect() -> None:
    network = build(crossroads())
    middle = network.junctions[0]
    assert len(middle.arms) == 4
    ways = [way for way in middle.connectors if not way.sidewalk]
    # Each two-lane approach: 2 straight, 1 left, 1 right; each single-lane one: 3.
    # Turning into two lanes serves the nearest; the other is served straight on.
    assert len(ways) == 2 * 4 + 2 * 3
    assert sum(way.sidewalk for way in middle.connectors) == 4
    assert sorted(set(middle.groups)) == [0, 1]
    assert min(way.path.tightest for way in ways) >= 6.0 - 1e-6


def test_the_document_says_what_stands_where() -> None:
    root = ET.fromstring(write(build(crossroads())))
    kinds = [signal.get("type") for signal in root.iter("signal")]
    assert kinds.count("1000001") == 4
    assert kinds.count("205") == 4
    assert len(root.findall("controller")) == 2
    assert sum(item.get("type") == "crosswalk" for item in root.iter("object")) == 4
    # A limit sign for each direction where traffic comes from a road with another limit: four arms
    # leave the ring, and the ring's four roads are entered from either end.
    values = [signal.get("value") for signal in root.iter("signal") if signal.get("type") == "274"]
    assert (values.count("50"), values.count("30")) == (4, 8)


def test_a_street_that_ends_nowhere_is_named() -> None:
    layout = crossroads()
    broken = Layout("X", "", layout.streets, layout.nodes[:-1])
    with pytest.raises(ValueError, match="street east-west must begin and end at nodes"):
        build(broken)

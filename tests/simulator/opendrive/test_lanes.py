"""Lanes of small documents: where they run, how they join, what may be changed to."""

from __future__ import annotations

from math import pi

import numpy as np
import pytest
from simulator.opendrive_text import WIDTH, document, ring, stadium
from simulator.town_checks import check_town

from me3bev_cli.errors import MapError
from me3bev_plugins.simulator.highway.opendrive import read_town
from me3bev_plugins.simulator.highway.town import Town


@pytest.fixture(scope="module")
def oval() -> Town:
    return read_town(stadium(), "ring")


def test_lanes_lie_at_their_offset_from_the_reference_line(oval: Town) -> None:
    # The stadium: straights at y = -30 and 30 from x = -20 to 20, half circles of 30 m about (20, 0) and (-20, 0).
    assert len(oval.lanes) == 4
    for lane in oval.lanes:
        beyond = np.clip(np.abs(lane.points[:, 0]) - 20, 0, None)
        radius = np.hypot(beyond, lane.points[:, 1])
        expected = 30 + (1.75 if lane.right is not None else 5.25)
        np.testing.assert_allclose(radius, expected, atol=1e-9)
        assert lane.length == pytest.approx(40 + pi * expected, abs=0.01)


def test_ring_is_sound(oval: Town) -> None:
    check_town(oval)


def test_lanes_of_one_direction_are_neighbours(oval: Town) -> None:
    inner = [lane for lane in oval.lanes if lane.right is not None]
    assert len(inner) == 2
    for lane in inner:
        assert lane.left is None
        assert lane.right is not None
        outer = oval.lanes[lane.right]
        assert (outer.left, outer.right) == (lane.id, None)
        assert (lane.right_marking, outer.left_marking, outer.right_marking) == ("broken", "broken", "solid")


def test_a_solid_line_is_not_changed_across() -> None:
    text = stadium().replace(b'type="broken" color="white"', b'type="solid" color="white"')
    town = read_town(text, "ring")
    assert all(lane.left is None and lane.right is None for lane in town.lanes)


def test_a_direction_that_cannot_be_reached_is_asphalt_only(oval: Town) -> None:
    # Lane 1 runs against the others, and nothing leads to it: its ground stays.
    areas = [polygon.mean(0) for polygon in oval.surfaces]
    radius = [np.hypot(max(abs(x) - 20, 0), y) for x, y in areas]
    np.testing.assert_allclose(radius, 28.25, atol=0.2)


def test_limits_come_from_the_road_type() -> None:
    mph = '<type s="0" type="motorway"><speed max="65" unit="mph"/></type>'
    for text, limit, highway in (("", 30 / 3.6, False), (mph, 65 * 1609.344 / 3600, True)):
        town = read_town(stadium(speed=text), "ring")
        assert all(lane.limit == pytest.approx(limit) for lane in town.lanes)
        assert {lane.highway for lane in town.lanes} == {highway}


def test_height_follows_the_elevation() -> None:
    town = read_town(stadium(height=4.5), "ring")
    assert all(np.all(lane.points[:, 2] == 4.5) for lane in town.lanes)


def test_zero_length_sections_are_joined_through() -> None:
    text = stadium().decode()
    section = text[text.index("<laneSection") : text.index("</lanes>")]
    short = section.replace('s="0"', 's="20.01"', 1) + section.replace('s="0"', 's="20.03"', 1)
    town = read_town(text.replace(section, section + short, 1).encode(), "ring")
    check_town(town)
    assert sorted(lane.length for lane in town.lanes) == pytest.approx([139.74, 139.74, 150.74, 150.74], abs=0.05)


def test_roads_that_are_linked_but_do_not_touch_are_not_joined() -> None:
    with pytest.raises(MapError, match="leads back to where it began"):
        read_town(stadium().replace(b'x="20.0" y="30.0"', b'x="25.0" y="30.0"'), "ring")


def test_a_lane_that_opens_branches_from_its_neighbour() -> None:
    """Lane -2 widens from nothing over 20 m of the first road and narrows to nothing over 20 m of the second."""
    first, second = ring()
    linked = '<predecessor id="-2"/><successor id="-2"/>'
    wide = f'<width sOffset="0" a="{WIDTH}" b="0" c="0" d="0"/>'
    bend = f'b="0" c="{3 * WIDTH / 400}" d="{-2 * WIDTH / 8000}"'
    first.right = first.right.replace(linked, '<successor id="-2"/>')
    outer = first.right.index('<lane id="-2"')
    first.right = first.right[:outer] + first.right[outer:].replace(
        wide, f'<width sOffset="0" a="0" {bend}/>' + wide.replace('"0" a', '"20" a')
    )
    second.right = second.right.replace(linked, '<predecessor id="-2"/>')
    outer = second.right.index('<lane id="-2"')
    closing = f'b="0" c="{-3 * WIDTH / 400}" d="{2 * WIDTH / 8000}"'
    at = second.length - 20
    second.right = second.right[:outer] + second.right[outer:].replace(
        wide, wide + f'<width sOffset="{at}" a="{WIDTH}" {closing}/>'
    )
    town = read_town(document(first, second), "ring")
    check_town(town)
    branching = [lane for lane in town.lanes if len(lane.successors) == 2]
    assert len(branching) == 2
    for lane in branching:  # Both lanes before the place lead to both after it, at the inner lane's middle.
        np.testing.assert_allclose(lane.points[-1, :2], (-20, -31.75), atol=1e-9)

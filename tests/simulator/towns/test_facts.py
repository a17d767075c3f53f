"""The measuring of towns on a hand-made one, and the character of the shipped ones."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from me3bev_plugins.simulator.highway.maps import MAPS, load_town
from me3bev_plugins.simulator.highway.town import Junction, Lane, Town
from me3bev_plugins.simulator.highway.towns.carriageways import Carriageways
from me3bev_plugins.simulator.highway.towns.facts import measure
from me3bev_plugins.simulator.highway.towns.facts_compare import compare


def line(x0: float, y0: float, x1: float, y1: float) -> np.ndarray:
    count = math.ceil(math.hypot(x1 - x0, y1 - y0)) + 1
    return np.column_stack([np.linspace(x0, x1, count), np.linspace(y0, y1, count), np.zeros(count)])


def half_circle(y: float) -> np.ndarray:
    """From (100, y) round by the right to (100, -y)."""
    angle = np.linspace(-math.pi / 2, math.pi / 2, 200) * math.copysign(1.0, -y)
    return np.column_stack([100 + abs(y) * np.cos(angle), abs(y) * np.sin(angle), np.zeros(200)])


def test_figures_of_a_hand_made_oval() -> None:
    # Two straight lanes side by side, a half circle of radius 30 back, and a junction closing the loop.
    lanes = (
        Lane(0, line(0, -30, 100, -30), 3.5, 50 / 3.6, successors=(2,), predecessors=(4,), right=1),
        Lane(1, line(0, -33, 100, -33), 3.5, 50 / 3.6, successors=(2,), predecessors=(5,), left=0),
        Lane(2, half_circle(-30.0), 3.5, 30 / 3.6, successors=(3,), predecessors=(0, 1)),
        Lane(3, line(100, 30, 0, 30), 3.0, 30 / 3.6, successors=(4, 5), predecessors=(2,)),
        Lane(4, line(0, 30, 0, -30), 3.5, 30 / 3.6, successors=(0,), predecessors=(3,), junction=0),
        Lane(5, line(0, 30, 0, -33), 3.5, 30 / 3.6, successors=(1,), predecessors=(3,), junction=0),
    )
    junction = Junction(0, connectors=(4, 5), incoming=(3,), outgoing=(0, 1), control="signal", arms=2)
    facts = measure(Town("oval", lanes, (junction,)))
    bend = math.pi * 30
    assert facts.road_km == pytest.approx((300 + bend) / 1000, rel=1e-3)
    assert facts.connector_km == pytest.approx(0.123)
    assert facts.signalised == 1
    assert facts.intersections == {"3": 0, "4": 0, "5": 0, "merge": 0, "roundabout": 0, "pass": 1}
    assert facts.lanes_per_direction == pytest.approx({1: (100 + bend) / (200 + bend), 2: 100 / (200 + bend)}, rel=1e-3)
    assert facts.posted_kmh == pytest.approx({30: (100 + bend) / (300 + bend), 50: 200 / (300 + bend)}, rel=1e-3)
    assert facts.straight == pytest.approx(300 / (300 + bend), abs=0.01)
    assert facts.bend_radius == pytest.approx(30.0, rel=0.01)
    assert facts.width == (3.0, 3.5, 3.5)


@pytest.mark.parametrize("name", MAPS)
def test_every_fact_of_a_built_in_town_is_within_its_tolerance(name: str) -> None:
    rows = compare(name, measure(load_town(name)))
    assert [row for row in rows if row.within is False] == []
    judged = {row.key for row in rows if row.within}
    assert {"lanes", "junctions with lights", "median lane width", "straight lanes", "median block"} <= judged
    assert {"3-arm junctions", "4-arm junctions", "5-arm junctions", "merges", "roundabouts"} <= judged
    assert all((row.reference is None) == (row.within is None) for row in rows if row.tolerance)
    # The two originals without signs have no posted limits to compare with.
    limits = [row for row in rows if row.key.startswith("limit of")]
    assert all((row.reference is None) == (name in ("T3", "T5")) for row in limits)
    assert sum(row.value for row in limits) == pytest.approx(100.0)


def test_a_town_of_ones_own_has_nothing_to_be_compared_with() -> None:
    rows = compare("Elsewhere", measure(load_town("T2")))
    assert {(row.reference, row.tolerance, row.within) for row in rows} == {(None, "", None)}
    assert {row.key for row in rows} >= {"lanes", "merges", "limit of 30 km/h", "median bend radius", "crosswalks"}


def test_what_lies_outside_is_said() -> None:
    facts = measure(load_town("T2"))
    changed = replace(facts, road_km=facts.road_km + 1.0, signalised=6, width=(4.0, 4.11, 4.2))
    changed = replace(changed, intersections=facts.intersections | {"3": 6, "merge": 1}, posted_kmh={30: 0.6, 60: 0.4})
    outside = {row.key: row.reference for row in compare("T2", changed) if row.within is False}
    # 3.89 km for 2.92; 6 lights for 8 and 6 junctions for 8, where one is allowed; 14.8 points at 30, 25.3 at 60.
    assert outside == {
        "lanes": 2.92,
        "junctions with lights": 8.0,
        "3-arm junctions": 8.0,
        "limit of 30 km/h": pytest.approx(74.8),
        "limit of 60 km/h": pytest.approx(14.7),
        "median lane width": 4.0,
    }


@pytest.mark.parametrize(("name", "sites"), [("T3", 0), ("T4", 1), ("T5", 3)])
def test_places_with_two_levels_are_counted(name: str, sites: int) -> None:
    assert measure(load_town(name)).levels == sites


def test_lanes_that_may_not_be_changed_between_are_one_carriageway() -> None:
    lanes = (
        Lane(0, line(0, 0, 100, 0), 3.5, 14.0),
        Lane(1, line(0, -3.5, 100, -3.5), 3.5, 14.0),
        Lane(2, line(0, -10.5, 100, -10.5), 3.5, 14.0),  # A lane's width of grass away.
        Lane(3, line(100, 3.5, 0, 3.5), 3.5, 14.0),  # The other direction.
        Lane(4, line(50, -7.0, 100, -7.0), 3.5, 14.0),  # Begins half-way.
    )
    assert Carriageways(Town("strips", lanes, ())).lanes == [[0, 1], [2], [3], [4]]


def test_the_roundabout_has_two_lanes_and_four_legs() -> None:
    town = load_town("T3")
    ring = [lane for lane in town.lanes if lane.junction is None and 18 < np.hypot(*lane.points[:, :2].T).max() < 26]
    assert len(ring) == 8
    assert {round(float(np.hypot(*lane.points[0, :2])), 2) for lane in ring} == {20.25, 23.75}

"""The measuring of towns on a hand-made one, and the character of the shipped ones."""

from __future__ import annotations

import math

import numpy as np
import pytest

from me3bev_plugins.simulator.highway.maps import load_town
from me3bev_plugins.simulator.highway.town import Junction, Lane, Town
from me3bev_plugins.simulator.highway.towns.facts import measure


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


@pytest.mark.parametrize(
    ("name", "lane_km", "signalised", "kinds"),
    [
        ("T1", 6.40, 12, {"3": 12}),
        ("T2", 2.92, 8, {"3": 8}),
        ("T3", 14.33, 11, {"3": 16, "4": 5, "5": 1, "roundabout": 1}),
        ("T4", 33.34, 12, {"3": 9, "4": 9}),
        ("T5", 23.47, 15, {"3": 8, "4": 13}),
        ("T6", 25.52, 8, {"3": 5, "4": 4, "merge": 12, "pass": 2}),
        ("T7", 7.14, 5, {"3": 20, "4": 3, "pass": 6}),
    ],
)
def test_shipped_towns_have_the_size_and_junctions_meant(
    name: str, lane_km: float, signalised: int, kinds: dict[str, int]
) -> None:
    facts = measure(load_town(name))
    assert facts.lane_km == pytest.approx(lane_km, rel=0.15)
    assert facts.signalised == signalised
    for kind, count in kinds.items():
        assert abs(facts.intersections[kind] - count) <= max(1, 0.15 * count), kind


def test_the_roundabout_has_two_lanes_and_four_legs() -> None:
    town = load_town("T3")
    ring = [lane for lane in town.lanes if lane.junction is None and 18 < np.hypot(*lane.points[:, :2].T).max() < 26]
    assert len(ring) == 8
    assert {round(float(np.hypot(*lane.points[0, :2])), 2) for lane in ring} == {20.25, 23.75}

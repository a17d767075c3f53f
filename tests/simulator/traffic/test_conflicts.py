"""Zones: where lanes meet."""

from __future__ import annotations

import numpy as np
import pytest
from simulator.tiny_town import build_tiny_town
from simulator.traffic.stage import corners, overlap

from me3bev_plugins.simulator.highway.town import Town
from me3bev_plugins.simulator.highway.traffic_conflicts import boxes_touch
from me3bev_plugins.simulator.highway.traffic_records import CROSS, LEAD, MERGE, SPLIT
from me3bev_plugins.simulator.highway.traffic_tables import tables


def connector(town: Town, lane: int, turn: str) -> int:
    """The connector that leaves a lane in a direction."""
    return next(n for n in town.lanes[lane].successors if town.lanes[n].turn == turn)


def zone(town: Town, lane: int, other: int) -> np.void | None:
    """The zone of two lanes for small vehicles."""
    roads = tables(town).roads
    own = roads.zones[roads.zone_start[0, lane] : roads.zone_start[0, lane + 1]]
    found = own[own["other"] == other]
    return found[0] if len(found) else None


def test_straight_paths_cross_where_geometry_says() -> None:
    # From the west on y = -1.75 and from the south on x = 1.75; both start 12 m before the centre, so they cross at
    # arc lengths 13.75 and 10.25. Boxes of 5.5 x 2.5 m touch within 2.75 + 1.25 = 4 m of that.
    town = build_tiny_town()
    met = zone(town, connector(town, 8, "straight"), connector(town, 16, "straight"))
    assert met is not None
    assert met["kind"] == CROSS
    assert [float(met[k]) for k in ("a0", "a1", "b0", "b1")] == pytest.approx([9.75, 17.75, 6.25, 14.25], abs=0.76)


def test_neighbours_and_opposite_directions_do_not_meet() -> None:
    town = build_tiny_town()
    inner, outer = connector(town, 8, "straight"), connector(town, 9, "straight")
    assert zone(town, inner, outer) is None
    assert zone(town, inner, connector(town, 14, "straight")) is None


def test_merging_paths_count_from_their_common_end_and_parting_ones_from_their_start() -> None:
    town = build_tiny_town()
    straight, turn = connector(town, 16, "straight"), connector(town, 8, "left")  # Both lead north.
    merge = zone(town, straight, turn)
    assert merge is not None
    assert (merge["kind"], merge["joint"]) == (LEAD, MERGE)
    assert merge["at_a"] - merge["at_b"] == pytest.approx(town.lanes[straight].length - town.lanes[turn].length)
    split = zone(town, connector(town, 8, "straight"), turn)
    assert split is not None
    assert (split["kind"], split["joint"]) == (LEAD, SPLIT)


def test_zones_are_mutual() -> None:
    roads = tables(build_tiny_town()).roads
    pairs = set()
    for lane in range(len(roads.lanes)):
        for k in range(roads.zone_start[0, lane], roads.zone_start[0, lane + 1]):
            pairs.add((lane, int(roads.zones[k]["other"])))
    assert pairs
    assert pairs == {(b, a) for a, b in pairs}


def test_boxes_touch_agrees_with_polygon_clipping() -> None:
    rng = np.random.default_rng(0)
    touching = 0
    for _ in range(500):
        x, y, a, b = rng.uniform(-5, 5), rng.uniform(-5, 5), *rng.uniform(-np.pi, np.pi, 2)
        expected = overlap(corners(0, 0, a, 5, 2), corners(x, y, b, 4, 1.5))
        sides = (np.cos(a), np.sin(a), np.cos(b), np.sin(b), 2.5, 1.0, 2.0, 0.75)
        assert boxes_touch(x, y, *sides) == expected
        touching += expected
    assert 50 < touching < 450

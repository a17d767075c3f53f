"""Overlap of boxes against highway-env's polygons, and who ran into whom."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from highway_env.utils import are_polygons_intersecting

from me3bev_plugins.simulator.highway.collisions import CollisionTest, Hit, boxes_overlap, contact_ahead
from me3bev_plugins.simulator.highway.scene import Actors, Ego, Kind
from me3bev_plugins.simulator.highway.town import Town


def corners(box: tuple[float, ...]) -> np.ndarray:
    x, y, heading, length, width = box
    c, s = math.cos(heading), math.sin(heading)
    local = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1], [1, 1]]) * (length / 2, width / 2)
    return local @ np.array([[c, s], [-s, c]]) + (x, y)


def test_overlap_agrees_with_highway_env() -> None:
    rng = np.random.default_rng(1)
    seen = set()
    for _ in range(400):
        a = (0.0, 0.0, float(rng.uniform(-3, 3)), 4.7, 1.9)
        b = (*rng.uniform(-5, 5, 2), rng.uniform(-3, 3), rng.uniform(0.5, 8), rng.uniform(0.5, 3))
        b = tuple(float(v) for v in b)
        expected, _, _ = are_polygons_intersecting(corners(a), corners(b), np.zeros(2), np.zeros(2))
        assert boxes_overlap(a, b) == boxes_overlap(b, a) == expected
        seen.add(bool(expected))
    assert seen == {True, False}


Make = Callable[..., Actors]


def hit(town: Town, ego: Ego, actors: Actors) -> Hit | None:
    return CollisionTest(town)(ego, actors)


@pytest.mark.parametrize(
    ("place", "speed", "expected"),
    [
        ((14.0, 0.0, 0.0), 5.0, Hit("vehicle", True, "front")),  # ran into the car in front
        ((6.0, 0.0, 0.0), 5.0, Hit("vehicle", False, "rear")),  # was run into from behind
        ((14.0, 0.0, 0.0), 0.0, Hit("vehicle", False, "front")),  # stood, and the other backed into it
        ((9.5, 2.5, -math.pi / 2), 5.0, Hit("vehicle", False, "side")),  # was hit in the side
        ((12.4, 2.5, math.pi / 2), 5.0, None),  # passed behind the one that crossed
        ((13.0, 1.0, math.pi / 2), 5.0, Hit("vehicle", True, "front")),  # ran into one that crossed
        ((15.0, 0.0, 0.0), 5.0, None),
    ],
)
def test_attribution(
    town: Town, actors_of: Make, place: tuple[float, float, float], speed: float, expected: Hit | None
) -> None:
    ego = Ego(10.0, 0.0, 0.0, 0.0, speed)
    if expected is None and place[0] < 13:
        place = (place[0] + 1.0, place[1] + 1.0, place[2])
    assert hit(town, ego, actors_of((*place, 3.0, Kind.CAR))) == expected


def test_pedestrians_and_levels(town: Town, actors_of: Make) -> None:
    actors = actors_of((12.4, 0.5, 0.0, 1.0, Kind.PEDESTRIAN))
    assert hit(town, Ego(10.0, 0.0, 0.0, 0.0, 5.0), actors) == Hit("pedestrian", True, "front")
    assert hit(town, Ego(10.0, 0.0, 3.0, 0.0, 5.0), actors) is None


def test_the_nearest_of_two_counts(town: Town, actors_of: Make) -> None:
    actors = actors_of((13.9, 0.0, 0.0, 0.0, Kind.CAR), (12.0, 0.0, 0.0, 1.0, Kind.PEDESTRIAN))
    assert hit(town, Ego(10.0, 0.0, 0.0, 0.0, 5.0), actors) == Hit("pedestrian", True, "front")


def test_static_things(town: Town, actors_of: Make) -> None:
    nobody = actors_of()
    # The building reaches from y = -25 to -15 and x = 20 to 40; the pole stands at (100, 4), 0.2 m thick.
    assert hit(town, Ego(30.0, -13.5, 0.0, math.pi / 2, 2.0), nobody) == Hit("static", True, "rear")
    assert hit(town, Ego(30.0, -13.5, 0.0, 0.0, 2.0), nobody) is None
    assert hit(town, Ego(100.0, 2.86, 0.0, 0.0, 2.0), nobody) == Hit("static", True, "side")
    assert hit(town, Ego(100.0, 2.84, 0.0, 0.0, 2.0), nobody) is None
    assert hit(town, Ego(100.0, 2.86, 0.0, 0.0, 0.0), nobody) == Hit("static", False, "side")
    assert hit(town, Ego(97.6, 4.0, 0.0, 0.0, 2.0), nobody) == Hit("static", True, "front")


def test_contact_is_the_middle_of_the_shared_area() -> None:
    ego = Ego(0.0, 0.0, 0.0, math.pi / 2, 5.0)
    # Facing north with the front at y = 2.35; the other covers y = 2 to 6.
    assert contact_ahead(ego, 0.0, 4.0, math.pi / 2, 4.0, 2.0) == pytest.approx((2.0 + 2.35) / 2)
    # Side by side, the other a metre behind and overlapping over its whole length of 2 m.
    assert contact_ahead(ego, 1.2, -1.0, math.pi / 2, 2.0, 1.0) == pytest.approx(-1.0)

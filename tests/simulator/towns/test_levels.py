"""Grade separation in the shipped towns: what crosses without a junction passes well above, and goes unseen."""

from __future__ import annotations

import numpy as np
import pytest
from simulator.town_checks import crossings_without_junction
from simulator.traffic.stage import FAR_AWAY, bind, staged

from me3bev_cli.api import BEV_CLASSES
from me3bev_plugins.simulator.highway.bev import bev_semantics
from me3bev_plugins.simulator.highway.collisions import LEVEL, CollisionTest
from me3bev_plugins.simulator.highway.ego_path import EgoPath
from me3bev_plugins.simulator.highway.maps import MAPS, load_town
from me3bev_plugins.simulator.highway.scene import Actors, Ego, Scene
from me3bev_plugins.simulator.highway.town import Town

CLEARANCE = 4.5
"""Metres: a truck passes below, and far more than what collisions and traffic count as one level."""
SITES = (("T4", 0), ("T4", -1), ("T5", 0), ("T5", -1))


@pytest.mark.parametrize("name", MAPS)
def test_lanes_cross_in_a_junction_or_well_above_one_another(name: str) -> None:
    heights = np.array([height for *_, height in crossings_without_junction(load_town(name))])
    assert (heights > CLEARANCE).all()
    assert CLEARANCE > LEVEL + 1.0
    assert bool(len(heights)) == (name in ("T4", "T5"))


def crossing(town: Town, which: int) -> tuple[int, float, int, float]:
    """(lower lane, arc length, upper lane, arc length) where one lane passes over another."""
    one, other, _ = crossings_without_junction(town)[which]
    a, b = town.lanes[one], town.lanes[other]
    apart = np.linalg.norm(a.points[:, None, :2] - b.points[None, :, :2], axis=2)
    i, j = np.unravel_index(int(apart.argmin()), apart.shape)
    ends = [(float(a.points[i, 2]), one, float(a.s[i])), (float(b.points[j, 2]), other, float(b.s[j]))]
    (_, low, s_low), (_, high, s_high) = sorted(ends)
    return low, s_low, high, s_high


def standing(town: Town, lane: int, s: float, speed: float = 0.0) -> Ego:
    at = town.lanes[lane]
    x, y, z = (float(np.interp(s, at.s, at.points[:, k])) for k in range(3))
    return Ego(x, y, z, float(np.interp(s, at.s, at.heading)), speed)


def as_actor(ego: Ego) -> Actors:
    one = [np.array([value]) for value in (ego.x, ego.y, ego.z, ego.heading, ego.speed)]
    size = [np.array([value]) for value in (ego.length, ego.width, ego.height)]
    return Actors(*one, *size, np.zeros(1, np.int32), np.full((1, 3), 90, np.uint8), np.zeros(1, bool))


@pytest.mark.parametrize(("name", "which"), SITES)
def test_vehicles_on_two_levels_do_not_collide(name: str, which: int) -> None:
    town = load_town(name)
    low, s_low, high, s_high = crossing(town, which)
    below, above = standing(town, low, s_low, 5.0), standing(town, high, s_high, 5.0)
    hits = CollisionTest(town)
    assert hits(below, as_actor(above)) is None
    assert hits(above, as_actor(below)) is None
    fallen = Ego(above.x, above.y, below.z, above.heading, above.speed)
    assert hits(below, as_actor(fallen)) is not None


@pytest.mark.parametrize(("name", "which"), SITES)
def test_traffic_passes_under_and_over_what_stands_on_the_other_level(name: str, which: int) -> None:
    town = load_town(name)
    low, s_low, high, s_high = crossing(town, which)
    for lane, s, other, s_other in ((low, s_low, high, s_high), (high, s_high, low, s_low)):
        run = min(30.0, s - 1.0)
        path = EgoPath(np.array([other], np.int32), 0, s_other, 0.0)
        away, there = standing(town, other, s_other), standing(town, lane, s)
        on_this_level = Ego(away.x, away.y, there.z, away.heading, 0.0)
        passed = []
        for ego in (away, FAR_AWAY, on_this_level):
            traffic = staged(town, [(lane, s - run, 10.0)], (ego, path))
            bind(traffic, 0, [lane])
            for _ in range(int(run / 10.0 * 10) + 5):
                traffic.step(0.1, ego, path)
            passed.append((float(traffic.actors.x[0]), float(traffic.actors.y[0])))
        assert passed[0] == passed[1] != passed[2]
        assert np.hypot(passed[0][0] - there.x, passed[0][1] - there.y) < run


@pytest.mark.parametrize(("name", "which"), SITES)
def test_the_map_from_above_shows_the_ego_only_its_own_level(name: str, which: int) -> None:
    town = load_town(name)
    low, s_low, high, s_high = crossing(town, which)
    vehicle = BEV_CLASSES.index("vehicle")
    lights = np.zeros(len(town.signals), np.int32)
    below, above = standing(town, low, s_low), standing(town, high, s_high)
    for ego, other in ((below, above), (above, below)):
        assert not (bev_semantics(Scene(town, ego, as_actor(other), lights)) == vehicle).any()
        beside = Ego(other.x, other.y, ego.z, other.heading, 0.0)
        assert (bev_semantics(Scene(town, ego, as_actor(beside), lights)) == vehicle).any()

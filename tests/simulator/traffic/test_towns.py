"""Rush hour in every built-in town."""

from __future__ import annotations

import numpy as np
import pytest
from simulator.traffic.stage import FAR_AWAY

from me3bev_plugins.simulator.highway.ego_path import EgoPath
from me3bev_plugins.simulator.highway.maps import MAPS, load_town
from me3bev_plugins.simulator.highway.scene import Actors, Ego, Kind
from me3bev_plugins.simulator.highway.traffic import Traffic
from me3bev_plugins.simulator.highway.traffic_conflicts import boxes_touch


def touching(a: Actors, first: np.ndarray, second: np.ndarray) -> list[tuple[int, int]]:
    """Pairs of actors, one of each group, whose boxes overlap."""
    dx, dy = (v[second][None] - v[first][:, None] for v in (a.x, a.y))
    level = np.abs(a.z[second][None] - a.z[first][:, None]) < 2.5
    close = np.argwhere((dx**2 + dy**2 < 160.0) & level)
    c, s = np.cos(a.heading), np.sin(a.heading)
    found = []
    for m, n in close:
        i, j = int(first[m]), int(second[n])
        sides = (a.length[i] / 2, a.width[i] / 2, a.length[j] / 2, a.width[j] / 2)
        if i != j and boxes_touch(dx[m, n], dy[m, n], c[i], s[i], c[j], s[j], *sides):
            found.append((i, j))
    return found


@pytest.mark.parametrize("name", MAPS)
def test_a_minute_and_a_half_of_rush_hour(name: str) -> None:
    town = load_town(name)
    traffic = Traffic(town)
    ego, path = FAR_AWAY, EgoPath(np.array([0], np.int32), 0, 1.0, 0.0)
    traffic.reset(np.random.default_rng(17), 100, 100, ego, path)
    a = traffic.actors
    vehicles, people = np.flatnonzero(a.kind != Kind.PEDESTRIAN), np.flatnonzero(a.kind == Kind.PEDESTRIAN)
    assert (len(vehicles), len(people)) == (100, 100)
    still = np.zeros(len(vehicles))
    travelled = np.zeros(len(a))
    for step in range(900):
        traffic.step(0.1, ego, path)
        travelled += 0.1 * a.speed
        still = np.where(a.speed[vehicles] < 0.2, still + 0.1, 0.0)
        if step % 3 == 0:
            assert touching(a, vehicles, vehicles) == []
            assert touching(a, vehicles, people) == []
    assert still.max() < 85.0
    assert travelled[vehicles].mean() > 60.0
    assert travelled[people].mean() > 40.0
    assert np.isfinite(traffic._pose).all()


def test_the_reference_driver_gets_on_without_harm() -> None:
    town = load_town("T3")
    traffic = Traffic(town)
    metres = []
    for episode in range(12):
        rng = np.random.default_rng(episode)
        lanes = [int(rng.choice([lane.id for lane in town.lanes if lane.junction is None and lane.length > 40.0]))]
        while len(lanes) < 20:
            lanes.append(int(rng.choice(town.lanes[lanes[-1]].successors)))
        index, s, speed, total = 0, 20.0, 0.0, 0.0
        for step in range(128):
            lane = town.lanes[lanes[index]]
            x, y, z = (float(np.interp(s, lane.s, lane.points[:, k])) for k in range(3))
            ego = Ego(x, y, z, float(np.interp(s, lane.s, lane.heading)), speed)
            path = EgoPath(np.array(lanes, np.int32), index, s, 0.0)
            if step == 0:
                traffic.reset(rng, 50, 50, ego, path)
            else:
                traffic.step(0.1, ego, path)
                a = traffic.actors
                for i in np.flatnonzero(np.hypot(a.x - x, a.y - y) < 12.0):
                    turned = (np.cos(ego.heading), np.sin(ego.heading), np.cos(a.heading[i]), np.sin(a.heading[i]))
                    sides = (ego.length / 2, ego.width / 2, a.length[i] / 2, a.width[i] / 2)
                    assert abs(a.z[i] - z) > 2.5 or not boxes_touch(a.x[i] - x, a.y[i] - y, *turned, *sides)
            accel = traffic.advise(ego, path)
            s, total, speed = s + 0.1 * speed, total + 0.1 * speed, max(0.0, speed + 0.1 * accel)
            while s > town.lanes[lanes[index]].length:
                s, index = s - town.lanes[lanes[index]].length, index + 1
        metres.append(total)
    assert np.mean(metres) > 40.0

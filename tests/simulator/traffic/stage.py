"""Helpers that put vehicles and the ego exactly where a test wants them."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from me3bev_plugins.simulator.highway.ego_path import EgoPath
from me3bev_plugins.simulator.highway.scene import Actors, Ego, Light
from me3bev_plugins.simulator.highway.signals import SignalPlan
from me3bev_plugins.simulator.highway.town import Lane, Town
from me3bev_plugins.simulator.highway.traffic import Traffic
from me3bev_plugins.simulator.highway.traffic_state import place


def straight_town(length: float = 2000.0, limit: float = 30.0) -> Town:
    """One lane along x."""
    points = np.zeros((int(length) + 1, 3))
    points[:, 0] = np.linspace(0.0, length, len(points))
    return Town("straight", (Lane(0, points, 4.0, limit),), ())


def ego_on(town: Town, lanes: Sequence[int], s: float, speed: float = 0.0, lateral: float = 0.0) -> tuple[Ego, EgoPath]:
    """The ego on the first of `lanes`, which are its route."""
    lane = town.lanes[lanes[0]]
    x, y = (float(np.interp(s, lane.s, lane.points[:, k])) for k in (0, 1))
    heading = float(np.interp(s, lane.s, lane.heading))
    ego = Ego(x - lateral * np.sin(heading), y + lateral * np.cos(heading), 0.0, heading, speed)
    return ego, EgoPath(np.array(lanes, np.int32), 0, s, lateral)


FAR_AWAY = Ego(1e5, 1e5, 0.0, 0.0, 0.0)
"""An ego that nobody meets."""


def staged(town: Town, rows: Sequence[tuple[int, float, float]], ego: tuple[Ego, EgoPath] | None = None) -> Traffic:
    """Traffic with vehicles of 5 x 2 m at (lane, arc length, speed) and nobody else; without `ego`, far from it."""
    traffic = Traffic(town)
    start = ego or (FAR_AWAY, EgoPath(np.array([0], np.int32), 0, 5.0, 0.0))
    spare = (FAR_AWAY, EgoPath(np.array([len(town.lanes) - 1], np.int32), 0, 0.0, 0.0))
    traffic.reset(np.random.default_rng(0), len(rows), 0, *(start if len(rows) == 0 else spare))
    if len(traffic.actors) != len(rows):
        raise ValueError("the town is too small for the scene")
    cars = traffic._fleet.cars
    for i, (lane, s, speed) in enumerate(rows):
        cars[i]["s"], cars[i]["speed"] = s, speed
        cars[i]["length"], cars[i]["width"], cars[i]["eager"] = 5.0, 2.0, 1.0
        cars[i]["size"], cars[i]["admits"], cars[i]["count"], cars[i]["clear"] = 0, 1, 1, 0
        cars[i]["gate"] = cars[i]["halted"] = -1
        cars[i]["timer"] = 1e9  # No change of lane.
        traffic._fleet.path[i, 0] = lane
        traffic._fleet.trail[i] = -1
        place(traffic._tables.roads, cars[i], traffic._fleet.path[i], traffic._fleet.trail[i])
    traffic.actors.length[:], traffic.actors.width[:] = 5.0, 2.0
    return traffic


def bind(traffic: Traffic, vehicle: int, lanes: Sequence[int]) -> None:
    """Make a vehicle follow `lanes` from the one it is on."""
    traffic._fleet.path[vehicle, : len(lanes)] = lanes
    traffic._fleet.cars[vehicle]["count"] = len(lanes)


def set_lights(traffic: Traffic, state: Light) -> None:
    """Hold all signals in one state from now on."""
    count = len(traffic.town.signals)
    green, begin = {Light.GREEN: (1e9, 0.0), Light.RED: (0.0, -10.0)}[state]
    traffic._plan = SignalPlan(np.full(count, begin), np.full(count, green), np.full(count, 2e9))


def corners(x: float, y: float, heading: float, length: float, width: float) -> np.ndarray:
    """Corners (4, 2) of a box, counter-clockwise."""
    c, s = np.cos(heading), np.sin(heading)
    half = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) * np.array([length / 2, width / 2])
    return half @ np.array([[c, s], [-s, c]]) + np.array([x, y])


def overlap(a: np.ndarray, b: np.ndarray) -> bool:
    """Whether two convex polygons overlap: clip one by the other (Sutherland-Hodgman) and look at what is left."""
    subject = [tuple(p) for p in a]
    for start, end in pairwise([*b, b[0]]):
        edge = end - start
        side = [edge[0] * (p[1] - start[1]) - edge[1] * (p[0] - start[0]) for p in subject]
        clipped = []
        for k, p in enumerate(subject):
            q, sp, sq = subject[k - 1], side[k], side[k - 1]
            if (sp >= 0) != (sq >= 0):
                t = sq / (sq - sp)
                clipped.append((q[0] + t * (p[0] - q[0]), q[1] + t * (p[1] - q[1])))
            if sp >= 0:
                clipped.append(p)
        subject = clipped
        if not subject:
            return False
    x, y = np.array(subject).T
    return bool(0.5 * abs(np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1))) > 1e-6)


def box(actors: Actors, i: int) -> np.ndarray:
    """Corners of an actor."""
    return corners(actors.x[i], actors.y[i], actors.heading[i], actors.length[i], actors.width[i])


def ego_box(ego: Ego) -> np.ndarray:
    """Corners of the ego."""
    return corners(ego.x, ego.y, ego.heading, ego.length, ego.width)

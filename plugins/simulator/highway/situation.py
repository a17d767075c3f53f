"""The ego among roads, lights and traffic at one instant: worked out once per step, read by all."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from me3bev_cli.api import StepRecord
from me3bev_plugins.simulator.highway.collisions import Hit
from me3bev_plugins.simulator.highway.compiled import kernel
from me3bev_plugins.simulator.highway.ego import EgoVehicle
from me3bev_plugins.simulator.highway.features import NEAR_LIGHT
from me3bev_plugins.simulator.highway.infractions import Infractions
from me3bev_plugins.simulator.highway.reward import similarity
from me3bev_plugins.simulator.highway.routes import RouteTracker
from me3bev_plugins.simulator.highway.scene import Ego, Kind, Light, Scene
from me3bev_plugins.simulator.highway.town import Floats

TRAFFIC_RADIUS = 50.0
"""Metres within which the others' speed is averaged."""
LEVEL = 2.5
"""Vehicles farther apart in height do not count, metres."""
PEDESTRIAN = int(Kind.PEDESTRIAN)


class Situation(NamedTuple):
    """What the ego faces."""

    waypoints: Floats
    """(5, 3) the next ones, world, metres."""
    waypoint: tuple[float, float]
    """x and y of the first of them."""
    similarity: float
    """Cosine between heading and the direction to the next waypoint."""
    waypoint_distance: float
    """Metres to it."""
    limit: float
    """Speed limit of the ego's lane, m/s."""
    on_connector: bool
    """Whether that lane crosses a junction."""
    light: int
    """`Light` of the governed stop line ahead within 20 m."""


def assess(scene: Scene, ego: EgoVehicle, tracker: RouteTracker) -> Situation:
    """The situation of the ego now.

    Its lane is the route's while it keeps to the route within that lane's half width and half a metre, else
    the one that fits best under it.
    """
    town = scene.town
    index, _ = tracker.route.lane_at(tracker.progress)
    lane = town.lanes[int(tracker.route.lanes[index])]
    if tracker.off_route > lane.width / 2 + 0.5 and ego.place.lane >= 0:
        lane = town.lanes[ego.place.lane]
    waypoints = tracker.waypoints()
    next_x, next_y, _ = waypoints[0].tolist()
    here = scene.ego
    dx, dy = next_x - here.x, next_y - here.y
    signal = tracker.light_ahead(NEAR_LIGHT)
    return Situation(
        waypoints=waypoints,
        waypoint=(next_x, next_y),
        similarity=similarity(here.heading, dx, dy),
        waypoint_distance=math.hypot(dx, dy),
        limit=lane.limit,
        on_connector=lane.junction is not None,
        light=int(scene.lights[signal]) if signal >= 0 else int(Light.NONE),
    )


@kernel
def _gather_speeds(
    x: float,
    y: float,
    z: float,
    actors: tuple[NDArray[Any], NDArray[Any], NDArray[Any], NDArray[Any], NDArray[Any]],
    near: NDArray[Any],
    every: NDArray[Any],
) -> tuple[int, int]:
    """Put the speeds of the vehicles about a point first into `near`, those of all vehicles into `every`.

    Returns how many they are. `actors`: x y z kind speed.
    """
    xs, ys, zs, kinds, speeds = actors
    count = total = 0
    for i in range(len(xs)):
        if kinds[i] == PEDESTRIAN:
            continue
        every[total] = speeds[i]
        total += 1
        if abs(zs[i] - z) <= LEVEL and np.hypot(xs[i] - x, ys[i] - y) <= TRAFFIC_RADIUS:
            near[count] = speeds[i]
            count += 1
    return count, total


def traffic_speeds(scene: Scene) -> tuple[float, float]:
    """Mean speeds of the vehicles within 50 m of the ego, and of all of them, m/s; NaN when there are none."""
    ego, actors = scene.ego, scene.actors
    near, every = np.empty(len(actors)), np.empty(len(actors))
    columns = (actors.x, actors.y, actors.z, actors.kind, actors.speed)
    count, total = _gather_speeds(ego.x, ego.y, ego.z, columns, near, every)
    return _mean(near[:count]), _mean(every[:total])


def _mean(values: Floats) -> float:
    return float(np.add.reduce(values)) / len(values) if len(values) else math.nan


def step_record(
    *,
    time: float,
    ego: EgoVehicle,
    action: tuple[float, float],
    tracker: RouteTracker,
    situation: Situation,
    scene: Scene,
    off_road: bool,
    hit: Hit | None,
    broken: Infractions,
    lane_departure: bool,
    reward: float,
) -> StepRecord:
    """The report of one step. The lateral acceleration is that of the turn: speed times yaw rate."""
    pose: Ego = scene.ego
    near_speed, background_speed = traffic_speeds(scene)
    return StepRecord(
        time=time,
        x=pose.x,
        y=pose.y,
        heading=pose.heading,
        speed=pose.speed,
        acceleration=float(ego.acceleration),
        lateral_acceleration=float(pose.speed * ego.yaw_rate),
        yaw_rate=float(ego.yaw_rate),
        steering=action[0],
        longitudinal=action[1],
        waypoint_x=situation.waypoint[0],
        waypoint_y=situation.waypoint[1],
        similarity=situation.similarity,
        waypoint_distance=situation.waypoint_distance,
        speed_limit=situation.limit,
        traffic_speed=near_speed,
        background_speed=background_speed,
        route_done=min(tracker.progress, tracker.route.length),
        route_length=tracker.route.length,
        off_route=tracker.off_route,
        off_road=off_road,
        collision=hit.kind if hit else "",
        at_fault=bool(hit and hit.at_fault),
        contact=hit.contact if hit else "",
        red_light=broken.red_light,
        red_met=broken.red_met,
        stop_sign=broken.stop_sign,
        lane_departure=lane_departure,
        reward=reward,
    )

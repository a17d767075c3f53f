"""The ego among roads, lights and traffic at one instant: worked out once per step, read by all."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from me3bev_cli.api import StepRecord
from me3bev_plugins.simulator.highway.collisions import Hit
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


class Situation(NamedTuple):
    """What the ego faces."""

    waypoints: Floats
    """(5, 3) the next ones, world, metres."""
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
    dx, dy = float(waypoints[0, 0]) - ego.x, float(waypoints[0, 1]) - ego.y
    signal = tracker.light_ahead(NEAR_LIGHT)
    return Situation(
        waypoints=waypoints,
        similarity=similarity(ego.heading, dx, dy),
        waypoint_distance=math.hypot(dx, dy),
        limit=lane.limit,
        on_connector=lane.junction is not None,
        light=int(scene.lights[signal]) if signal >= 0 else int(Light.NONE),
    )


def traffic_speed(scene: Scene) -> float:
    """Mean speed of the vehicles within 50 m of the ego, m/s; NaN when there are none."""
    ego, actors = scene.ego, scene.actors
    near = np.hypot(actors.x - ego.x, actors.y - ego.y) <= TRAFFIC_RADIUS
    near &= (np.abs(actors.z - ego.z) <= LEVEL) & (actors.kind != Kind.PEDESTRIAN)
    return float(actors.speed[near].mean()) if near.any() else math.nan


def step_record(
    *,
    time: float,
    ego: EgoVehicle,
    action: Floats,
    tracker: RouteTracker,
    situation: Situation,
    scene: Scene,
    off_road: bool,
    hit: Hit | None,
    broken: Infractions,
    reward: float,
) -> StepRecord:
    """The report of one step. The lateral acceleration is that of the turn: speed times yaw rate."""
    pose: Ego = scene.ego
    return StepRecord(
        time=time,
        x=pose.x,
        y=pose.y,
        heading=pose.heading,
        speed=pose.speed,
        acceleration=float(ego.acceleration),
        lateral_acceleration=float(pose.speed * ego.yaw_rate),
        yaw_rate=float(ego.yaw_rate),
        steering=float(action[0]),
        longitudinal=float(action[1]),
        waypoint_x=float(situation.waypoints[0, 0]),
        waypoint_y=float(situation.waypoints[0, 1]),
        similarity=situation.similarity,
        waypoint_distance=situation.waypoint_distance,
        speed_limit=situation.limit,
        traffic_speed=traffic_speed(scene),
        route_done=min(tracker.progress, tracker.route.length),
        route_length=tracker.route.length,
        off_route=tracker.off_route,
        off_road=off_road,
        collision=hit.kind if hit else "",
        at_fault=bool(hit and hit.at_fault),
        red_light=broken.red_light,
        stop_sign=broken.stop_sign,
        reward=reward,
    )

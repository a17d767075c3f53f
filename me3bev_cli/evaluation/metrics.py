"""The metrics: pure functions of an episode's log, as `definitions` says.

A metric may be NaN for an episode that says nothing about it; averages leave it out and count what is left.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from me3bev_cli.evaluation.comfort import comfortable_share, published_share
from me3bev_cli.evaluation.definitions import (
    CHECKPOINTS,
    HORIZON,
    METRICS,
    MOST_EFFICIENT,
    PAPER,
    PENALTIES,
    RED_LIGHT,
    STOP_SIGN,
)
from me3bev_cli.evaluation.episode import Episode

__all__ = ["FUNCTIONS", "HORIZON", "METRICS", "PAPER", "driving_score", "measure"]


def collisions(episode: Episode) -> dict[str, int]:
    """Number of collisions by kind: consecutive steps of contact with one kind are one collision."""
    first = _first_contacts(episode)
    return {kind: int(np.count_nonzero(first & (episode["collision"] == kind))) for kind in PENALTIES}


def _first_contacts(episode: Episode) -> NDArray[np.bool_]:
    """Steps (T,) in which a collision begins."""
    kinds = episode["collision"]
    return np.asarray(np.append(True, kinds[1:] != kinds[:-1]) & (kinds != ""))


def collision_rate(episode: Episode) -> float:
    return float(np.any(episode["collision"] != ""))


def vehicle_collision_rate(episode: Episode) -> float:
    return float(np.any(episode["collision"] == "vehicle"))


def pedestrian_collision_rate(episode: Episode) -> float:
    return float(np.any(episode["collision"] == "pedestrian"))


def static_collision_rate(episode: Episode) -> float:
    return float(np.any(episode["collision"] == "static"))


def at_fault_collision_rate(episode: Episode) -> float:
    return float(np.any((episode["collision"] != "") & episode["at_fault"]))


def at_fault_share(episode: Episode) -> float:
    first = _first_contacts(episode)
    return float(np.mean(episode["at_fault"][first])) if first.any() else math.nan


def similarity(episode: Episode) -> float:
    return float(np.mean(episode["similarity"]))


def timesteps(episode: Episode) -> float:
    return float(len(episode))


def waypoint_distance(episode: Episode) -> float:
    return float(np.mean(episode["waypoint_distance"]))


def efficiency(episode: Episode) -> float:
    near = ~np.isnan(episode["traffic_speed"])
    others = float(np.mean(episode["traffic_speed"][near])) if near.any() else 0.0
    own = float(np.mean(episode["speed"][near])) if near.any() else 0.0
    return own / others if others > 0 and own <= MOST_EFFICIENT * others else math.nan


def efficiency_bench2drive(episode: Episode) -> float:
    length = float(episode["route_length"][-1])
    if not episode.has("background_speed") or length <= 0:
        return math.nan
    done = np.maximum.accumulate(np.maximum(episode["route_done"], 0.0))
    # Step t belongs to the checkpoint that was next before it.
    next_one = np.floor(CHECKPOINTS * np.append(0.0, done[:-1]) / length)
    passed = CHECKPOINTS if episode.finished else math.floor(CHECKPOINTS * done[-1] / length)
    values = []
    for checkpoint in range(passed):
        steps = (next_one == checkpoint) & ~np.isnan(episode["background_speed"])
        others = float(np.sum(episode["background_speed"][steps]))
        if others > 0:
            values.append(100.0 * float(np.sum(episode["speed"][steps])) / others)
    kept = [value for value in values if value <= 100.0 * MOST_EFFICIENT]
    return float(np.mean(kept)) if kept else math.nan


def comfort(episode: Episode) -> float:
    return comfortable_share(
        episode["acceleration"], episode["lateral_acceleration"], episode["yaw_rate"], episode.step_seconds
    )


def comfort_bench2drive(episode: Episode) -> float:
    return published_share(
        episode["acceleration"], episode["lateral_acceleration"], episode["yaw_rate"], episode.step_seconds
    )


def route_completion(episode: Episode) -> float:
    if episode.finished:
        return 1.0
    length = float(episode["route_length"][-1])
    return min(1.0, _farthest(episode) / length) if length > 0 else math.nan


def _farthest(episode: Episode) -> float:
    """Progress along the route, m."""
    return max(0.0, float(np.max(episode["route_done"])))


def relative_progress(episode: Episode, autopilot: Episode | None) -> float:
    """Beside the autopilot's episode of the same seed."""
    if autopilot is None or _farthest(autopilot) <= 0:
        return math.nan
    return _farthest(episode) / _farthest(autopilot)


def off_road(episode: Episode) -> float:
    """By distance; a car that stands still off the road has not driven there."""
    travelled = np.abs(episode["speed"])
    total = float(travelled.sum())
    return float(travelled[episode["off_road"]].sum()) / total if total > 0 else 0.0


def penalty(episode: Episode) -> float:
    """The product of Bench2Drive's factors, 1 for a drive without a fault."""
    product = RED_LIGHT ** red_lights(episode) * STOP_SIGN ** stop_signs(episode)
    for kind, count in collisions(episode).items():
        product *= PENALTIES[kind] ** count
    return product * (1.0 - off_road(episode))


def driving_score(episode: Episode) -> float:
    return 100.0 * route_completion(episode) * penalty(episode)


def paper_score(episode: Episode) -> float:
    return 100.0 * min(1.0, len(episode) / HORIZON) * 0.6 ** collision_rate(episode)


def success(episode: Episode) -> float:
    return float(episode.finished and penalty(episode) == 1.0)


def red_lights(episode: Episode) -> float:
    return float(np.count_nonzero(episode["red_light"]))


def red_light_violation_rate(episode: Episode) -> float:
    met = int(np.count_nonzero(episode["red_met"])) if episode.has("red_met") else 0
    return red_lights(episode) / met if met else math.nan


def stop_signs(episode: Episode) -> float:
    return float(np.count_nonzero(episode["stop_sign"]))


def lane_departures(episode: Episode) -> float:
    return float(np.count_nonzero(episode["lane_departure"]))


def mean_speed(episode: Episode) -> float:
    return float(np.mean(episode["speed"]))


def return_per_step(episode: Episode) -> float:
    return float(np.mean(episode["reward"]))


FUNCTIONS: dict[str, Callable[[Episode], float]] = {
    function.__name__: function
    for function in (
        collision_rate,
        similarity,
        timesteps,
        waypoint_distance,
        efficiency,
        comfort,
        driving_score,
        route_completion,
        success,
        vehicle_collision_rate,
        pedestrian_collision_rate,
        static_collision_rate,
        at_fault_collision_rate,
        at_fault_share,
        red_lights,
        red_light_violation_rate,
        stop_signs,
        lane_departures,
        off_road,
        efficiency_bench2drive,
        comfort_bench2drive,
        mean_speed,
        return_per_step,
        paper_score,
    )
}
"""Every metric of one episode alone, by name."""


def measure(episode: Episode, autopilot: Episode | None = None) -> dict[str, float]:
    """Every metric of an episode, in the order of `METRICS`.

    Args:
        autopilot: the autopilot's episode of the same seed, where it has driven it.
    """
    found = {name: function(episode) for name, function in FUNCTIONS.items()}
    found["relative_progress"] = relative_progress(episode, autopilot)
    return {name: found[name] for name in METRICS}

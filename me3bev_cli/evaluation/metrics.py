"""The metrics: pure functions of an episode, and the table that says what each of them is.

A metric may be NaN for an episode that says nothing about it; averages leave it out and count what is left.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from me3bev_cli.evaluation.comfort import comfortable_share
from me3bev_cli.evaluation.episode import Episode

HORIZON = 128
"""Steps of the paper's episodes."""

PENALTIES = {"pedestrian": 0.5, "vehicle": 0.6, "static": 0.65}
"""Bench2Drive's factor for each collision, by kind."""
RED_LIGHT, STOP_SIGN = 0.7, 0.8
"""Bench2Drive's factors for each of these."""
MOST_EFFICIENT = 10.0
"""Ratios above it are dropped, as Bench2Drive drops 1000 %: next to traffic that stands, they say nothing."""


@dataclass(frozen=True)
class Metric:
    """What a figure means. `version` rises when `function` changes; figures of different versions do not compare."""

    name: str
    label: str
    unit: str
    direction: Literal["higher", "lower", "neither"]
    """Which is better."""
    formula: str
    source: str
    function: Callable[[Episode], float]
    version: int = 1
    digits: int = 2
    """Decimals in tables for people."""


def collisions(episode: Episode) -> dict[str, int]:
    """Number of collisions by kind: consecutive steps of contact with one kind are one collision."""
    kinds = episode["collision"]
    begins = np.append(True, kinds[1:] != kinds[:-1])
    return {kind: int(np.count_nonzero(begins & (kinds == kind))) for kind in PENALTIES}


def collision_rate(episode: Episode) -> float:
    return float(np.any(episode["collision"] != ""))


def at_fault_collision_rate(episode: Episode) -> float:
    return float(np.any((episode["collision"] != "") & episode["at_fault"]))


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


def comfort(episode: Episode) -> float:
    return comfortable_share(
        episode["acceleration"], episode["lateral_acceleration"], episode["yaw_rate"], episode.step_seconds
    )


def route_completion(episode: Episode) -> float:
    if episode.finished:
        return 1.0
    length = float(episode["route_length"][-1])
    return min(1.0, max(0.0, float(np.max(episode["route_done"])) / length)) if length > 0 else math.nan


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


def stop_signs(episode: Episode) -> float:
    return float(np.count_nonzero(episode["stop_sign"]))


def lane_departures(episode: Episode) -> float:
    return float(np.count_nonzero(episode["lane_departure"]))


def mean_speed(episode: Episode) -> float:
    return float(np.mean(episode["speed"]))


def return_per_step(episode: Episode) -> float:
    return float(np.mean(episode["reward"]))


_PAPER = "ME3-BEV, evaluation metrics"
_BENCH2DRIVE = "Bench2Drive"
_OWN = "me3bev"

_ALL = (
    Metric(
        "collision_rate", "collision rate", "share of episodes", "lower",
        "1 for an episode with a collision, else 0", _PAPER, collision_rate,
    ),
    Metric(
        "similarity", "similarity", "cosine", "higher",
        "mean over steps of the cosine between heading and the direction to the next waypoint", _PAPER, similarity,
    ),
    Metric(
        "timesteps", "timesteps", "steps", "higher",
        "steps until the route is finished, a collision, or the horizon", _PAPER, timesteps, digits=0,
    ),
    Metric(
        "waypoint_distance", "waypoint distance", "m", "lower",
        "mean over steps of the distance to the next waypoint", _PAPER, waypoint_distance,
    ),
    Metric(
        "efficiency", "efficiency", "ratio", "higher",
        "mean speed of the ego over mean speed of the vehicles within 50 m, both over the steps in which there are "
        "any; left out when there are none, when they stand, and above 10",
        f"{_PAPER}; {_BENCH2DRIVE}'s limit", efficiency,
    ),
    Metric(
        "comfort", "comfort", "share of segments", "higher",
        "share of the 20-frame segments (remainder dropped) in which, smoothed by a Savitzky-Golay filter (window 7, "
        "order 2), longitudinal acceleration stays in (-4.05, 2.40) m/s2, |lateral acceleration| < 4.89 m/s2, "
        "|jerk| < 8.37 m/s3, |longitudinal jerk| < 4.13 m/s3, |yaw rate| < 0.95 rad/s and |yaw acceleration| < 1.93 "
        "rad/s2; left out for episodes under 20 frames",
        f"{_PAPER}; {_BENCH2DRIVE}'s bounds, with the yaw acceleration derived from the yaw rate", comfort,
    ),
    Metric(
        "driving_score", "driving score", "0-100", "higher",
        "100 x route completion x product over events (pedestrian 0.5, vehicle 0.6, static 0.65, red light 0.7, "
        "stop sign 0.8) x (1 - share of the distance driven off the road)", _BENCH2DRIVE, driving_score, digits=1,
    ),
    Metric(
        "route_completion", "route completion", "share of route", "higher",
        "farthest progress along the route over its length", _BENCH2DRIVE, route_completion,
    ),
    Metric(
        "success", "success", "share of episodes", "higher",
        "1 for a route finished without any penalty of the driving score, else 0", _BENCH2DRIVE, success,
    ),
    Metric(
        "at_fault_collision_rate", "at-fault collisions", "share of episodes", "lower",
        "1 for an episode in which the ego's front ran into something, else 0", _OWN, at_fault_collision_rate,
    ),
    Metric(
        "red_lights", "red lights run", "per episode", "lower",
        "stop lines crossed on red", _OWN, red_lights,
    ),
    Metric(
        "stop_signs", "stop signs run", "per episode", "lower",
        "stop signs passed without a stop", _OWN, stop_signs,
    ),
    Metric(
        "lane_departures", "lane departures", "per episode", "lower",
        "times the ego's centre left its lane for the opposite direction or for no road at all, outside junctions",
        _OWN, lane_departures,
    ),
    Metric(
        "off_road", "off road", "share of distance", "lower",
        "distance driven off the road over distance driven", _OWN, off_road,
    ),
    Metric(
        "mean_speed", "mean speed", "m/s", "neither",
        "mean over steps of the ego's speed", _OWN, mean_speed,
    ),
    Metric(
        "return_per_step", "return per step", "reward", "higher",
        "mean over steps of the reward", _OWN, return_per_step,
    ),
    Metric(
        "paper_score", "paper score", "0-100", "higher",
        "100 x min(1, steps / 128) x 0.6 after a collision: how the paper's published driving scores behave; a car "
        "that never moves gets 100",
        "fitted to the paper's tables", paper_score, digits=1,
    ),
)  # fmt: skip

METRICS = {metric.name: metric for metric in _ALL}
"""Every metric by name, the paper's seven first."""

PAPER = tuple(METRICS)[:7]
"""The seven of the paper's tables."""


def measure(episode: Episode) -> dict[str, float]:
    """Every metric of an episode."""
    return {name: metric.function(episode) for name, metric in METRICS.items()}

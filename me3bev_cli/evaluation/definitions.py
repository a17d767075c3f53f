"""What a metric means: formula, unit, direction, source and version. No figure is computed here, so it loads fast.

A metric's full name carries its version (`driving_score v1`), which rises when what is computed changes: figures of
different versions do not compare.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from me3bev_cli import comfort_bounds as bounds

HORIZON = 128
"""Steps of the paper's episodes."""

PENALTIES = {"pedestrian": 0.5, "vehicle": 0.6, "static": 0.65}
"""Bench2Drive's factor for each collision, by kind."""
RED_LIGHT, STOP_SIGN = 0.7, 0.8
"""Bench2Drive's factors for each of these."""
MOST_EFFICIENT = 10.0
"""Ratios above it are dropped, as Bench2Drive drops 1000 %: next to traffic that stands, they say nothing."""
CHECKPOINTS = 20
"""Of a route, at which Bench2Drive takes the efficiency."""

_PAPER = "ME3-BEV, evaluation metrics"
_BENCH2DRIVE = "Bench2Drive"
_OWN = "me3bev"


@dataclass(frozen=True)
class Metric:
    """What a figure means."""

    name: str
    label: str
    unit: str
    direction: Literal["higher", "lower", "neither"]
    """Which is better."""
    formula: str
    source: str = _OWN
    version: int = 1
    digits: int = 2
    """Decimals in tables for people."""

    @property
    def full_name(self) -> str:
        """The name with its version."""
        return f"{self.name} v{self.version}"


_RATE, _EPISODE = "share of episodes", "per episode"
_BOUNDS = (
    f"longitudinal acceleration in ({bounds.ACCELERATION[0]:.2f}, {bounds.ACCELERATION[1]:.2f}) m/s2, "
    f"|lateral acceleration| < {bounds.LATERAL} m/s2, |jerk| < {bounds.JERK} m/s3, "
    f"|longitudinal jerk| < {bounds.LONGITUDINAL_JERK} m/s3, |yaw rate| < {bounds.YAW_RATE} rad/s "
    f"and |yaw acceleration| < {bounds.YAW_ACCELERATION} rad/s2"
)

_ALL = (
    Metric(
        "collision_rate", "collision rate", _RATE, "lower", "1 for an episode with a collision, else 0", _PAPER
    ),
    Metric(
        "similarity", "similarity", "cosine", "higher",
        "mean over steps of the cosine between heading and the direction to the next waypoint", _PAPER,
    ),
    Metric(
        "timesteps", "timesteps", "steps", "higher",
        "steps until the route is finished, a collision, or the horizon", _PAPER, digits=0,
    ),
    Metric(
        "waypoint_distance", "waypoint distance", "m", "lower",
        "mean over steps of the distance to the next waypoint", _PAPER,
    ),
    Metric(
        "efficiency", "efficiency", "ratio", "higher",
        "mean speed of the ego over mean speed of the vehicles within 50 m, both over the steps in which there are "
        "any; left out when there are none, when they stand, and above 10",
        f"{_PAPER}; {_BENCH2DRIVE}'s limit",
    ),
    Metric(
        "comfort", "comfort", "share of segments", "higher",
        "share of the 20-frame segments (remainder dropped) in which every frame, smoothed by a Savitzky-Golay filter "
        f"(window 7, order 2, derivatives from the same parabolas), has {_BOUNDS}; left out under 20 frames",
        f"{_PAPER}; {_BENCH2DRIVE}'s bounds, with the yaw acceleration derived from the yaw rate",
    ),
    Metric(
        "driving_score", "driving score", "0-100", "higher",
        "100 x route completion x product over events (pedestrian 0.5, vehicle 0.6, static 0.65, red light 0.7, "
        "stop sign 0.8) x (1 - share of the distance driven off the road)", _BENCH2DRIVE, digits=1,
    ),
    Metric(
        "route_completion", "route completion", "share of route", "higher",
        "farthest progress along the route over its length", _BENCH2DRIVE,
    ),
    Metric(
        "success", "success", _RATE, "higher",
        "1 for a route finished without any penalty of the driving score, else 0", _BENCH2DRIVE,
    ),
    Metric(
        "relative_progress", "progress / autopilot's", "ratio", "higher",
        "farthest progress along the route over the autopilot's in the episode of the same seed; left out where the "
        "autopilot has not driven it or does not get away",
    ),
    Metric(
        "vehicle_collision_rate", "vehicle collisions", _RATE, "lower",
        "1 for an episode with a collision with a vehicle, else 0",
    ),
    Metric(
        "pedestrian_collision_rate", "pedestrian collisions", _RATE, "lower",
        "1 for an episode with a collision with a pedestrian, else 0",
    ),
    Metric(
        "static_collision_rate", "static collisions", _RATE, "lower",
        "1 for an episode with a collision with something that never moves, else 0",
    ),
    Metric(
        "at_fault_collision_rate", "at-fault collisions", _RATE, "lower",
        "1 for an episode in which the ego's front ran into something, else 0",
    ),
    Metric(
        "at_fault_share", "share at fault", "share of collisions", "lower",
        "share of the episode's collisions in which the ego's front ran into something; left out without a collision",
    ),
    Metric("red_lights", "red lights run", _EPISODE, "lower", "stop lines crossed on red"),
    Metric(
        "red_light_violation_rate", "reds run when met", "share of red lights", "lower",
        "stop lines crossed on red over lights met on red (seen red on the ego's own lane, at most 20 m before the "
        "stop line; each once until its line is crossed); left out when none is met",
    ),
    Metric("stop_signs", "stop signs run", _EPISODE, "lower", "stop signs passed without a stop"),
    Metric(
        "lane_departures", "lane departures", _EPISODE, "lower",
        "times the ego's centre left its lane for the opposite direction or for no road at all, outside junctions",
    ),
    Metric(
        "off_road", "off road", "share of distance", "lower", "distance driven off the road over distance driven"
    ),
    Metric(
        "efficiency_bench2drive", "efficiency (B2D)", "%", "higher",
        "mean over the checkpoints passed of 20 along the route of 100 x mean speed of the ego over mean speed of all "
        "other vehicles since the checkpoint before; values above 1000 dropped, and those beside traffic that stands; "
        "left out when no value remains", _BENCH2DRIVE, digits=0,
    ),
    Metric(
        "comfort_bench2drive", "comfort (B2D)", "share of segments", "higher",
        f"as comfort, but as {_BENCH2DRIVE}'s tool computes it: the smoothed yaw rate stands for the yaw acceleration, "
        "the rate of the acceleration's magnitude for |jerk|, both jerks come from smoothed accelerations, yaw rates "
        "are unwrapped like angles, and an episode of at most 20 frames is one segment; left out under 3 frames",
        f"{_BENCH2DRIVE}, bug for bug",
    ),
    Metric("mean_speed", "mean speed", "m/s", "neither", "mean over steps of the ego's speed"),
    Metric("return_per_step", "return per step", "reward", "higher", "mean over steps of the reward"),
    Metric(
        "paper_score", "paper score", "0-100", "higher",
        "100 x min(1, steps / 128) x 0.6 after a collision: how the paper's published driving scores behave; a car "
        "that never moves gets 100", "fitted to the paper's tables", digits=1,
    ),
)  # fmt: skip

METRICS = {metric.name: metric for metric in _ALL}
"""Every metric by name, the paper's seven first."""

PAPER = tuple(METRICS)[:7]
"""The seven of the paper's tables."""

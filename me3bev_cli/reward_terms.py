"""Named terms that a recipe may add to the reward: pure functions of two consecutive step records, for any simulator.

What is learned from is the simulator's reward (the paper's equation in Section 3.1) plus the sum of weight x term.
Each term's sign is such that a positive weight rewards what is wanted: `progress` is a gain, the others are costs, at
most 0. All weights are 0 unless the recipe says otherwise; what is logged as `reward_per_step` never holds them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from me3bev_cli.api import StepRecord
from me3bev_cli.comfort_bounds import ACCELERATION, LATERAL, LONGITUDINAL_JERK

LANE = 3.5
"""Metres: the width of a lane."""

Function = Callable[[StepRecord | None, StepRecord], float]
"""(the record of the step before, None at the first of an episode; the record of this step) -> the term's value."""


def progress(before: StepRecord | None, now: StepRecord) -> float:
    """Metres along the route gained in the step, positive forwards: s(t) - s(t - 1); 0 at an episode's first step."""
    return now["route_done"] - before["route_done"] if before is not None else 0.0


def lane_keeping(before: StepRecord | None, now: StepRecord) -> float:
    """- distance from the route's centre line in lane widths of 3.5 m, at least -1, and -1 off the road: -1 to 0."""
    return -1.0 if now["off_road"] else -min(1.0, abs(now["off_route"]) / LANE)


def comfort(before: StepRecord | None, now: StepRecord) -> float:
    """How far three quantities are beyond their bounds, as a share of the bound, each at most 1: -3 to 0.

    - min(1, max(0, |q| / bound - 1)), summed over q: longitudinal acceleration, lateral acceleration, and longitudinal
    jerk, which is the change of acceleration since the step before over the time between the two, 0 at an episode's
    first step. The bounds are those of `comfort_bounds`.
    """
    pull = now["acceleration"]
    cost = _beyond(pull, ACCELERATION[0] if pull < 0 else ACCELERATION[1])
    cost += _beyond(now["lateral_acceleration"], LATERAL)
    if before is not None and now["time"] > before["time"]:
        cost += _beyond((pull - before["acceleration"]) / (now["time"] - before["time"]), LONGITUDINAL_JERK)
    return -cost


def _beyond(value: float, bound: float) -> float:
    return min(1.0, max(0.0, abs(value) / abs(bound) - 1.0))


def speeding(before: StepRecord | None, now: StepRecord) -> float:
    """- speed above the limit, m/s: -max(0, v_c - v_m)."""
    return -max(0.0, now["speed"] - now["speed_limit"])


def red_light(before: StepRecord | None, now: StepRecord) -> float:
    """-1 in the step in which the ego crosses a stop line on red."""
    return -float(now["red_light"])


def stop_sign(before: StepRecord | None, now: StepRecord) -> float:
    """-1 in the step in which the ego runs a stop sign."""
    return -float(now["stop_sign"])


def lane_departure(before: StepRecord | None, now: StepRecord) -> float:
    """-1 in the step in which the ego leaves its lane for the opposite direction or for no road at all."""
    return -float(now["lane_departure"])


def collision(before: StepRecord | None, now: StepRecord) -> float:
    """-1 in the step of a collision, whoever is to blame; the simulator's own penalty comes on top."""
    return -float(now["collision"] != "")


@dataclass(frozen=True)
class Term:
    """A term as a recipe offers it."""

    function: Function
    unit: str
    """Of the value; the weight is reward per this."""
    summary: str
    """Formula and sign, for the recipe's schema."""


TERMS = {
    "progress": Term(progress, "m", "+ metres along the route gained in the step"),
    "lane_keeping": Term(
        lane_keeping, "lane widths", "- distance from the route's centre line / 3.5 m, at least -1; -1 off the road"
    ),
    "comfort": Term(
        comfort,
        "share of the bound",
        f"- excess of longitudinal acceleration ({ACCELERATION[0]:.2f} to {ACCELERATION[1]:.2f} m/s2), lateral "
        f"acceleration ({LATERAL} m/s2) and longitudinal jerk ({LONGITUDINAL_JERK} m/s3) over the bound, as a share of "
        "it, each at most 1",
    ),
    "speeding": Term(speeding, "m/s", "- speed above the limit"),
    "red_light": Term(red_light, "event", "-1 where a stop line is crossed on red"),
    "stop_sign": Term(stop_sign, "event", "-1 where a stop sign is run"),
    "lane_departure": Term(
        lane_departure, "event", "-1 where the lane is left for the opposite direction or for no road"
    ),
    "collision": Term(collision, "event", "-1 in the step of a collision, on top of the simulator's penalty"),
}
"""Every term by the name that a recipe gives its weight under."""


def bonus(weights: Mapping[str, float], before: StepRecord | None, now: StepRecord) -> float:
    """What is added to a step's reward: the sum of weight x term.

    Args:
        weights: of some of `TERMS`.
        before: the record of the step before; None at the first of an episode.
        now: the record of this step.
    """
    return sum(weight * TERMS[name].function(before, now) for name, weight in weights.items())


def formula(weights: Mapping[str, float]) -> str:
    """The reward that is learned from, in words for people."""
    parts = [f"{weight:g} x {name} ({TERMS[name].unit})" for name, weight in weights.items()]
    return " + ".join(["the paper's", *parts])

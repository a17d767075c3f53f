"""The rule-based driver's hands, pure pursuit along the route, and its patience at red lights."""

from __future__ import annotations

import math

import numpy as np

from me3bev_plugins.simulator.highway.ego import STEERING, EgoVehicle
from me3bev_plugins.simulator.highway.routes import RouteTracker

LOOK_AHEAD_TIME = 0.35
"""Seconds of travel to the point that is steered for."""
LOOK_AHEAD = (2.0, 14.0)
"""Its least and greatest distance, metres."""
CREEP = 3.0
"""Slower than this, m/s, it does not draw nearer to a red light."""
PATIENCE = -2.5
"""But stops with this acceleration, m/s^2."""


def pursue(x: float, y: float, length: float) -> float:
    """The wheel angle whose arc leads the vehicle's centre through a point, radians, left positive.

    The centre moves at slip angle b = atan(tan(wheel) / 2) to the heading, on an arc of curvature
    2 sin(b) / length. The arc through a point at distance d and bearing a has curvature 2 sin(a - b) / d; the
    two are equal for tan(b) = length sin(a) / (d + length cos(a)).

    Args:
        x, y: the point in the ego frame, metres.
        length: of the bicycle, metres.
    """
    distance = math.hypot(x, y)
    slip = math.atan2(length * y, distance * distance + length * x)
    if abs(slip) > math.pi / 2 - 1e-3:
        return math.copysign(math.pi / 2, slip)
    return math.atan(2.0 * math.tan(slip))


def steer(ego: EgoVehicle, tracker: RouteTracker) -> float:
    """The steering action in [-1, 1] that keeps the ego on its route."""
    ahead = float(np.clip(LOOK_AHEAD_TIME * ego.speed, *LOOK_AHEAD)) + abs(tracker.lateral)
    target = tracker.route.positions(np.array([tracker.progress + ahead]))[0]
    dx, dy = target[0] - ego.x, target[1] - ego.y
    c, s = math.cos(ego.heading), math.sin(ego.heading)
    angle = pursue(dx * c + dy * s, dy * c - dx * s, ego.LENGTH)
    return float(np.clip(angle / STEERING, -1.0, 1.0))


def wait_at_red(advice: float, speed: float, red: bool) -> float:
    """An acceleration (m/s^2) that has a slow driver stop, and one who stands wait, where it is told of a red light.

    Whoever has stopped too early could as well go up to the line, and whose front is past it should go on. But neither
    can be told from what is observed: who copied that advice would creep over the line.

    Args:
        advice: m/s^2, as it would be without.
        speed: of the ego, m/s.
        red: whether the light that is observed is red.
    """
    return min(advice, PATIENCE) if red and speed < CREEP else advice

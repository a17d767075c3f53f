"""The reward of Section 3.1."""

from __future__ import annotations

import math


def similarity(heading: float, dx: float, dy: float) -> float:
    """Cosine of the angle between a heading (radians) and the direction (dx, dy) to a waypoint, metres.

    1 when the waypoint is reached (nearer than a micrometre), where there is no direction.
    """
    distance = math.hypot(dx, dy)
    if distance < 1e-6:
        return 1.0
    cosine = (dx * math.cos(heading) + dy * math.sin(heading)) / distance
    return min(1.0, max(-1.0, cosine))


def reward(
    *, collision: bool, speed: float, limit: float, similarity: float, distance: float, collision_penalty: float
) -> float:
    """The reward of one step.

        -k_c                       after a collision
        v_m - v_c                  when v_c > v_m
        4 v_c v_s / ||p_c - p_w||^2   otherwise

    The last quotient grows without bound near a waypoint, so its divisor (d / 2)^2 is not let below 1: within
    2 m the reward is v_c v_s.

    Args:
        collision: whether this step ended in a collision.
        speed: v_c, m/s.
        limit: v_m, m/s.
        similarity: v_s, cosine between heading and direction to the next waypoint.
        distance: d = ||p_c - p_w||, metres to the next waypoint.
        collision_penalty: k_c.
    """
    if collision:
        return -collision_penalty
    if speed > limit:
        return limit - speed
    return speed * similarity / max(1.0, (distance / 2.0) ** 2)

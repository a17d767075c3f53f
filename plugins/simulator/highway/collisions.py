"""What the ego hits: oriented boxes against actors, buildings, trees and poles, and who ran into whom."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from me3bev_plugins.simulator.highway.scene import Actors, Ego, Kind
from me3bev_plugins.simulator.highway.town import Floats, Town

LEVEL = 2.5
"""Actors farther apart in height do not meet, metres."""
MOVING = 0.1
"""Slower than this the ego runs into nothing, m/s."""


class Hit(NamedTuple):
    """A collision of the ego."""

    kind: str
    """vehicle, pedestrian or static."""
    at_fault: bool
    """True when the ego was moving and its front ran into the other, or it ran into something static."""
    contact: str
    """Where on the ego the middle of the shared area lies: front or rear, the last quarter of its length each, or side.
    """


@njit(cache=True)
def boxes_overlap(a: tuple[float, float, float, float, float], b: tuple[float, float, float, float, float]) -> bool:
    """Whether two boxes (x, y, heading, length, width) share a point: no separating axis among the four."""
    dx, dy = b[0] - a[0], b[1] - a[1]
    ca, sa, cb, sb = np.cos(a[2]), np.sin(a[2]), np.cos(b[2]), np.sin(b[2])
    along, across = abs(ca * cb + sa * sb), abs(sa * cb - ca * sb)
    la, wa, lb, wb = a[3] / 2, a[4] / 2, b[3] / 2, b[4] / 2
    return bool(
        abs(dx * ca + dy * sa) <= la + lb * along + wb * across
        and abs(dy * ca - dx * sa) <= wa + lb * across + wb * along
        and abs(dx * cb + dy * sb) <= lb + la * along + wa * across
        and abs(dy * cb - dx * sb) <= wb + la * across + wa * along
    )


@njit(cache=True)
def _hit_actor(
    ego: tuple[float, float, float, float, float],
    z: float,
    ax: NDArray[Any],
    ay: NDArray[Any],
    az: NDArray[Any],
    heading: NDArray[Any],
    length: NDArray[Any],
    width: NDArray[Any],
) -> int:
    """Index of the nearest actor whose box overlaps the ego's, or -1."""
    best, nearest = -1, np.inf
    for i in range(len(ax)):
        away = np.hypot(ax[i] - ego[0], ay[i] - ego[1])
        if away > (ego[3] + ego[4] + length[i] + width[i]) / 2 or abs(az[i] - z) > LEVEL or away >= nearest:
            continue
        if boxes_overlap(ego, (ax[i], ay[i], heading[i], length[i], width[i])):
            best, nearest = i, away
    return best


@njit(cache=True)
def _hit_static(ego: tuple[float, float, float, float, float], boxes: NDArray[Any], discs: NDArray[Any]) -> int:
    """Which of `boxes` (B, 5) or, from B on, of `discs` (D, 3: x, y, radius) the ego overlaps; -1 for none."""
    reach = (ego[3] + ego[4]) / 2
    for i in range(len(boxes)):
        far = reach + (boxes[i, 3] + boxes[i, 4]) / 2
        if abs(boxes[i, 0] - ego[0]) > far or abs(boxes[i, 1] - ego[1]) > far:
            continue
        if boxes_overlap(ego, (boxes[i, 0], boxes[i, 1], boxes[i, 2], boxes[i, 3], boxes[i, 4])):
            return i
    c, s = np.cos(ego[2]), np.sin(ego[2])
    for i in range(len(discs)):
        dx, dy = discs[i, 0] - ego[0], discs[i, 1] - ego[1]
        if abs(dx) > reach + discs[i, 2] or abs(dy) > reach + discs[i, 2]:
            continue
        x = max(abs(dx * c + dy * s) - ego[3] / 2, 0.0)
        y = max(abs(dy * c - dx * s) - ego[4] / 2, 0.0)
        if x * x + y * y <= discs[i, 2] ** 2:
            return len(boxes) + i
    return -1


def contact_ahead(ego: Ego, x: float, y: float, heading: float, length: float, width: float) -> float:
    """Where the ego touches a box: metres ahead of the ego's centre of the middle of the shared area.

    The other box is clipped to the ego's, in the ego's frame; with no shared area, its centre counts.
    """
    c, s = np.cos(heading - ego.heading), np.sin(heading - ego.heading)
    dx, dy = x - ego.x, y - ego.y
    ce, se = np.cos(ego.heading), np.sin(ego.heading)
    centre = np.array([dx * ce + dy * se, dy * ce - dx * se])
    corners = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) * (length / 2, width / 2)
    polygon = centre + corners @ np.array([[c, s], [-s, c]])
    for axis, bound in ((0, ego.length / 2), (1, ego.width / 2)):
        for sign in (1.0, -1.0):
            polygon = _clip(polygon, axis, sign, bound)
            if len(polygon) == 0:
                return float(centre[0])
    return float((polygon[:, 0].min() + polygon[:, 0].max()) / 2)


def _clip(polygon: Floats, axis: int, sign: float, bound: float) -> Floats:
    """The part of a polygon (P, 2) where sign * coordinate <= bound."""
    inside = bound - sign * polygon[:, axis]
    kept = []
    for i in range(len(polygon)):
        j = (i + 1) % len(polygon)
        if inside[i] >= 0:
            kept.append(polygon[i])
        if (inside[i] >= 0) != (inside[j] >= 0):
            share = inside[i] / (inside[i] - inside[j])
            kept.append(polygon[i] + share * (polygon[j] - polygon[i]))
    return np.array(kept).reshape(-1, 2)


class CollisionTest:
    """Tests the ego of one town against everything solid."""

    def __init__(self, town: Town) -> None:
        boxes = [(*b.centre, b.heading, *b.size) for b in town.buildings]
        discs = [(*p.position, p.radius) for p in town.props]
        self._boxes = np.array(boxes, np.float64).reshape(-1, 5)
        self._discs = np.array(discs, np.float64).reshape(-1, 3)

    def __call__(self, ego: Ego, actors: Actors) -> Hit | None:
        """What the ego overlaps now, or None. Actors come before static things.

        The ego is at fault when it is moving and the middle of the shared area lies in the front quarter of
        its length; with static things, whenever it is moving.
        """
        box = (ego.x, ego.y, ego.heading, ego.length, ego.width)
        moving = ego.speed > MOVING
        i = _hit_actor(box, ego.z, actors.x, actors.y, actors.z, actors.heading, actors.length, actors.width)
        if i >= 0:
            kind = "pedestrian" if actors.kind[i] == Kind.PEDESTRIAN else "vehicle"
            other = actors.x[i], actors.y[i], actors.heading[i], actors.length[i], actors.width[i]
            contact = _side_of(ego, contact_ahead(ego, *other))
            return Hit(kind, bool(moving and contact == "front"), contact)
        n = _hit_static(box, self._boxes, self._discs)
        if n < 0:
            return None
        if n < len(self._boxes):
            x, y, heading, length, width = self._boxes[n]
        else:
            x, y, radius = self._discs[n - len(self._boxes)]
            heading, length, width = ego.heading, 2 * radius, 2 * radius
        return Hit("static", moving, _side_of(ego, contact_ahead(ego, x, y, heading, length, width)))


def _side_of(ego: Ego, ahead: float) -> str:
    """The part of the ego that lies so many metres ahead of its centre."""
    return "front" if ahead > ego.length / 4 else "rear" if ahead < -ego.length / 4 else "side"

"""Routes: a centre line to follow, the waypoints along it, and how far the ego has come."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from me3bev_plugins.simulator.highway.compiled import kernel
from me3bev_plugins.simulator.highway.ego_path import EgoPath
from me3bev_plugins.simulator.highway.town import Floats, Ints, Town

WINDOW = 15.0
"""How far ahead of the last progress the ego is looked for, metres."""


@dataclass(frozen=True, eq=False)
class Route:
    """A centre line over consecutive lanes. Arc length 0 is the start; `length` of it is to be driven.

    What lies beyond `length` is run-out, so that there are always waypoints ahead.
    """

    lanes: Ints
    """(K,) ids in order."""
    begins: Floats
    """(K,) arc length along the route at which each lane begins; the first is at most 0."""
    points: Floats
    """(P, 3) world, metres; no two consecutive ones alike."""
    s: Floats
    """(P,) metres."""
    heading: Floats
    """(P,) radians, unwrapped."""
    length: float
    stops: Floats
    """(Q,) arc lengths of the stop lines that a traffic light governs, rising."""
    signals: Ints
    """(Q,) the signal of each."""

    def positions(self, s: Floats) -> Floats:
        """World positions (N, 3) at arc lengths (N,); straight on beyond either end."""
        i = np.clip(np.searchsorted(self.s, s, side="right") - 1, 0, len(self.s) - 2)
        share = (s - self.s[i]) / (self.s[i + 1] - self.s[i])
        points: Floats = self.points[i] + share[:, None] * (self.points[i + 1] - self.points[i])
        return points

    def heading_at(self, s: float) -> float:
        """Direction of the centre line, radians."""
        return float(np.interp(s, self.s, self.heading))

    @cached_property
    def _begins(self) -> list[float]:
        return self.begins.tolist()

    @cached_property
    def _stops(self) -> list[float]:
        return self.stops.tolist()

    def lane_at(self, s: float) -> tuple[int, float]:
        """(position within `lanes`, arc length on that lane) at an arc length of the route."""
        k = max(0, bisect_right(self._begins, s) - 1)
        return k, s - self._begins[k]

    def next_stop(self, s: float, reach: float) -> int:
        """The signal of the first stop line at an arc length of `s` or up to `reach` metres on, or -1."""
        i = bisect_left(self._stops, s)
        return int(self.signals[i]) if i < len(self._stops) and self._stops[i] - s <= reach else -1


@lru_cache(maxsize=16)
def signal_of_lane(town: Town) -> Ints:
    """(L,) id of the traffic light at the end of each lane, or -1."""
    table = np.full(len(town.lanes), -1, np.int32)
    for signal in town.signals:
        table[list(signal.lanes)] = signal.id
    return table


def make_route(town: Town, lanes: list[int], start: float, length: float) -> Route:
    """Join the centre lines of consecutive lanes.

    Args:
        lanes: ids, each a successor of the one before.
        start: arc length on the first lane at which the route begins, metres.
        length: metres to be driven.
    """
    chain = np.concatenate([[0.0], np.cumsum([town.lanes[i].length for i in lanes])]) - start
    first = town.lanes[lanes[0]]
    origin = np.array([np.interp(start, first.s, first.points[:, axis]) for axis in range(3)])
    parts = [origin[None], first.points[first.s > start + 1e-6], *(town.lanes[i].points for i in lanes[1:])]
    points = np.concatenate(parts)
    steps = np.hypot(*np.diff(points[:, :2], axis=0).T)
    points = points[np.concatenate([[True], steps > 1e-6])]
    s = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points[:, :2], axis=0).T))])
    tangent = np.gradient(points[:, :2], s, axis=0)
    governed = signal_of_lane(town)[lanes]
    lit = governed >= 0
    return Route(
        lanes=np.array(lanes, np.int32),
        begins=chain[:-1],
        points=points,
        s=s,
        heading=np.unwrap(np.arctan2(tangent[:, 1], tangent[:, 0])),
        length=length,
        stops=chain[1:][lit],
        signals=governed[lit],
    )


@kernel
def _project(
    points: NDArray[Any], s: NDArray[Any], x: float, y: float, low: float, high: float
) -> tuple[float, float, float]:
    """The nearest point with arc length in [low, high]: arc length, metres to its left, distance."""
    first = max(0, int(np.searchsorted(s, low, side="right")) - 1)
    best, best_s, lateral = np.inf, low, 0.0
    for i in range(first, len(s) - 1):
        if s[i] > high:
            break
        size = s[i + 1] - s[i]
        dx, dy = (points[i + 1, 0] - points[i, 0]) / size, (points[i + 1, 1] - points[i, 1]) / size
        px, py = x - points[i, 0], y - points[i, 1]
        along = min(max(px * dx + py * dy, 0.0, low - s[i]), size, high - s[i])
        ex, ey = px - along * dx, py - along * dy
        distance = np.sqrt(ex * ex + ey * ey)
        if distance < best:
            best, best_s, lateral = distance, s[i] + along, dx * ey - dy * ex
    return best_s, lateral, best


@kernel
def _follow(points: NDArray[Any], s: NDArray[Any], x: float, y: float, progress: float) -> tuple[float, float, float]:
    """A new progress for a position, metres to its left, and the distance to the nearest point of the whole route."""
    end = s[-1]
    ahead, lateral, _ = _project(points, s, x, y, progress, min(end, progress + WINDOW))
    return ahead, lateral, _project(points, s, x, y, 0.0, end)[2]


class RouteTracker:
    """Where the ego is on its route. Progress never falls: going back, or round in circles, gains nothing."""

    def __init__(self, route: Route, spacing: float) -> None:
        self.route = route
        self.spacing = spacing
        self.progress = 0.0
        """Metres along the route."""
        self.lateral = 0.0
        """Metres left of the centre line at `progress`."""
        self.off_route = 0.0
        """Metres to the nearest point of the whole route."""
        self._waypoints = route.positions(np.arange(1, int(route.s[-1] / spacing) + 7) * spacing)

    def update(self, x: float, y: float) -> None:
        """Follow the ego to a world position, metres; looks forward only, near where it last was."""
        route = self.route
        self.progress, self.lateral, self.off_route = _follow(route.points, route.s, x, y, self.progress)

    @property
    def path(self) -> EgoPath:
        """As the traffic is told."""
        index, s = self.route.lane_at(self.progress)
        return EgoPath(self.route.lanes, index, s, self.lateral)

    def waypoints(self, count: int = 5) -> Floats:
        """The next `count` waypoints (count, 3), world, metres: the first is the first one beyond the progress."""
        first = int(self.progress / self.spacing)
        ahead: Floats = self._waypoints[first : first + count]
        return ahead

    @property
    def done(self) -> bool:
        """True at the end of the route."""
        return self.progress >= self.route.length

    def light_ahead(self, reach: float = 20.0) -> int:
        """The signal that governs the next stop line within `reach` metres, or -1."""
        return self.route.next_stop(self.progress, reach)

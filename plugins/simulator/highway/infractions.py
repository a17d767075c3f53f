"""Rules broken without a collision: lights and stop signs run, leaving the road."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from me3bev_plugins.simulator.highway.lane_grid import Place
from me3bev_plugins.simulator.highway.scene import Ego, Light
from me3bev_plugins.simulator.highway.town import Floats, Town

VERGE = 0.5
"""Metres beyond a lane's edge that still count as the road."""
BEFORE_LINE = 8.0
"""A stop counts within this many metres before a lane's end: the painted line may lie before a crossing there."""
STANDING = 0.5
"""Slower than this is a stop, m/s."""
LEVEL = 2.5
"""Lines farther away in height are not crossed, metres."""


class Infractions(NamedTuple):
    """What was broken in one step."""

    red_light: bool
    stop_sign: bool


class StopLines:
    """Watches the ego's front cross the ends of lanes that a light or a stop sign governs, on any lane."""

    def __init__(self, town: Town) -> None:
        signal_lanes = [(lane, signal.id) for signal in town.signals for lane in signal.lanes]
        sign_lanes = [(sign.lane, -1) for sign in town.signs if sign.kind == "stop"]
        rows = signal_lanes + sign_lanes
        lanes = [town.lanes[lane] for lane, _ in rows]
        self._signal = np.array([signal for _, signal in rows], np.int64)
        self._ends: Floats = np.array([lane.points[-1] for lane in lanes], np.float64).reshape(-1, 3)
        heading = np.array([lane.heading[-1] for lane in lanes], np.float64)
        self._cos, self._sin = np.cos(heading), np.sin(heading)
        self._half_width = np.array([lane.width for lane in lanes], np.float64) / 2
        self._stopped = np.zeros(len(rows), bool)
        self._before = np.zeros(len(rows))

    def reset(self, ego: Ego) -> None:
        """Start watching at the ego's pose."""
        self._stopped[:] = False
        self._before, _ = self._local(ego)

    def _local(self, ego: Ego) -> tuple[Floats, NDArray[np.bool_]]:
        """Metres of the ego's front beyond each line (negative: before it), and whether it is in that lane."""
        x = ego.x + ego.length / 2 * np.cos(ego.heading) - self._ends[:, 0]
        y = ego.y + ego.length / 2 * np.sin(ego.heading) - self._ends[:, 1]
        beside = np.abs(y * self._cos - x * self._sin) <= self._half_width
        return x * self._cos + y * self._sin, beside & (np.abs(self._ends[:, 2] - ego.z) <= LEVEL)

    def update(self, ego: Ego, lights: NDArray[np.int32]) -> Infractions:
        """Judge one step that ended at the ego's pose with the given lights (S,)."""
        beyond, in_lane = self._local(ego)
        # A step covers a few metres at most: a larger one comes from a line whose sides are far apart.
        crossed = in_lane & (self._before < 0) & (beyond >= 0) & (beyond - self._before < 10)
        near = in_lane & (beyond < 0) & (beyond >= -BEFORE_LINE)
        self._stopped |= near & (ego.speed < STANDING)
        lit = self._signal >= 0
        red = crossed & lit
        red[lit] &= lights[self._signal[lit]] == Light.RED
        ran_stop = crossed & ~lit & ~self._stopped
        self._stopped &= ~crossed & (beyond < BEFORE_LINE)
        self._before = beyond
        return Infractions(bool(red.any()), bool(ran_stop.any()))


def inside_polygon(polygon: Floats, x: float, y: float) -> bool:
    """Whether a point lies in a polygon (P, 2), by the parity of the edges to its right."""
    ax, ay = polygon[:, 0], polygon[:, 1]
    bx, by = np.roll(ax, -1), np.roll(ay, -1)
    spans = (ay > y) != (by > y)
    rise = np.where(spans, by - ay, 1.0)
    return bool(np.count_nonzero(spans & (x < ax + (y - ay) / rise * (bx - ax))) % 2)


class RoadEdge:
    """Tells whether the ego's centre has left the road."""

    def __init__(self, town: Town) -> None:
        self._surfaces = town.surfaces
        corners = [(*polygon[:, :2].min(0), *polygon[:, :2].max(0)) for polygon in town.surfaces]
        self._boxes = np.array(corners, np.float64).reshape(-1, 4)

    def off_road(self, place: Place, x: float, y: float) -> bool:
        """True beyond `VERGE` metres from every lane's edge and outside the town's other asphalt."""
        if place.outside <= VERGE:
            return False
        low_x, low_y, high_x, high_y = self._boxes.T
        for i in np.flatnonzero((low_x <= x) & (x <= high_x) & (low_y <= y) & (y <= high_y)):
            if inside_polygon(self._surfaces[i][:, :2], x, y):
                return False
        return True

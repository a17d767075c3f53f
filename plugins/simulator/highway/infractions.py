"""Rules broken without a collision: lights and stop signs run, leaving the road."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from me3bev_plugins.simulator.highway.compiled import kernel
from me3bev_plugins.simulator.highway.features import NEAR_LIGHT
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
AHEAD = math.cos(math.radians(60))
"""Cosine of the greatest angle at which the ego heads for a line."""
RED = int(Light.RED)


class Infractions(NamedTuple):
    """What was broken in one step, and whether there was a red light to break."""

    red_light: bool
    stop_sign: bool
    red_met: bool = False


@kernel
def _pass_lines(
    pose: tuple[float, float, float, float, float, float],
    lines: NDArray[Any],
    signal: NDArray[Any],
    lights: NDArray[Any],
    before: NDArray[Any],
    stopped: NDArray[Any],
    met: NDArray[Any],
) -> tuple[bool, bool, bool]:
    """Move the ego's front (x, y, z, the cosine and sine of its heading, its speed) on.

    Returns whether it ran a red light, whether a stop sign, whether it met a light that is red and had not met it yet.

    `lines` (Q, 6) holds each line's x, y, z, the cosine and sine of its lane's heading and half the lane's width.
    `before` (Q,), metres beyond each line (negative: before it), `stopped` (Q,), and `met` (S,) of each light are
    brought up to date.
    """
    x, y, z, ahead_x, ahead_y, speed = pose
    ran_red = ran_stop = met_red = False
    for i in range(len(lines)):
        dx, dy, cos, sin = x - lines[i, 0], y - lines[i, 1], lines[i, 3], lines[i, 4]
        beyond = dx * cos + dy * sin
        crossed = False
        if abs(dy * cos - dx * sin) <= lines[i, 5] and abs(lines[i, 2] - z) <= LEVEL:
            # A step covers a few metres at most: a larger one comes from a line whose sides are far apart.
            crossed = before[i] < 0.0 <= beyond and beyond - before[i] < 10.0
            if -BEFORE_LINE <= beyond < 0.0 and speed < STANDING:
                stopped[i] = True
            ahead = -NEAR_LIGHT <= beyond < 0.0 and ahead_x * cos + ahead_y * sin > AHEAD
            if signal[i] >= 0 and (crossed or ahead) and lights[signal[i]] == RED and not met[signal[i]]:
                met[signal[i]] = True
                met_red = True
        if crossed and signal[i] >= 0:
            ran_red |= lights[signal[i]] == RED
            met[signal[i]] = False
        elif crossed:
            ran_stop |= not stopped[i]
        if crossed or beyond >= BEFORE_LINE:
            stopped[i] = False
        before[i] = beyond
    return ran_red, ran_stop, met_red


class StopLines:
    """Watches the ego's front cross the ends of lanes that a light or a stop sign governs, on any lane."""

    def __init__(self, town: Town) -> None:
        signal_lanes = [(lane, signal.id) for signal in town.signals for lane in signal.lanes]
        sign_lanes = [(sign.lane, -1) for sign in town.signs if sign.kind == "stop"]
        rows = signal_lanes + sign_lanes
        lanes = [town.lanes[lane] for lane, _ in rows]
        heading = np.array([lane.heading[-1] for lane in lanes], np.float64)
        ends = np.array([lane.points[-1] for lane in lanes], np.float64).reshape(-1, 3)
        half_width = np.array([lane.width for lane in lanes], np.float64) / 2
        self._lines: Floats = np.column_stack([ends, np.cos(heading), np.sin(heading), half_width])
        self._signal = np.array([signal for _, signal in rows], np.int64)
        self._stopped = np.zeros(len(rows), bool)
        self._before = np.zeros(len(rows))
        self._met = np.zeros(self._signal.max(initial=-1) + 1, bool)

    def reset(self, ego: Ego) -> None:
        """Start watching at the ego's pose."""
        self._before[:] = np.inf  # Nothing is crossed on the way here.
        self._move(ego, np.zeros(len(self._met), np.int32))
        self._stopped[:] = False
        self._met[:] = False

    def update(self, ego: Ego, lights: NDArray[np.int32]) -> Infractions:
        """Judge one step that ended at the ego's pose with the given lights (S,)."""
        return self._move(ego, lights)

    def _move(self, ego: Ego, lights: NDArray[np.int32]) -> Infractions:
        half, cos, sin = ego.length / 2, math.cos(ego.heading), math.sin(ego.heading)
        front = (ego.x + half * cos, ego.y + half * sin, ego.z, cos, sin, ego.speed)
        state = self._before, self._stopped, self._met
        return Infractions(*_pass_lines(front, self._lines, self._signal, lights, *state))


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

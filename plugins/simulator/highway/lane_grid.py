"""Where on the town's lanes a point is: one fast look-up that answers every question about the ground under it."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from me3bev_plugins.simulator.highway.town import Floats, Ints, LaneArrays, Town

CELL = 10.0
"""Side of a grid cell, metres; anything nearer than this to a point is found."""
LEVEL = 2.5
"""Lanes farther than this in height are another level, metres."""


class Place(NamedTuple):
    """The lanes around a point. With no lane within reach, `lane` is -1 and the distances are infinite."""

    lane: int
    """The lane that fits best by position and heading."""
    s: float
    """Arc length on it, metres."""
    lateral: float
    """Metres left of its centre."""
    z: float
    """Height of the nearest lane's centre, metres."""
    outside: float
    """Metres beyond the edge of the nearest lane; negative on a lane."""
    junction_distance: float
    """Metres to the nearest centre line that crosses a junction."""


@njit(cache=True)
def _scan(
    begin: int,
    end: int,
    order: NDArray[Any],
    lane_of: NDArray[Any],
    xyz: NDArray[Any],
    s: NDArray[Any],
    heading: NDArray[Any],
    width: NDArray[Any],
    junction: NDArray[Any],
    pose: tuple[float, float, float, float],
    best: tuple[int, float, float, float, float, float, float, float],
) -> tuple[int, float, float, float, float, float, float, float]:
    """Fold the segments `order[begin:end]` into `best`: lane, s, lateral, z, outside, junction, score, distance."""
    x, y, z, direction = pose
    lane, lane_s, lateral, ground, outside, near_junction, score, nearest = best
    for k in range(begin, end):
        i = order[k]
        dx, dy = xyz[i + 1, 0] - xyz[i, 0], xyz[i + 1, 1] - xyz[i, 1]
        length2 = dx * dx + dy * dy
        px, py = x - xyz[i, 0], y - xyz[i, 1]
        t = (px * dx + py * dy) / length2 if length2 > 0.0 else 0.0
        t = min(1.0, max(0.0, t))
        height = xyz[i, 2] + t * (xyz[i + 1, 2] - xyz[i, 2])
        if abs(height - z) > LEVEL:
            continue
        ex, ey = px - t * dx, py - t * dy
        distance = np.sqrt(ex * ex + ey * ey)
        turn = abs((heading[i] - direction + np.pi) % (2.0 * np.pi) - np.pi)
        owner = lane_of[i]
        if distance + turn < score:
            score, lane = distance + turn, owner
            lane_s = s[i] + t * np.sqrt(length2)
            lateral = distance if dx * ey - dy * ex >= 0.0 else -distance
        if distance < nearest:
            nearest, ground = distance, height
        outside = min(outside, distance - 0.5 * width[owner])
        if junction[owner] >= 0:
            near_junction = min(near_junction, distance)
    return lane, lane_s, lateral, ground, outside, near_junction, score, nearest


@njit(cache=True)
def _locate(
    x: float,
    y: float,
    z: float,
    direction: float,
    x0: float,
    y0: float,
    columns: int,
    rows: int,
    start: NDArray[Any],
    order: NDArray[Any],
    lane_of: NDArray[Any],
    xyz: NDArray[Any],
    s: NDArray[Any],
    heading: NDArray[Any],
    width: NDArray[Any],
    junction: NDArray[Any],
) -> tuple[int, float, float, float, float, float, float, float]:
    best = (-1, 0.0, 0.0, z, np.inf, np.inf, np.inf, np.inf)
    pose = (x, y, z, direction)
    column, row = int(np.floor((x - x0) / CELL)), int(np.floor((y - y0) / CELL))
    for r in range(max(0, row - 1), min(rows, row + 2)):
        low, high = max(0, column - 1), min(columns, column + 2)
        if low < high:
            begin, end = start[r * columns + low], start[r * columns + high]
            best = _scan(begin, end, order, lane_of, xyz, s, heading, width, junction, pose, best)
    return best


class LaneGrid:
    """The segments of all lanes, bucketed by square cells of `CELL` metres."""

    def __init__(self, town: Town) -> None:
        arrays = town.arrays
        self.lane_of: Ints = np.repeat(np.arange(len(town.lanes), dtype=np.int32), np.diff(arrays.start))
        # A lane's last point begins no segment; a segment goes into the cell of its midpoint.
        begins = np.setdiff1d(np.arange(len(arrays.xyz)), arrays.start[1:] - 1)
        middle = (arrays.xyz[begins, :2] + arrays.xyz[begins + 1, :2]) / 2
        self.origin: Floats = arrays.xyz[:, :2].min(0) - CELL
        cells = np.floor((middle - self.origin) / CELL).astype(np.int64)
        self.columns, self.rows = (int(n) for n in cells.max(0) + 2)
        flat = cells[:, 1] * self.columns + cells[:, 0]
        by_cell = np.argsort(flat, kind="stable")
        self.order: Ints = begins[by_cell].astype(np.int32)
        bounds = np.arange(self.columns * self.rows + 1)
        self.start: Ints = np.searchsorted(flat[by_cell], bounds).astype(np.int32)
        self._arrays: LaneArrays = arrays

    def locate(self, x: float, y: float, z: float, heading: float) -> Place:
        """The lanes around a point on the level of `z`.

        Args:
            x, y, z: world, metres.
            heading: radians; one radian away from a lane's direction weighs as much as one metre away from its
                centre, as in highway-env.
        """
        a = self._arrays
        found = _locate(
            x, y, z, heading, self.origin[0], self.origin[1], self.columns, self.rows, self.start, self.order,
            self.lane_of, a.xyz, a.s, a.heading, a.width, a.junction,
        )  # fmt: skip
        return Place(*found[:6])

    def nearest(self, x: float, y: float, heading: float | None) -> int:
        """The lane that fits best on any level and at any distance (slow: reads every lane)."""
        a = self._arrays
        i = self.order
        away = np.hypot(a.xyz[i, 0] - x, a.xyz[i, 1] - y)
        if heading is not None:
            away = away + np.abs((a.heading[i] - heading + np.pi) % (2 * np.pi) - np.pi)
        return int(self.lane_of[i[np.argmin(away)]])

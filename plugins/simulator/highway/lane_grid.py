"""Where on the town's lanes a point is: one fast look-up that answers every question about the ground under it."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from me3bev_plugins.simulator.highway.compiled import kernel
from me3bev_plugins.simulator.highway.town import Ints, Town

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


SEGMENT = np.dtype(
    [
        ("x", np.float64), ("y", np.float64), ("z", np.float64),
        ("dx", np.float64), ("dy", np.float64), ("rise", np.float64),
        ("s", np.float64), ("heading", np.float64), ("half_width", np.float64),
        ("lane", np.int32), ("crosses", np.int32),
    ]
)  # fmt: skip
"""A piece of a centre line: where it begins, the way to its end, arc length and direction at its beginning, its lane
and whether that crosses a junction."""


@kernel
def _scan(
    segments: NDArray[Any],
    begin: int,
    end: int,
    pose: tuple[float, float, float, float],
    best: tuple[int, float, float, float, float, float, float, float],
) -> tuple[int, float, float, float, float, float, float, float]:
    """Fold segments [begin, end) into `best`: lane, s, lateral, z, outside, junction, score, distance."""
    x, y, z, direction = pose
    lane, lane_s, lateral, ground, outside, near_junction, score, nearest = best
    for k in range(begin, end):
        segment = segments[k]
        dx, dy = segment.dx, segment.dy
        length2 = dx * dx + dy * dy
        px, py = x - segment.x, y - segment.y
        t = (px * dx + py * dy) / length2 if length2 > 0.0 else 0.0
        t = min(1.0, max(0.0, t))
        height = segment.z + t * segment.rise
        if abs(height - z) > LEVEL:
            continue
        ex, ey = px - t * dx, py - t * dy
        distance = np.sqrt(ex * ex + ey * ey)
        if distance < score:  # Else no turn can make it better: they are dear to work out.
            turn = abs((segment.heading - direction + np.pi) % (2.0 * np.pi) - np.pi)
            if distance + turn < score:
                score, lane = distance + turn, segment.lane
                lane_s = segment.s + t * np.sqrt(length2)
                lateral = distance if dx * ey - dy * ex >= 0.0 else -distance
        if distance < nearest:
            nearest, ground = distance, height
        outside = min(outside, distance - segment.half_width)
        if segment.crosses:
            near_junction = min(near_junction, distance)
    return lane, lane_s, lateral, ground, outside, near_junction, score, nearest


@kernel
def _locate(
    segments: NDArray[Any],
    start: NDArray[Any],
    cells: tuple[float, float, int, int],
    pose: tuple[float, float, float, float],
) -> tuple[int, float, float, float, float, float]:
    """The `Place` of a pose (x, y, z, heading). `cells` is the grid's lowest corner, its columns and its rows."""
    x0, y0, columns, rows = cells
    best = (-1, 0.0, 0.0, pose[2], np.inf, np.inf, np.inf, np.inf)
    column, row = int(np.floor((pose[0] - x0) / CELL)), int(np.floor((pose[1] - y0) / CELL))
    for r in range(max(0, row - 1), min(rows, row + 2)):
        low, high = max(0, column - 1), min(columns, column + 2)
        if low < high:
            best = _scan(segments, start[r * columns + low], start[r * columns + high], pose, best)
    return best[0], best[1], best[2], best[3], best[4], best[5]


class LaneGrid:
    """The segments of all lanes, bucketed by square cells of `CELL` metres."""

    def __init__(self, town: Town) -> None:
        arrays = town.arrays
        lane_of = np.repeat(np.arange(len(town.lanes), dtype=np.int32), np.diff(arrays.start))
        # A lane's last point begins no segment; a segment goes into the cell of its midpoint.
        begins = np.setdiff1d(np.arange(len(arrays.xyz)), arrays.start[1:] - 1)
        middle = (arrays.xyz[begins, :2] + arrays.xyz[begins + 1, :2]) / 2
        origin = arrays.xyz[:, :2].min(0) - CELL
        cells = np.floor((middle - origin) / CELL).astype(np.int64)
        columns, rows = (int(n) for n in cells.max(0) + 2)
        flat = cells[:, 1] * columns + cells[:, 0]
        by_cell = np.argsort(flat, kind="stable")
        self._start: Ints = np.searchsorted(flat[by_cell], np.arange(columns * rows + 1)).astype(np.int32)
        self._cells = (float(origin[0]), float(origin[1]), columns, rows)
        i = begins[by_cell]
        lane = lane_of[i]
        self._segments = np.zeros(len(i), SEGMENT)
        for names, values in (
            (("x", "y", "z"), arrays.xyz[i]),
            (("dx", "dy", "rise"), arrays.xyz[i + 1] - arrays.xyz[i]),
        ):
            for axis, name in enumerate(names):
                self._segments[name] = values[:, axis]
        self._segments["s"], self._segments["heading"] = arrays.s[i], arrays.heading[i]
        self._segments["half_width"] = 0.5 * arrays.width[lane]
        self._segments["lane"], self._segments["crosses"] = lane, arrays.junction[lane] >= 0

    def locate(self, x: float, y: float, z: float, heading: float) -> Place:
        """The lanes around a point on the level of `z`.

        Args:
            x, y, z: world, metres.
            heading: radians; one radian away from a lane's direction weighs as much as one metre away from its
                centre, as in highway-env.
        """
        return Place(*_locate(self._segments, self._start, self._cells, (x, y, z, heading)))

    def nearest(self, x: float, y: float, heading: float | None) -> int:
        """The lane that fits best on any level and at any distance (slow: reads every lane)."""
        segments = self._segments
        away = np.hypot(segments["x"] - x, segments["y"] - y)
        if heading is not None:
            away = away + np.abs((segments["heading"] - heading + np.pi) % (2 * np.pi) - np.pi)
        return int(segments["lane"][np.argmin(away)])

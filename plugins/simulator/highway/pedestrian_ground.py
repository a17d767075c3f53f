"""What lies around a point on which somebody walks."""

from __future__ import annotations

import numpy as np
from numba import njit

from me3bev_plugins.simulator.highway.traffic_grid import Grid, cell_range
from me3bev_plugins.simulator.highway.traffic_records import Records

KERB = 0.3
"""Least distance from a lane's edge, metres."""
FAR = 30.0
"""Lanes farther away than this do not matter to a walker, metres."""


@njit(cache=True)
def survey(points: Records, samples: Records, lanes: Records, grid: Grid) -> None:
    """Fill in the height of the nearest lane and the free distance to the nearest kerb of every point."""
    for n in range(len(points)):
        p = points[n]
        nearest, p.free = np.inf, FAR
        for reach in (FAR / 3.0, 10.0 * FAR):
            r0, r1, c0, c1 = cell_range(grid, p.x, p.y, reach)
            for r in range(r0, r1):
                for k in range(grid.start[r * grid.shape[1] + c0], grid.start[r * grid.shape[1] + c1]):
                    q = samples[grid.order[k]]
                    away = np.sqrt((q.x - p.x) ** 2 + (q.y - p.y) ** 2)
                    p.free = min(p.free, away - 0.5 * lanes[q.lane].width - KERB)
                    if away < nearest:
                        nearest, p.z = away, q.z
            if nearest < np.inf:
                break

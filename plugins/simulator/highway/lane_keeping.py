"""Lane departures: the ego's centre leaves the lanes that go its way, for the opposite ones or for no road at all."""

from __future__ import annotations

import numpy as np

from me3bev_plugins.simulator.highway.compiled import kernel
from me3bev_plugins.simulator.highway.scene import Ego
from me3bev_plugins.simulator.highway.town import Town
from me3bev_plugins.simulator.highway.traffic_grid import Grid, cell_range
from me3bev_plugins.simulator.highway.traffic_tables import Roads, tables

REACH = 5.0
"""No lane is wider than twice this, metres."""
LEVEL = 2.5
"""Lanes farther away in height are another road, metres."""

KEPT, AGAINST, NEITHER = 0, 1, 2


@kernel
def surface_under(roads: Roads, grid: Grid, x: float, y: float, z: float, heading: float) -> int:
    """KEPT on a lane that leads within 90 degrees of `heading` or crosses a junction, AGAINST on others only,
    NEITHER on none.
    """
    c, s = np.cos(heading), np.sin(heading)
    found = NEITHER
    r0, r1, c0, c1 = cell_range(grid, x, y, REACH)
    for r in range(r0, r1):
        for k in range(grid.start[r * grid.shape[1] + c0], grid.start[r * grid.shape[1] + c1]):
            p = roads.samples[grid.order[k]]
            lane = roads.lanes[p.lane]
            if abs(p.z - z) > LEVEL:
                continue
            hc, hs = np.cos(p.heading), np.sin(p.heading)
            dx, dy = x - p.x, y - p.y
            # Half a step before and behind each sample, and a little more, covers the lane's whole length.
            if abs(dx * hc + dy * hs) > 0.6 * lane.step or abs(dy * hc - dx * hs) > 0.5 * lane.width:
                continue
            if lane.junction >= 0 or c * hc + s * hs > 0.0:
                return KEPT
            found = AGAINST
    return found


class LaneKeeping:
    """Watches whether the ego keeps to lanes that go its way.

    It departs in the step in which its centre comes to lie on lanes of the opposite direction only (those that lead
    more than 90 degrees away from its heading), or off the road (see `RoadEdge`), and can depart again only after it
    has been back on a lane that goes its way. Changing to a neighbour of the same direction is no departure, and
    neither is anything inside a junction; gutters and shoulders, which are neither lane nor off the road, settle
    nothing.
    """

    def __init__(self, town: Town) -> None:
        known = tables(town)
        self._roads, self._grid = known.roads, known.grid
        self._away = False

    def reset(self) -> None:
        """Begin an episode: the ego is in its lane."""
        self._away = False

    def update(self, ego: Ego, off_road: bool) -> bool:
        """Whether the ego departed in the step that ended at its pose."""
        under = surface_under(self._roads, self._grid, ego.x, ego.y, ego.z, ego.heading)
        departed = (under == AGAINST or off_road) and not self._away
        if under == KEPT:
            self._away = False
        elif departed:
            self._away = True
        return bool(departed)

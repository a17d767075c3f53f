"""Where lanes meet: the stretches of two lanes on which vehicles following them would touch."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from me3bev_plugins.simulator.highway.compiled import kernel
from me3bev_plugins.simulator.highway.town import Ints, Town
from me3bev_plugins.simulator.highway.traffic_grid import Grid, build_grid, cell_range
from me3bev_plugins.simulator.highway.traffic_records import (
    APART,
    CROSS,
    HALF,
    LEAD,
    MERGE,
    SPLIT,
    ZONE,
    Record,
    Records,
)

HALF_WIDTHS = (1.25, 1.4)
"""Half widths of the small and the large vehicle with their margins, metres."""
ALONGSIDE = 0.6
"""Paths that meet at less than this angle run together, radians."""
LEVEL = 2.5
"""Difference of height beyond which nothing meets, metres."""

_POSE = np.dtype([("x", "f8"), ("y", "f8"), ("z", "f8"), ("heading", "f8"), ("s", "f8"), ("lane", "i4")], align=True)


def find_zones(town: Town, lanes: Records, samples: Records) -> tuple[NDArray, Ints]:
    """All zones, by the size of the vehicle on the lane and that of the other one. Lanes in a row have none.

    Returns:
        zones (Z,) and (4, L + 1): those of lane i for sizes own and other are
        `start[2 * own + other, i] : start[2 * own + other, i + 1]`.
    """
    near_start, near = _kin(town)
    found: list[NDArray] = []
    start = np.zeros((4, len(lanes) + 1), np.int32)
    total = 0
    common: set[tuple[int, int]] = set()
    poses = [_poses(lanes, samples, half) for half in HALF]
    grids = [build_grid(p) for p in poses]
    for own in (0, 1):
        for other in (0, 1):
            boxes = (HALF[own] + 0.25, HALF_WIDTHS[own], HALF[other] + 0.25, HALF_WIDTHS[other])
            rows = _meet(poses[own], poses[other], grids[other], near_start, near, boxes, len(lanes))
            rows[:, 2:6] += np.array([-0.5, 0.5, -0.5, 0.5])  # The poses are about a metre apart.
            zones = _records(town, rows)
            if own or other:
                kept = _kept(lanes, rows, zones, common)
                rows, zones = rows[kept], zones[kept]
            else:
                common = {(int(a), int(b)) for a, b in rows[:, :2]}
            start[2 * own + other] = total + np.searchsorted(rows[:, 0], np.arange(len(lanes) + 1))
            found.append(zones)
            total += len(rows)
    return np.concatenate(found), start


def _kept(lanes: Records, rows: NDArray, zones: Records, common: set[tuple[int, int]]) -> NDArray[np.bool_]:
    """Which zones of large vehicles count. Beside one another on the road only those that small vehicles have too:
    the boxes are wider than life there, and who does not fit into its lane's bends is not admitted to it.
    """
    on_road = (lanes["junction"][rows[:, 0].astype(int)] < 0) & (lanes["junction"][zones["other"]] < 0)
    shared = np.array([(int(a), int(b)) in common for a, b in rows[:, :2]], np.bool_)
    kept: NDArray[np.bool_] = ~on_road | shared | (zones["kind"] == LEAD)
    return kept


def _kin(town: Town) -> tuple[Ints, Ints]:
    """For every lane those that follow it, or that it follows, so soon that one vehicle may be on both."""
    kin: list[set[int]] = [set() for _ in town.lanes]
    for lane in town.lanes:
        frontier = [(n, 0.0) for n in lane.successors]
        while frontier:
            current, between = frontier.pop()
            kin[lane.id].add(current)
            kin[current].add(lane.id)
            between += town.lanes[current].length
            if between < 12.0:
                frontier += [(n, between) for n in town.lanes[current].successors]
    start = np.concatenate([[0], np.cumsum([len(k) for k in kin])]).astype(np.int32)
    return start, np.array([i for k in kin for i in sorted(k)], np.int32)


def _poses(lanes: Records, samples: Records, half: float) -> NDArray:
    """Poses about a metre apart along every lane; those of connectors go on straight beyond both ends."""
    pieces = []
    for i, lane in enumerate(lanes):
        chosen = np.unique(np.append(np.arange(0, lane["count"], 2), lane["count"] - 1))
        source = samples[lane["first"] + chosen]
        piece = np.zeros(len(chosen), _POSE)
        for name in ("x", "y", "z", "heading"):
            piece[name] = source[name]
        piece["s"], piece["lane"] = chosen * lane["step"], i
        pieces.append(piece)
        if lane["junction"] >= 0:
            beyond = np.arange(1.0, half + 0.5)
            pieces += [_straight_on(piece[0], -beyond), _straight_on(piece[-1], beyond)]
    return np.concatenate(pieces)


def _straight_on(pose: np.void, metres: NDArray) -> NDArray:
    piece = np.repeat(np.array([pose]), len(metres))
    piece["x"] += metres * np.cos(pose["heading"])
    piece["y"] += metres * np.sin(pose["heading"])
    piece["s"] += metres
    return piece


@kernel
def boxes_touch(
    dx: float, dy: float, ca: float, sa: float, cb: float, sb: float, la: float, wa: float, lb: float, wb: float
) -> bool:
    """Whether two oriented boxes overlap (separating axes).

    Args:
        dx, dy: from the centre of a to that of b, metres.
        ca, sa, cb, sb: cosine and sine of their headings.
        la, wa, lb, wb: half lengths and half widths, metres.
    """
    c, s = abs(ca * cb + sa * sb), abs(ca * sb - sa * cb)
    if abs(dx * ca + dy * sa) > la + lb * c + wb * s or abs(dy * ca - dx * sa) > wa + lb * s + wb * c:
        return False
    return not (abs(dx * cb + dy * sb) > lb + la * c + wa * s or abs(dy * cb - dx * sb) > wb + la * s + wa * c)


@njit(cache=True)
def _meet(
    poses: Records,
    others: Records,
    grid: Grid,
    near_start: Ints,
    near: Ints,
    boxes: tuple[float, float, float, float],
    count: int,
) -> NDArray:
    """Rows (lane, other, a0, a1, b0, b1, mean cosine of the angle between them), ordered by lane and other."""
    box = np.zeros((count, 6))  # a0, a1, b0, b1, sum of cosines, number
    touched = np.zeros(count, np.int64)
    rows = []
    begin = 0
    while begin < len(poses):  # Poses of a lane stand together.
        lane = poses[begin].lane
        end = begin
        touches = 0
        while end < len(poses) and poses[end].lane == lane:
            touches = _touch(poses[end], others, grid, boxes, box, touched, touches)
            end += 1
        for other in np.sort(touched[:touches]):
            entry = box[other]
            kin = False
            for k in range(near_start[lane], near_start[lane + 1]):
                kin = kin or near[k] == other
            if not kin:
                rows.append((float(lane), float(other), entry[0], entry[1], entry[2], entry[3], entry[4] / entry[5]))
            entry[:] = 0.0
        begin = end
    result = np.zeros((len(rows), 7))
    for i in range(len(rows)):
        for j in range(7):
            result[i, j] = rows[i][j]
    return result


@kernel
def _touch(
    p: Record,
    others: Records,
    grid: Grid,
    boxes: tuple[float, float, float, float],
    box: NDArray,
    touched: NDArray,
    touches: int,
) -> int:
    """Fold all poses of other lanes at which a vehicle would touch one at pose `p` into `box` (L, 6)."""
    la, wa, lb, wb = boxes
    reach = np.sqrt(la**2 + wa**2) + np.sqrt(lb**2 + wb**2)
    ca, sa = np.cos(p.heading), np.sin(p.heading)
    r0, r1, c0, c1 = cell_range(grid, p.x, p.y, reach)
    for r in range(r0, r1):
        for k in range(grid.start[r * grid.shape[1] + c0], grid.start[r * grid.shape[1] + c1]):
            o = others[grid.order[k]]
            dx, dy = o.x - p.x, o.y - p.y
            if o.lane == p.lane or abs(o.z - p.z) > LEVEL or dx * dx + dy * dy > reach * reach:
                continue
            cb, sb = np.cos(o.heading), np.sin(o.heading)
            if not boxes_touch(dx, dy, ca, sa, cb, sb, la, wa, lb, wb):
                continue
            entry = box[o.lane]
            if entry[5] == 0.0:
                touched[touches] = o.lane
                touches += 1
                entry[0] = entry[1] = p.s
                entry[2] = entry[3] = o.s
            entry[0], entry[1] = min(entry[0], p.s), max(entry[1], p.s)
            entry[2], entry[3] = min(entry[2], o.s), max(entry[3], o.s)
            entry[4] += ca * cb + sa * sb
            entry[5] += 1.0
    return touches


def _records(town: Town, rows: NDArray) -> NDArray:
    """Zones from the rows of `_meet`: of which kind, and how arc lengths on the two lanes correspond."""
    zones = np.zeros(len(rows), ZONE)
    for k, name in enumerate(("a0", "a1", "b0", "b1")):
        zones[name] = rows[:, 2 + k]
    zones["other"] = rows[:, 1]
    for zone, row in zip(zones, rows, strict=True):
        lane, other = town.lanes[int(row[0])], town.lanes[int(row[1])]
        split = bool(set(lane.predecessors) & set(other.predecessors))
        merge = bool(set(lane.successors) & set(other.successors))
        zone["joint"] = SPLIT if split else MERGE if merge else APART
        zone["kind"] = LEAD if split or merge or row[6] > np.cos(ALONGSIDE) else CROSS
        zone["ratio"] = 1.0
        if merge and not split:
            zone["at_a"], zone["at_b"] = lane.length, other.length
        elif not split:
            zone["at_a"], zone["at_b"] = row[2], row[4]
            zone["ratio"] = (row[3] - row[2]) / max(row[5] - row[4], 1e-6)
    return zones

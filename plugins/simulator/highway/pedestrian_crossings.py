"""Crossings of pedestrians: the crosswalks of a town, and places along its roads where somebody may cross."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from me3bev_plugins.simulator.highway.pedestrian_ground import survey
from me3bev_plugins.simulator.highway.town import Floats, Ints, Town
from me3bev_plugins.simulator.highway.traffic_grid import Grid, build_grid, cell_range
from me3bev_plugins.simulator.highway.traffic_records import CROSSING, FOOTING, LINK, Record, Records

REACH = 9.0
"""A crosswalk is used from strips within this distance of its ends, metres."""
EVERY = 20.0
"""Distance between the places along a strip at which the road is looked across, metres."""
WIDEST, NARROWEST = 22.0, 5.0
"""Range of the widths of road that are crossed without a crosswalk, metres."""
CORNER = 15.0
"""A place to cross as near as this to a junction is at its corner, metres."""
AWAY = 20.0
"""Nobody crosses beside a crosswalk as near as this, metres."""
ASIDE, FARTHEST = 0.7, 8.0
"""Waiting people keep so far from the kerb, and the ends of crosswalks are moved by less than that, metres."""
LEVEL = 2.5
"""Difference of height beyond which nothing meets, metres."""

Found = tuple[Records, Ints, Ints, Records]
Way = tuple[Floats, list[int]]


def find_crossings(
    town: Town, lanes: Records, samples: Records, ground: Grid, strips: Records, footings: Records
) -> Found:
    """(crossings (C,), their links in one row, their signals in one row, links (K,) ordered by lane)."""
    owner = np.repeat(np.arange(len(strips)), strips["count"])
    grid = build_grid(footings)
    ways = [_marked(walk.corners, lanes, samples, ground, footings, grid) for walk in town.crosswalks]
    marked = [way for way in ways if way is not None]
    loose = _loose(strips, footings, owner, grid, marked)
    crossings = np.zeros(len(marked) + len(loose), CROSSING)
    for n, (crossing, (ends, feet)) in enumerate(zip(crossings, [*marked, *loose], strict=True)):
        crossing["x0"], crossing["y0"], crossing["x1"], crossing["y1"] = ends.ravel()
        crossing["length"] = np.hypot(*(ends[1] - ends[0]))
        crossing["marked"] = n < len(marked)
        for side, foot in enumerate(feet):
            strip = int(owner[foot])
            crossing[f"strip{side}"], crossing[f"z{side}"] = strip, footings["z"][foot]
            crossing[f"s{side}"] = (foot - strips["first"][strip]) * strips["step"][strip]
    met = [_met(crossing, samples) for crossing in crossings]
    keep = [n for n, rows in enumerate(met) if len(rows) and (crossings["marked"][n] or _harmless(town, rows))]
    return _pack(lanes, town, crossings[keep], [met[n] for n in keep])


def _marked(
    corners: Floats, lanes: Records, samples: Records, ground: Grid, footings: Records, grid: Grid
) -> Way | None:
    """Ends (2, 2) of a crosswalk and the footings beside them; None where nobody can stand or get away."""
    ends = _off_the_road(np.array([corners[:2].mean(0), corners[2:].mean(0)]), lanes, samples, ground)
    if ends is None:
        return None
    feet = [_nearest(footings, grid, x, y, REACH) for x, y in ends]
    return (ends, feet) if min(feet) >= 0 and feet[0] != feet[1] else None


def _off_the_road(ends: Floats, lanes: Records, samples: Records, ground: Grid) -> Floats | None:
    """The ends (2, 2) of a crossing moved outwards to where nobody who waits is in the way of turning vehicles."""
    outward = (ends[1] - ends[0]) / np.hypot(*(ends[1] - ends[0])) * np.array([[-1.0], [1.0]])
    steps = np.arange(0.0, FARTHEST, 0.25)
    moved = ends.copy()
    for side in (0, 1):
        line = np.zeros(len(steps), FOOTING)
        line["x"], line["y"] = (ends[side] + steps[:, None] * outward[side]).T
        survey(line, samples, lanes, ground)
        clear = np.flatnonzero(line["free"] > ASIDE)
        if not len(clear):
            return None
        moved[side] += steps[clear[0]] * outward[side]
    return moved


def _loose(strips: Records, footings: Records, owner: Ints, grid: Grid, marked: list[Way]) -> list[Way]:
    """Ends and footings of the places along the roads where somebody may cross."""
    taken = np.array([ends.mean(0) for ends, _ in marked]).reshape(-1, 2)
    found: list[Way] = []
    seen: set[tuple[int, int]] = set()
    for i, strip in enumerate(strips):
        stride = max(1, round(EVERY / strip["step"]))
        for foot in range(strip["first"] + stride // 2, strip["first"] + strip["count"], stride):
            for side in (1.0, -1.0):
                other = _opposite(footings, grid, foot, side)
                if other < 0 or (owner[other] == i and abs(other - foot) < 40):
                    continue
                ends = np.array([[footings[n]["x"], footings[n]["y"]] for n in (foot, other)])
                cell = (round(float(ends[:, 0].mean()) / 10), round(float(ends[:, 1].mean()) / 10))
                near = len(taken) and np.hypot(*(taken - ends.mean(0)).T).min() < AWAY
                if not near and cell not in seen:
                    seen.add(cell)
                    found.append((ends, [foot, other]))
    return found


@njit(cache=True)
def _nearest(footings: Records, grid: Grid, x: float, y: float, reach: float) -> int:
    """The footing nearest to a point within reach, or -1."""
    best, found = reach * reach, -1
    r0, r1, c0, c1 = cell_range(grid, x, y, reach)
    for r in range(r0, r1):
        for k in range(grid.start[r * grid.shape[1] + c0], grid.start[r * grid.shape[1] + c1]):
            p = footings[grid.order[k]]
            away = (p.x - x) ** 2 + (p.y - y) ** 2
            if away < best:
                best, found = away, grid.order[k]
    return found


@njit(cache=True)
def _opposite(footings: Records, grid: Grid, foot: int, side: float) -> int:
    """The first footing straight across on one side, or -1."""
    here = footings[foot]
    nx, ny = -side * np.sin(here.heading), side * np.cos(here.heading)
    metres = NARROWEST
    while metres < WIDEST:
        other = _nearest(footings, grid, here.x + metres * nx, here.y + metres * ny, 0.8)
        if other >= 0 and abs(footings[other].z - here.z) < LEVEL:
            return other
        metres += 0.5
    return -1


@njit(cache=True)
def _met(crossing: Record, samples: Records) -> NDArray:
    """Rows (lane, index of the sample before, share of the way to the next, metres along) of the lanes met."""
    dx, dy = crossing.x1 - crossing.x0, crossing.y1 - crossing.y0
    length = max(np.sqrt(dx * dx + dy * dy), 1e-6)
    ux, uy = dx / length, dy / length
    z = 0.5 * (crossing.z0 + crossing.z1)
    rows = np.zeros((64, 4))
    count = 0
    for k in range(len(samples) - 1):
        a, b = samples[k], samples[k + 1]
        if a.lane != b.lane or abs(a.z - z) > LEVEL:
            continue
        # Distances of both samples from the line of the crossing; their signs differ where the lane crosses it.
        pa = -(a.x - crossing.x0) * uy + (a.y - crossing.y0) * ux
        pb = -(b.x - crossing.x0) * uy + (b.y - crossing.y0) * ux
        if pa * pb > 0.0 or pa == pb or abs(pa) > 2.0:
            continue
        t = pa / (pa - pb)
        along = (a.x + t * (b.x - a.x) - crossing.x0) * ux + (a.y + t * (b.y - a.y) - crossing.y0) * uy
        if -1.0 < along < length + 1.0 and count < 64:
            rows[count, 0], rows[count, 1], rows[count, 2], rows[count, 3] = a.lane, k, t, along
            count += 1
    return rows[:count]


def _harmless(town: Town, rows: NDArray) -> bool:
    """Whether only a few ordinary lanes outside junctions are crossed."""
    crossed = [town.lanes[int(row[0])] for row in rows]
    return len(crossed) <= 4 and all(lane.junction is None and not lane.highway for lane in crossed)


def _pack(lanes: Records, town: Town, crossings: Records, met: list[NDArray]) -> Found:
    """Links ordered by lane, and for every crossing which of them and which signals are its own."""
    rows = sorted(
        (int(row[0]), float((row[1] - lanes["first"][int(row[0])] + row[2]) * lanes["step"][int(row[0])]), c, row[3])
        for c, found in enumerate(met)
        for row in found
    )
    links = np.zeros(len(rows), LINK)
    for link, (_, s, crossing, along) in zip(links, rows, strict=True):
        link["s"], link["crossing"], link["along"] = s, crossing, along
    owners = np.array([row[0] for row in rows], np.int64)
    lanes["cross0"] = np.searchsorted(owners, np.arange(len(lanes)), "left")
    lanes["cross1"] = np.searchsorted(owners, np.arange(len(lanes)), "right")
    own_links: list[int] = []
    own_signals: list[int] = []
    for c, crossing in enumerate(crossings):
        mine = [k for k, row in enumerate(rows) if row[2] == c]
        crossing["met0"], crossing["met1"] = len(own_links), len(own_links) + len(mine)
        own_links += mine
        crossing["corner"] = any(_at_corner(town, lanes, rows[k][0], rows[k][1]) for k in mine)
        signals = sorted({n for k in mine for n in _signals(town, lanes, rows[k][0], rows[k][1])})
        crossing["signal0"], crossing["signal1"] = len(own_signals), len(own_signals) + len(signals)
        own_signals += signals
    return crossings, np.array(own_links, np.int32), np.array(own_signals, np.int32), links


def _at_corner(town: Town, lanes: Records, lane: int, s: float) -> bool:
    """Whether a junction begins, or ends, near arc length `s` of a lane."""
    here, junction = town.lanes[lane], lanes["junction"]
    left = any(junction[n] >= 0 for n in here.predecessors) and s < CORNER
    return left or (any(junction[n] >= 0 for n in here.successors) and here.length - s < CORNER)


def _signals(town: Town, lanes: Records, lane: int, s: float) -> set[int]:
    """Signals that hold back who would come straight over a crossing at arc length `s` of a lane."""
    record = lanes[lane]
    if record["junction"] < 0:
        near = record["signal"] >= 0 and s > record["length"] - 12.0
        return {int(record["signal"])} if near else set()
    if s > 8.0 and record["turn"] != 0:
        return set()  # Who turns into a road lets those pass who cross it.
    return {int(lanes["signal"][p]) for p in town.lanes[lane].predecessors if lanes["signal"][p] >= 0}

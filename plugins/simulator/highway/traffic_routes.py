"""Where traffic is going: a town's destinations, and from every lane the time to each of them."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from me3bev_plugins.simulator.highway.compiled import kernel
from me3bev_plugins.simulator.highway.town import Floats, Ints, Town
from me3bev_plugins.simulator.highway.traffic_records import LONG, MEDIUM, SHORT, SMALL, Record, Records

DESTINATIONS = 32
"""Per size of vehicle."""
CHANGE = 6.0
"""What a change of lanes counts on the way, seconds."""
SHORTEST, SECONDS = 20.0, 3.0
"""Nobody counts on changing lanes that are shorter than so many metres and what is driven in these seconds."""
TURNS = (0.0, 1.5, 4.0, 20.0)
"""What straight on, a turn to the right, to the left and back count, seconds."""
GATE = 3.0
"""What a gate counts, seconds."""
TASTES = (0.7, 1.5)
"""Range of the factors by which drivers to different destinations differ about a lane."""
_SEED = 20


@kernel
def class_of(admits: int) -> int:
    """0 to 3 for the bits SMALL, SHORT, MEDIUM, LONG."""
    return (admits > SMALL) + (admits > SHORT) + (admits > MEDIUM)


@kernel
def time_into(lane: Record) -> float:
    """What it counts to enter a lane, seconds."""
    return TURNS[lane.turn] + GATE * lane.gate


def plan_routes(town: Town, lanes: Records) -> NDArray[np.float32]:
    """Seconds (4, DESTINATIONS, L) from the start of lane i, by class of size, to each destination; infinite if never.

    A destination is a lane outside junctions with its neighbours of the same direction. Destinations are drawn by
    length; each weighs the lanes on the way by factors of its own, so that not everybody takes the same road.
    """
    rng = np.random.default_rng(_SEED)
    begin, end, base = _edges(town, lanes)
    order = np.argsort(end, kind="stable")
    begin, end, base = begin[order], end[order], base[order]
    roads = np.array([min(_abreast(lanes, i)) for i in range(len(lanes))])
    changes = (lanes["left"][begin] == end) | (lanes["right"][begin] == end)
    start = np.searchsorted(end, np.arange(len(lanes) + 1)).astype(np.int32)
    found = np.full((4, DESTINATIONS, len(lanes)), np.inf, np.float32)
    for size in (SMALL, SHORT, MEDIUM, LONG):
        admitted = (lanes["admits"] & size) > 0
        goals = np.flatnonzero(admitted & (lanes["junction"] < 0))
        if not len(goals):
            continue
        chosen = rng.choice(goals, DESTINATIONS, p=lanes["length"][goals] / lanes["length"][goals].sum())
        for n, goal in enumerate(chosen):
            taste = rng.uniform(*TASTES, len(lanes))[roads]  # Lanes abreast differ in their queues only.
            weight = np.where(admitted[begin] & admitted[end], np.where(changes, CHANGE, base * taste[begin]), np.inf)
            times = np.full(len(lanes), np.inf)
            times[[i for i in _abreast(lanes, int(goal)) if admitted[i]]] = 0.0
            _spread(start, begin, weight, times)
            found[class_of(size), n] = times
    return found


def _abreast(lanes: Records, lane: int) -> list[int]:
    """A lane and its neighbours of the same direction."""
    found = [lane]
    for side in ("left", "right"):
        n = int(lanes[side][lane])
        while n >= 0 and n not in found:
            found.append(n)
            n = int(lanes[side][n])
    return found


def _edges(town: Town, lanes: Records) -> tuple[Ints, Ints, Floats]:
    """(from, to, seconds) of the ways on from every lane: its successors, and its neighbours."""
    rows = []
    for lane in town.lanes:
        seconds = lane.length / max(float(lanes["speed"][lane.id]), 3.0)
        for n in lane.successors:
            rows.append((lane.id, n, seconds + time_into(lanes[n])))
        least = SHORTEST + SECONDS * lane.limit
        for side in (lane.left, lane.right):
            if side is not None and lane.junction is None and min(lane.length, town.lanes[side].length) > least:
                rows.append((lane.id, side, CHANGE))
    table = np.array(rows, np.float64).reshape(-1, 3)
    return table[:, 0].astype(np.int32), table[:, 1].astype(np.int32), table[:, 2].copy()


@njit(cache=True)
def _spread(start: Ints, begin: Ints, weight: Floats, times: Floats) -> None:
    """Shortest times from every lane, given those of the destination; edges to lane i are `start[i]:start[i + 1]`."""
    count = len(times)
    queue = np.empty(count + 1, np.int32)
    waiting = np.zeros(count, np.bool_)
    head = tail = 0
    for i in range(count):
        if times[i] == 0.0:
            queue[tail] = i
            tail += 1
            waiting[i] = True
    while head != tail:
        i = queue[head]
        head = (head + 1) % (count + 1)
        waiting[i] = False
        for k in range(start[i], start[i + 1]):
            n = begin[k]
            if times[i] + weight[k] < times[n]:
                times[n] = times[i] + weight[k]
                if not waiting[n]:
                    waiting[n] = True
                    queue[tail] = n
                    tail = (tail + 1) % (count + 1)

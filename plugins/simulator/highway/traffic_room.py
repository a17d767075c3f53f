"""Room beyond a junction: nobody goes in who could not get out again."""

from __future__ import annotations

import numpy as np

from me3bev_plugins.simulator.highway.compiled import kernel
from me3bev_plugins.simulator.highway.town import Ints
from me3bev_plugins.simulator.highway.traffic_records import TRAIL, Record
from me3bev_plugins.simulator.highway.traffic_state import Board, Fleet
from me3bev_plugins.simulator.highway.traffic_tables import Roads

JAM = 5.0
"""Distance to the one before in a queue, metres."""
AMPLE = 60.0
"""A road that is free for so long has room, metres."""
FLOWING = 2.0
"""Seconds for which a vehicle at the end of a queue is expected to go on."""


@kernel
def holds(roads: Roads, car: Record, first: int, last: int, metres: float) -> bool:
    """Whether a vehicle fits between two gates: `metres` of lanes from lane `first` to lane `last`."""
    end = roads.lanes[last]
    return metres - (end.length - end.stop) - roads.lanes[first].clear > car.length + 1.0


@kernel
def is_between(roads: Roads, car: Record, path: Ints, trail: Ints, gate: int) -> bool:
    """Whether the gate comes so soon after another one that the vehicle cannot stand clear of both, as in a ring."""
    metres, first = 0.0, -1
    for k in range(gate - 1, -1, -1):
        if roads.lanes[path[k]].gate:
            return first >= 0 and not holds(roads, car, first, path[gate - 1], metres)
        first = path[k]
        metres += roads.lanes[path[k]].length
    for k in range(TRAIL):
        if trail[k] < 0:
            return False
        if roads.lanes[trail[k]].gate:
            return not holds(roads, car, first, path[gate - 1], metres)
        first = trail[k]
        metres += roads.lanes[trail[k]].length
    return False


@kernel
def chain_end(roads: Roads, car: Record, path: Ints, gate: int, between: bool) -> int:
    """The last gate that must be granted together with this one.

    A vehicle that could not stand clear of both needs the next gate too; one that is between two such gates already
    goes from gate to gate, so that rings of short lanes never wait for a whole lap to be free.
    """
    last, metres, links = gate, 0.0, 0
    for k in range(gate + 1, car.count):
        lane = roads.lanes[path[k]]
        if not lane.gate:
            metres += lane.length
            if metres > AMPLE:
                break
            continue
        if k > last + 1:
            if between or links == 1 or holds(roads, car, path[last + 1], path[k - 1], metres):
                break
            links += 1
        last, metres = k, 0.0
    return last


@kernel
def has_room(roads: Roads, fleet: Fleet, board: Board, i: int, gate: int, last: int) -> bool:
    """Whether vehicle `i` can get out behind the last gate, and out of the way between any two of them."""
    car, path = fleet.cars[i], fleet.path[i]
    k = gate
    while k < last:
        after = k + 1
        if not roads.lanes[path[after]].gate and not _is_empty(roads, fleet, board, i, after, last):
            return False
        k += 1
    first = last + 1
    if first >= car.count:
        return True
    room = 0.0
    for k in range(first, car.count):
        lane = roads.lanes[path[k]]
        if lane.gate:
            if not holds(roads, car, path[first], path[k - 1], room):
                return _is_empty(roads, fleet, board, i, first, k)
            before = roads.lanes[path[k - 1]]
            room -= before.length - before.stop + 0.5
            break
        rear, speed = _last_in_line(board, path[k])
        if rear < np.inf:
            if not _reaches(roads, car, path, first, k, room):
                return _is_empty(roads, fleet, board, i, first, k + 1)
            room += rear + FLOWING * max(speed, 0.0) - JAM
            break
        room += lane.length
        if room > AMPLE:
            return True
    return room - board.bound[path[first]] > car.length + roads.lanes[path[first]].clear


@kernel
def _reaches(roads: Roads, car: Record, path: Ints, first: int, k: int, room: float) -> bool:
    """Whether the lanes from `first` on, of which those before `k` are `room` long, would hold the vehicle at all."""
    for n in range(k, car.count):
        if roads.lanes[path[n]].gate:
            return holds(roads, car, path[first], path[n - 1], room)
        room += roads.lanes[path[n]].length
        if room > AMPLE:
            break
    return True


@kernel
def _last_in_line(board: Board, lane: int) -> tuple[float, float]:
    """(rear, speed) of the hindmost vehicle of a lane, infinity for none."""
    rear, speed = np.inf, 0.0
    n = board.heads[lane]
    while n >= 0:
        entry = board.entries[n]
        n = entry.next
        if entry.s - entry.half < rear and entry.s >= 0.0:
            rear, speed = entry.s - entry.half, entry.speed
    return rear, speed


@kernel
def _is_empty(roads: Roads, fleet: Fleet, board: Board, i: int, first: int, end: int) -> bool:
    """Whether nobody waits, or will wait, on the lanes of path places `first` to `end` up to the next gate."""
    path = fleet.path[i]
    if board.bound[path[first]] > 0.0:
        return False
    for k in range(first, end):
        if roads.lanes[path[k]].gate:
            return True
        n = board.heads[path[k]]
        while n >= 0:
            entry = board.entries[n]
            n = entry.next
            other = fleet.cars[entry.vehicle]
            if entry.vehicle != i and entry.s >= 0.0 and other.clear == 0:
                return False
    return True

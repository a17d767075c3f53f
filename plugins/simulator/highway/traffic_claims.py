"""Whether the others leave a vehicle its way through a junction."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from me3bev_plugins.simulator.highway.compiled import kernel
from me3bev_plugins.simulator.highway.traffic_records import CROSS, HALF, LARGE, SPLIT, Record
from me3bev_plugins.simulator.highway.traffic_state import Board
from me3bev_plugins.simulator.highway.traffic_tables import Roads

BRISK = 2.0
"""Acceleration with which a vehicle is expected to clear a junction, m/s^2."""
HASTY = 3.5
"""Acceleration that others are given credit for, m/s^2."""
MARGIN = 1.0
"""Seconds between two vehicles that cross."""


@kernel
def conflicts(roads: Roads, board: Board, car: Record, i: int, lane: int, start: float, heed: bool) -> bool:
    """Whether anybody is in the way of vehicle `i` on a connector that begins `start` metres from its centre.

    Args:
        heed: also those who only claim theirs count.
    """
    for size in range(2):
        pair = 2 * car.size + size
        for z in range(roads.zone_start[pair, lane], roads.zone_start[pair, lane + 1]):
            zone = roads.zones[z]
            if zone.kind == CROSS and _is_blocked(board, zone, i, size):
                return True
            if is_taken(roads, board, car, i, lane, zone, start, size, heed):
                return True
    return False


@kernel
def hold_distance(roads: Roads, board: Board, car: Record, path: NDArray, i: int) -> float:
    """How far a vehicle that gave up its right of way inside a junction may go: to the first zone that is taken."""
    own = 0.5 * car.length - HALF[car.size]
    nearest = np.inf
    start = -car.s
    for k in range(min(car.clear + 1, car.count)):
        if roads.lanes[path[k]].gate:
            for size in range(2):
                pair = 2 * car.size + size
                for z in range(roads.zone_start[pair, path[k]], roads.zone_start[pair, path[k] + 1]):
                    zone = roads.zones[z]
                    room = start + zone.a0 - own
                    if 0.0 < room < nearest and is_taken(roads, board, car, i, path[k], zone, start, size, False):
                        nearest = room
        start += roads.lanes[path[k]].length
    return nearest


@kernel
def abreast(zone: Record, s: float) -> float:
    """The arc length on a zone's own lane that corresponds to one on the other lane.

    Before the zone both count from its start, so that each of two vehicles agrees on who is nearer.
    """
    if s < zone.b0:
        return zone.at_a + (zone.b0 - zone.at_b) * zone.ratio - (zone.b0 - s)
    return zone.at_a + (s - zone.at_b) * zone.ratio


@kernel
def gives_way(user: Record, car: Record, i: int) -> bool:
    """Whether a user that is not there yet has given up its turn in favour of vehicle `i`.

    Of two that have, the first in the list that moves goes.
    """
    return user.meek and not (car.meek and user.speed > 0.2 and user.vehicle < i)


@kernel
def is_taken(
    roads: Roads, board: Board, car: Record, i: int, lane: int, zone: Record, start: float, size: int, heed: bool
) -> bool:
    """Whether a zone is, or will be, used by somebody with the right of way before vehicle `i` is through.

    Args:
        start: metres from the vehicle's centre to the start of its `lane`.
        size: of the other vehicles for which the zone was measured.
    """
    if zone.joint == SPLIT:
        return False
    k = board.user_heads[zone.other]
    if k < 0:
        return False
    own = 0.5 * car.length - HALF[car.size]
    while k >= 0:
        user = board.users[k]
        k = user.next
        if user.vehicle == i or int(user.half > LARGE) != size:
            continue
        over = user.half - HALF[size]
        if user.s > zone.b1 + over + 0.5 or (user.s < zone.b0 - over and gives_way(user, car, i)):
            continue
        if user.claim:
            if heed:
                return True
            continue
        if zone.kind == CROSS:
            mine = time_to(start + zone.a1 + own, car.speed, BRISK, max(roads.lanes[lane].speed, 4.0))
            theirs = time_to(zone.b0 - over - user.s, user.speed, HASTY, roads.lanes[zone.other].limit)
            if mine + MARGIN > theirs:
                return True
            continue
        ahead = start + abreast(zone, user.s)
        clear = 0.5 * car.length + user.half + 2.0
        gain = max(0.0, user.speed**2 - car.speed**2) / 5.0
        if -(clear + user.speed + gain) < ahead < clear:
            return True
    return False


@kernel
def _is_blocked(board: Board, zone: Record, i: int, size: int) -> bool:
    """Whether somebody stands where the other lane of a zone crosses this one."""
    k = board.heads[zone.other]
    while k >= 0:
        entry = board.entries[k]
        k = entry.next
        over = entry.half - HALF[size]
        if entry.vehicle == i or entry.speed > 1.0 or int(entry.half > LARGE) != size:
            continue
        if zone.b0 - over < entry.s < zone.b1 + over:
            return True
    return False


@kernel
def time_to(metres: float, speed: float, accel: float, limit: float) -> float:
    """Seconds to cover a distance, speeding up to a limit."""
    if metres <= 0.0:
        return 0.0
    limit = max(limit, speed, 0.5)
    ramp = (limit * limit - speed * speed) / (2.0 * accel)
    if metres <= ramp:
        return (np.sqrt(speed * speed + 2.0 * accel * metres) - speed) / accel
    return (limit - speed) / accel + (metres - ramp) / limit

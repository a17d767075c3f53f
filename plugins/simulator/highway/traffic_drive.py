"""How fast: the acceleration of one vehicle from everything that lies on its way."""

from __future__ import annotations

import numpy as np

from me3bev_plugins.simulator.highway.compiled import kernel
from me3bev_plugins.simulator.highway.town import Floats, Ints
from me3bev_plugins.simulator.highway.traffic_claims import abreast, gives_way
from me3bev_plugins.simulator.highway.traffic_records import CROSS, HALF, LARGE, LEAD, MERGE, SPLIT, Record
from me3bev_plugins.simulator.highway.traffic_state import Board, speed_at
from me3bev_plugins.simulator.highway.traffic_tables import EASE, Roads

SIGHT = 120.0
"""How far ahead a driver looks, metres."""
HARDEST = 8.0
"""Deceleration in an emergency, m/s^2."""
FIRM = 4.0
"""Deceleration beyond which stopping at a mark is no longer left to the model, m/s^2."""
GENTLE = 2.5
"""Deceleration with which a driver yields to pedestrians, m/s^2."""
FORESIGHT = 0.6
"""How far ahead on its own lane a driver sees what a bend allows, seconds."""
CURB_GAP = 2.0
"""What is left free before pedestrians, metres."""
ZIP, UNHURRIED = 70.0, 1.5
"""Where two lanes become one outside junctions drivers make room for one another from so far before, metres, gently
until they are so many seconds from where the lanes meet."""


@kernel
def decision_distance(speed: float) -> float:
    """How far before a gate a driver settles whether to go, metres."""
    return speed * speed / 4.0 + 12.0


@kernel
def free_road(idm: Floats, speed: float, wanted: float) -> float:
    """IDM without a leader, m/s^2."""
    return max(-idm[5], idm[0] * (1.0 - (max(speed, 0.0) / max(wanted, 0.01)) ** idm[4]))


@kernel
def follow(idm: Floats, free: float, speed: float, leader: float, distance: float, lengths: float) -> float:
    """IDM behind a leader, m/s^2, measured between centres as highway-env does.

    Args:
        free: acceleration without the leader, m/s^2.
        speed, leader: m/s.
        distance: between centres, metres.
        lengths: half of both lengths together, metres.
    """
    wanted = idm[3] + lengths + speed * idm[2] + speed * (speed - leader) / (2.0 * np.sqrt(idm[0] * idm[1]))
    accel = max(-idm[5], free - idm[0] * (max(wanted, 0.0) / max(distance, 0.01)) ** 2)
    gap = distance - lengths
    closing = speed * speed - max(leader, 0.0) ** 2
    if closing > 0.0 and gap < closing / (2.0 * FIRM) + 0.5:
        # The model alone brakes late for what turns up suddenly.
        accel = min(accel, -closing / (2.0 * max(gap - 0.5, 0.05)))
    return accel


@kernel
def halt(idm: Floats, free: float, speed: float, distance: float) -> float:
    """Acceleration to stand `distance` metres further on, m/s^2."""
    if distance <= 0.05:
        return -HARDEST if speed > 0.0 else -0.1
    wanted = 0.3 + speed * 0.5 + speed * speed / (2.0 * np.sqrt(idm[0] * idm[1]))
    accel = max(-idm[5], free - idm[0] * (wanted / distance) ** 2)
    needed = speed * speed / (2.0 * distance)
    if needed > 0.5 * FIRM:
        accel = min(accel, -needed)
    return accel


@kernel
def drive(roads: Roads, board: Board, car: Record, path: Ints, i: int) -> float:
    """The longitudinal acceleration that a careful driver in vehicle `i` would choose now, m/s^2."""
    idm = roads.idm
    accel = _keep_to_limits(roads, car, path)
    free = accel
    if car.meek:
        accel = min(accel, halt(idm, free, car.speed, car.hold - 0.5))
    start = -car.s
    half = 0.5 * car.length
    reach = 1.5 * decision_distance(car.speed)
    for k in range(car.count):
        lane = roads.lanes[path[k]]
        if start > SIGHT:
            break
        if k > car.clear and lane.gate:
            before = roads.lanes[path[k - 1]]
            line = start - (before.length - before.stop) - half - 0.5
            if line < -1.0:  # Beyond the crossing already: the gate itself counts.
                line = start - half - 0.5
            if line < decision_distance(car.speed) + 1.0:
                accel = min(accel, halt(idm, free, car.speed, line))
            break
        if start < reach:
            accel = min(accel, _meet_zones(roads, board, car, path[k], start, i, free))
            if lane.cross1 > lane.cross0:
                accel = min(accel, _meet_walkers(roads, board, car, lane, start, free))
        blocked, value = _meet_leader(roads, board, car, path[k], start, i, free)
        accel = min(accel, value)
        if blocked:
            break
        start += lane.length
        if lane.follow0 == lane.follow1 and start - half < decision_distance(car.speed):
            accel = min(accel, halt(idm, free, car.speed, start - half))  # A dead end.
    if car.leaving >= 0:
        accel = min(accel, _meet_leader(roads, board, car, car.leaving, -(car.s + car.shift), i, free)[1])
    return min(max(accel, -HARDEST), idm[5])


@kernel
def _keep_to_limits(roads: Roads, car: Record, path: Ints) -> float:
    """Acceleration on a free road with its limits and bends, here and ahead, m/s^2."""
    here = speed_at(roads, path[0], car.s)
    wanted, needed = here, 0.0
    soon = max(FORESIGHT * car.speed, 0.5)
    start = -car.s
    for k in range(car.count):
        if start > SIGHT:
            break
        entry = roads.lanes[path[k]].speed if k > 0 else speed_at(roads, path[0], car.s + soon)
        metres = start if k > 0 else soon
        wanted = min(wanted, np.sqrt(entry * entry + 2.0 * EASE * metres))
        if entry < here:
            entry *= car.eager
            needed = max(needed, (car.speed * car.speed - entry * entry) / (2.0 * max(metres, 0.5)))
        start += roads.lanes[path[k]].length
    accel = free_road(roads.idm, car.speed, wanted * car.eager)
    if needed > 0.75 * EASE:  # The model alone would still be too fast when it gets there.
        accel = min(accel, -min(needed, FIRM))
    return accel


@kernel
def _meet_leader(
    roads: Roads, board: Board, car: Record, lane: int, start: float, i: int, free: float
) -> tuple[bool, float]:
    """Whether somebody is ahead on a lane that begins `start` metres from the centre, and the acceleration for it."""
    nearest, found = np.inf, -1
    k = board.heads[lane]
    while k >= 0:
        entry = board.entries[k]
        distance = start + entry.s
        if entry.vehicle != i and distance < nearest and (distance > 0.0 or (distance == 0.0 and entry.vehicle < i)):
            nearest, found = distance, k
        k = entry.next
    if found < 0:
        return False, free
    entry = board.entries[found]
    lengths = 0.5 * car.length + entry.half
    return True, follow(roads.idm, free, car.speed, entry.speed, nearest, lengths)


@kernel
def _meet_zones(roads: Roads, board: Board, car: Record, lane: int, start: float, i: int, free: float) -> float:
    """Acceleration for those who are where other lanes meet this one."""
    accel = free
    own = 0.5 * car.length - HALF[car.size]
    gated = roads.lanes[lane].gate
    for size in range(2):
        pair = 2 * car.size + size
        for z in range(roads.zone_start[pair, lane], roads.zone_start[pair, lane + 1]):
            zone = roads.zones[z]
            if start + zone.a1 + own < 0.0:
                continue
            if zone.kind == LEAD and zone.joint != SPLIT and start + zone.a0 > own:
                if gated:
                    accel = min(accel, _file_in(roads, board, car, zone, start, i, free, size))
                elif zone.joint == MERGE:
                    accel = min(accel, _zip_in(roads, board, car, zone, start, i, free, size))
            k = board.heads[zone.other]
            while k >= 0:
                entry = board.entries[k]
                k = entry.next
                over = entry.half - HALF[size]
                if entry.vehicle == i or entry.s < zone.b0 - over or entry.s > zone.b1 + over:
                    continue
                if int(entry.half > LARGE) != size:
                    continue
                if zone.kind == CROSS:
                    room = start + zone.a0 - own
                    if room > 0.0:
                        accel = min(accel, halt(roads.idm, free, car.speed, room - 0.5))
                    continue
                distance = start + abreast(zone, entry.s)
                if distance > 0.0 or (distance == 0.0 and entry.vehicle < i):
                    lengths = 0.5 * car.length + entry.half
                    accel = min(accel, follow(roads.idm, free, car.speed, entry.speed, distance, lengths))
    return accel


@kernel
def _file_in(
    roads: Roads, board: Board, car: Record, zone: Record, start: float, i: int, free: float, size: int
) -> float:
    """Acceleration behind those who will go before this vehicle where two connectors run together."""
    accel = free
    k = board.user_heads[zone.other]
    while k >= 0:
        user = board.users[k]
        k = user.next
        if user.vehicle == i or user.claim or int(user.half > LARGE) != size:
            continue
        over = user.half - HALF[size]
        if user.s > zone.b1 + over or (user.s < zone.b0 - over and gives_way(user, car, i)):
            continue
        distance = start + abreast(zone, user.s)
        if distance > 0.0 or (distance == 0.0 and user.vehicle < i):
            lengths = 0.5 * car.length + user.half
            accel = min(accel, follow(roads.idm, free, car.speed, user.speed, distance, lengths))
    return accel


@kernel
def _zip_in(
    roads: Roads, board: Board, car: Record, zone: Record, start: float, i: int, free: float, size: int
) -> float:
    """Acceleration behind those who will be first where two lanes that need no grant become one."""
    accel = free
    metres = start + zone.a0 - 0.5 * car.length + HALF[car.size]
    if metres > ZIP:
        return accel
    least = -GENTLE if metres > UNHURRIED * car.speed else -HARDEST
    k = board.heads[zone.other]
    while k >= 0:
        entry = board.entries[k]
        k = entry.next
        over = entry.half - HALF[size]
        if entry.vehicle == i or int(entry.half > LARGE) != size or not -ZIP < entry.s - zone.b0 + over < 0.0:
            continue
        distance = start + abreast(zone, entry.s)
        if distance > 0.0 or (distance == 0.0 and entry.vehicle < i):
            lengths = 0.5 * car.length + entry.half
            value = follow(roads.idm, free, car.speed, entry.speed, distance, lengths)
            accel = min(accel, max(value, least))
    return accel


@kernel
def _meet_walkers(roads: Roads, board: Board, car: Record, lane: Record, start: float, free: float) -> float:
    """Acceleration for pedestrians in the way, and for those who wait where they may cross."""
    accel = free
    half = 0.5 * car.length
    for k in range(lane.cross0, lane.cross1):
        link = roads.links[k]
        ahead = start + link.s - half
        if ahead < -half:
            continue
        comfortable = ahead - CURB_GAP > car.speed * car.speed / (2.0 * GENTLE)
        polite = comfortable and (board.walkers[k] > 0.0 or board.asked[link.crossing])
        if board.walkers[k] == 1.0 or polite:
            accel = min(accel, halt(roads.idm, free, car.speed, ahead - CURB_GAP))
    return accel

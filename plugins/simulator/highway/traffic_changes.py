"""Changing lanes: now and then, where the other lane is freer and both gaps suffice."""

from __future__ import annotations

import numpy as np

from me3bev_plugins.simulator.highway.compiled import kernel
from me3bev_plugins.simulator.highway.traffic_board import put_entry
from me3bev_plugins.simulator.highway.traffic_drive import follow, free_road
from me3bev_plugins.simulator.highway.traffic_records import TRAIL, Record
from me3bev_plugins.simulator.highway.traffic_state import Board, Fleet, draw, extend, sample_at, speed_at
from me3bev_plugins.simulator.highway.traffic_tables import Roads

DURATION, LENGTHS = 3.0, 3.5
"""A change takes as many metres as are driven in these seconds, and no fewer than so many lengths of the vehicle."""
SAFE = 2.0
"""Deceleration that a change may impose on anybody (highway-env's LANE_CHANGE_MAX_BRAKING_IMPOSED), m/s^2."""
GAIN = 0.2
"""Acceleration that a change must bring (highway-env's LANE_CHANGE_MIN_ACC_GAIN), m/s^2."""
WHIM = 0.1
"""Share of the occasions on which a change that brings nothing, but costs nothing, is made."""
BACK = 25.0
"""No change within this distance of the start of a lane: who comes from behind it would be unseen, metres."""


@kernel
def change_lanes(roads: Roads, fleet: Fleet, board: Board, dt: float) -> None:
    """Let every vehicle whose timer has run out think of another lane. The board must be up to date."""
    for i in range(len(fleet.cars) - 1):
        car = fleet.cars[i]
        car.timer -= dt
        if car.timer > 0.0:
            continue
        car.timer = 2.0 + 4.0 * draw(car)
        to_left = draw(car) < 0.5
        whim = draw(car) < WHIM
        if car.change > 0.0 or car.clear > 0 or car.speed < 3.0:
            continue
        lane = roads.lanes[fleet.path[i, 0]]
        for attempt in range(2):
            target = lane.left if to_left == (attempt == 0) else lane.right
            if target >= 0 and _try(roads, fleet, board, i, target, whim):
                break


@kernel
def _try(roads: Roads, fleet: Fleet, board: Board, i: int, target: int, whim: bool) -> bool:
    car, path = fleet.cars[i], fleet.path[i]
    lane, goal = roads.lanes[path[0]], roads.lanes[target]
    span = max(DURATION * car.speed, LENGTHS * car.length)
    if not (goal.admits & car.admits) or goal.junction >= 0 or car.s + span + 10.0 > lane.length:
        return False
    s, lateral = project(roads, target, car.x, car.y, car.s * goal.length / lane.length)
    if s < BACK or s + span + 10.0 > goal.length or abs(lateral) > 5.0:
        return False
    now = _ahead(roads, board, car, path[0], car.s, i)
    then = _ahead(roads, board, car, target, s, i)
    if then < -SAFE or not _followers_agree(roads, board, car, target, s, i):
        return False
    if then < now + GAIN and not (whim and then > now - GAIN):
        return False
    car.leaving, car.shift = path[0], car.s - s
    car.s, car.offset, car.offset0 = s, lateral, lateral
    car.change = car.span = span
    path[0] = target
    car.count = 1
    for k in range(TRAIL):
        fleet.trail[i, k] = -1
    extend(roads, car, path)
    put_entry(board, target, i, s, 0.5 * car.length, car.speed)  # The next one to think of this lane sees it.
    return True


@kernel
def project(roads: Roads, lane: int, x: float, y: float, guess: float) -> tuple[float, float]:
    """(arc length, metres left) of a point with respect to a lane, near a guess of the arc length."""
    record = roads.lanes[lane]
    middle = int(guess / record.step)
    best, at = np.inf, 0
    for k in range(max(0, middle - 30), min(record.count, middle + 31)):
        p = roads.samples[record.first + k]
        away = (p.x - x) ** 2 + (p.y - y) ** 2
        if away < best:
            best, at = away, k
    s = at * record.step
    px, py, _, heading = sample_at(roads, lane, s)
    c, n = np.cos(heading), np.sin(heading)
    return s + (x - px) * c + (y - py) * n, (y - py) * c - (x - px) * n


@kernel
def _ahead(roads: Roads, board: Board, car: Record, lane: int, s: float, i: int) -> float:
    """IDM acceleration behind the nearest vehicle ahead of `s` on a lane."""
    free = free_road(roads.idm, car.speed, speed_at(roads, lane, s) * car.eager)
    accel = free
    k = board.heads[lane]
    while k >= 0:
        entry = board.entries[k]
        k = entry.next
        if entry.vehicle != i and entry.s >= s:
            lengths = 0.5 * car.length + entry.half
            if entry.s - s < lengths + 2.0:
                return -np.inf
            accel = min(accel, follow(roads.idm, free, car.speed, entry.speed, entry.s - s, lengths))
    return accel


@kernel
def _followers_agree(roads: Roads, board: Board, car: Record, lane: int, s: float, i: int) -> bool:
    """Whether nobody behind `s` on a lane would have to brake hard."""
    k = board.heads[lane]
    while k >= 0:
        entry = board.entries[k]
        k = entry.next
        if entry.vehicle == i or entry.s >= s:
            continue
        lengths = 0.5 * car.length + entry.half
        if s - entry.s < lengths + 2.0:
            return False
        if follow(roads.idm, 0.0, max(entry.speed, 0.0), car.speed, s - entry.s, lengths) < -SAFE:
            return False
    return True


@kernel
def drift(car: Record, metres: float) -> float:
    """Go on with a change of lane; returns the angle between the vehicle and its lane, radians."""
    if car.change <= 0.0:
        return 0.0
    car.change -= metres
    if car.change <= 0.0:
        car.change, car.offset, car.leaving = 0.0, 0.0, -1
        return 0.0
    u = 1.0 - car.change / car.span
    car.offset = car.offset0 * (1.0 - u**3 * (10.0 - 15.0 * u + 6.0 * u * u))
    if abs(car.offset) < 0.25 * abs(car.offset0):
        car.leaving = -1
    return np.arctan(-car.offset0 * 30.0 * u * u * (1.0 - u) ** 2 / car.span)

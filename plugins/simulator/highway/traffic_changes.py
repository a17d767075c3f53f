"""Changing lanes: highway-env's MOBIL, to get to the lane that the way asks for and to pass slower vehicles."""

from __future__ import annotations

import numpy as np

from me3bev_plugins.simulator.highway.compiled import kernel
from me3bev_plugins.simulator.highway.traffic_board import SLOW, put_entry, queue_beyond
from me3bev_plugins.simulator.highway.traffic_drive import FIRM, follow, free_road
from me3bev_plugins.simulator.highway.traffic_records import TRAIL, Record
from me3bev_plugins.simulator.highway.traffic_routes import CHANGE, time_into
from me3bev_plugins.simulator.highway.traffic_state import Board, Fleet, draw, extend, sample_at, speed_at, time_left
from me3bev_plugins.simulator.highway.traffic_tables import Roads

DURATION, LENGTHS = 3.0, 3.5
"""A change takes as many metres as are driven in these seconds, and no fewer than so many lengths of the vehicle."""
SLOWEST = 2.0
"""Nobody changes lanes more slowly, m/s."""
NEAR_END = 200.0
"""Within this distance of the end of its lane a vehicle keeps to, or changes to, the lane that its way asks for; before
it lanes only differ by who is on them, metres."""
ROOM = 2.0
"""Least distance to the bumpers of those before and behind, and to the stop line at the end, metres."""
UNSEEN = 60.0
"""How far behind the start of a lane those who come to it are looked for, metres."""
PASSING = 1.5
"""Who is farther than this from a lane's centre with its whole body is no longer in the way there, metres."""
FREE, WANTED, BARRED = 0, 1, 2


@kernel
def change_lanes(roads: Roads, fleet: Fleet, board: Board, dt: float) -> None:
    """Let every vehicle whose timer has run out think of another lane. The board must be up to date."""
    for i in range(len(fleet.cars) - 1):
        car = fleet.cars[i]
        car.timer -= dt
        if car.timer > 0.0:
            continue
        car.timer += roads.mobil[3]
        car.ease = 0
        lane = roads.lanes[fleet.path[i, 0]]
        if (lane.left < 0 and lane.right < 0) or car.change > 0.0 or car.clear > 0 or car.speed < SLOWEST:
            continue
        to_left = draw(car) < 0.5
        for attempt in range(2):
            target = lane.left if to_left == (attempt == 0) else lane.right
            if target >= 0 and _try(roads, fleet, board, i, target):
                break


@kernel
def _try(roads: Roads, fleet: Fleet, board: Board, i: int, target: int) -> bool:
    car, path = fleet.cars[i], fleet.path[i]
    lane, goal = roads.lanes[path[0]], roads.lanes[target]
    span = change_span(car)
    half = 0.5 * car.length
    if not (goal.admits & car.admits) or goal.junction >= 0 or car.s + span + half + ROOM > min(lane.stop, lane.length):
        return False
    s, lateral = project(roads, target, car.x, car.y, car.s * goal.length / lane.length)
    if s < max(half, goal.clear) or s + span + half + ROOM > min(goal.stop, goal.length) or abs(lateral) > 5.0:
        return False
    advice = _by_route(roads, board, car, path[0], target, s, lane.length - car.s)
    if advice == BARRED:
        return False
    if not _by_others(roads, fleet, board, i, target, s, advice == WANTED, lane.length - car.s):
        car.ease = int(advice == WANTED)
        return False
    car.leaving, car.shift = path[0], car.s - s
    car.s, car.offset, car.offset0 = s, lateral, lateral
    car.change = car.span = span
    path[0] = target
    car.count = 1
    for k in range(TRAIL):
        fleet.trail[i, k] = -1
    extend(roads, board.queues, car, path)
    put_entry(board, target, i, s, half, car.speed)  # The next one to think of this lane sees it.
    return True


@kernel
def _by_route(roads: Roads, board: Board, car: Record, lane: int, target: int, s: float, metres: float) -> int:
    """Whether a vehicle's way asks for a change (WANTED), forbids it (BARRED) or does not care (FREE)."""
    if car.goal < 0:
        return FREE
    if metres > NEAR_END:
        return FREE if time_left(roads, car, target) < np.inf else BARRED
    to_left = roads.lanes[lane].left == target
    here, there = _cost(roads, board, car, lane, car.s, not to_left), _cost(roads, board, car, target, s, to_left)
    if here - there > 0.99 * CHANGE:
        return WANTED
    return FREE if there - here < 0.5 * CHANGE else BARRED


@kernel
def _cost(roads: Roads, board: Board, car: Record, lane: int, s: float, to_left: bool) -> float:
    """Seconds to the destination over a lane, or the ones beyond it on one side, with the queues on them."""
    if time_left(roads, car, lane) == 0.0:
        return 0.0
    least, changes = np.inf, 0.0
    while lane >= 0 and changes < 6.0 * CHANGE:
        record = roads.lanes[lane]
        for k in range(record.follow0, record.follow1):
            following = roads.follow[k]
            left = time_left(roads, car, following) + time_into(roads.lanes[following])
            if changes + left < least:
                least = min(least, changes + left + queue_beyond(board, lane, s))
        changes += CHANGE
        lane = record.left if to_left else record.right
    return least


@kernel
def _by_others(
    roads: Roads, fleet: Fleet, board: Board, i: int, lane: int, s: float, wanted: bool, metres: float
) -> bool:
    """MOBIL: nobody must brake hard for the change and, unless the way asks for it, it brings more than it costs.

    As in highway-env, `IDMVehicle.mobil`; vehicles that are still to come to the lane count as followers too. A change
    that the way asks for may cost more braking the nearer the end of the lane is, which lies `metres` ahead.
    """
    car = fleet.cars[i]
    here = fleet.path[i, 0]
    most = -roads.mobil[2]
    if wanted:
        most -= max(0.0, FIRM + most) * (1.0 - metres / NEAR_END)
    leader, follower = _neighbours(board, lane, s, i)
    ahead, behind = _neighbours(board, here, car.s, i)
    if not (_leaves_room(board, car, s, leader) and _leaves_room(board, car, car.s, ahead)):
        return False
    then = _behind(roads, board, car, lane, s, leader)
    if then < most or not _is_clear(board, car, s, leader) or not _is_clear(board, car, s, follower):
        return False
    cost = 0.0
    if follower >= 0:
        entry = board.entries[follower]
        pressed = _pressed(roads, car, s, fleet.cars[entry.vehicle], lane, entry.s, entry.half, entry.speed)
        if pressed < most:
            return False
        cost = _behind(roads, board, fleet.cars[entry.vehicle], lane, entry.s, leader) - pressed
    elif not _comers_agree(roads, fleet, board, car, lane, s, i, most):
        return False
    if wanted:
        return True
    if behind >= 0:
        entry = board.entries[behind]
        other = fleet.cars[entry.vehicle]
        cost += _pressed(roads, car, car.s, other, here, entry.s, entry.half, entry.speed)
        cost -= _behind(roads, board, other, here, entry.s, ahead)
    now = _behind(roads, board, car, here, car.s, ahead)
    return then - now - roads.mobil[0] * cost >= roads.mobil[1]


@kernel
def _neighbours(board: Board, lane: int, s: float, i: int) -> tuple[int, int]:
    """(entry before, entry behind) of arc length `s` on a lane, -1 for none."""
    ahead, behind = np.inf, -np.inf
    leader = follower = -1
    k = board.heads[lane]
    while k >= 0:
        entry = board.entries[k]
        if entry.vehicle != i:
            if entry.s >= s and entry.s < ahead:
                ahead, leader = entry.s, k
            elif entry.s < s and entry.s > behind:
                behind, follower = entry.s, k
        k = entry.next
    return leader, follower


@kernel
def _is_clear(board: Board, car: Record, s: float, k: int) -> bool:
    """Whether an entry leaves room for the vehicle beside it."""
    return k < 0 or abs(board.entries[k].s - s) > 0.5 * car.length + board.entries[k].half + ROOM


@kernel
def _leaves_room(board: Board, car: Record, s: float, k: int) -> bool:
    """Whether the one ahead is no queue that would stop the vehicle across two lanes."""
    if k < 0 or board.entries[k].speed > SLOW:
        return True
    return board.entries[k].s - s - 0.5 * car.length - board.entries[k].half - ROOM > change_span(car)


@kernel
def change_span(car: Record) -> float:
    """How many metres a change of lanes takes now."""
    return max(DURATION * car.speed, LENGTHS * car.length)


@kernel
def _behind(roads: Roads, board: Board, car: Record, lane: int, s: float, leader: int) -> float:
    """IDM acceleration of a vehicle at arc length `s` of a lane behind an entry, or on a free road, m/s^2."""
    free = free_road(roads.idm, car.speed, speed_at(roads, lane, s) * car.eager)
    if leader < 0:
        return free
    entry = board.entries[leader]
    return follow(roads.idm, free, car.speed, entry.speed, entry.s - s, 0.5 * car.length + entry.half)


@kernel
def _pressed(
    roads: Roads, car: Record, s: float, other: Record, lane: int, at: float, half: float, speed: float
) -> float:
    """IDM acceleration of another one, at arc length `at` of a lane, behind the vehicle at `s`, m/s^2."""
    speed = max(speed, 0.0)
    free = free_road(roads.idm, speed, speed_at(roads, lane, max(at, 0.0)) * other.eager)
    return follow(roads.idm, free, speed, car.speed, s - at, 0.5 * car.length + half)


@kernel
def _comers_agree(
    roads: Roads, fleet: Fleet, board: Board, car: Record, lane: int, s: float, i: int, most: float
) -> bool:
    """Whether nobody who is still to come to a lane would have to brake hard for the vehicle at `s`."""
    record = roads.lanes[lane]
    for n in range(record.before0, record.before1):
        before = roads.before[n]
        if not _agree(roads, fleet, board, car, before, -roads.lanes[before].length, s, i, most):
            return False
        second = roads.lanes[before]
        if s + second.length > UNSEEN:
            continue
        for m in range(second.before0, second.before1):
            base = -second.length - roads.lanes[roads.before[m]].length
            if not _agree(roads, fleet, board, car, roads.before[m], base, s, i, most):
                return False
    return True


@kernel
def _agree(
    roads: Roads,
    fleet: Fleet,
    board: Board,
    car: Record,
    lane: int,
    base: float,
    s: float,
    i: int,
    most: float,
) -> bool:
    """Whether nobody on a lane that begins at `base` would have to brake hard for the vehicle at `s`."""
    k = board.heads[lane]
    while k >= 0:
        entry = board.entries[k]
        k = entry.next
        if entry.vehicle == i or s - base - entry.s > UNSEEN:
            continue
        gap = s - base - entry.s - 0.5 * car.length - entry.half
        if gap < ROOM:
            return False
        at = base + entry.s
        if _pressed(roads, car, s, fleet.cars[entry.vehicle], lane, at, entry.half, entry.speed) < most:
            return False
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
    angle = np.arctan(-car.offset0 * 30.0 * u * u * (1.0 - u) ** 2 / car.span)
    if abs(car.offset) + 0.5 * (car.width + car.length * abs(np.sin(angle))) < abs(car.offset0) - PASSING:
        car.leaving = -1
    return angle

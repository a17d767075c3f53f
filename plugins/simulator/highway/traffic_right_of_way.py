"""Who may enter a junction: every gate is granted to one vehicle after another.

A vehicle near a gate is granted it when its light and sign allow it, nobody else has, or is sooner to claim, a path
that meets its own, and there is room for it beyond. The order is: those between two gates so near that they stand in
the way, those who have waited long, then by rank (main road before minor, straight on before turning across), then
by arrival, then by index; so somebody is always first and nobody waits for ever.
"""

from __future__ import annotations

from me3bev_plugins.simulator.highway.compiled import kernel
from me3bev_plugins.simulator.highway.scene import Light
from me3bev_plugins.simulator.highway.town import Ints
from me3bev_plugins.simulator.highway.traffic_board import BERTH, put_user
from me3bev_plugins.simulator.highway.traffic_claims import conflicts
from me3bev_plugins.simulator.highway.traffic_drive import decision_distance
from me3bev_plugins.simulator.highway.traffic_records import STOP, Record
from me3bev_plugins.simulator.highway.traffic_room import chain_end, has_room, is_between
from me3bev_plugins.simulator.highway.traffic_state import Board, Fleet, choose_next
from me3bev_plugins.simulator.highway.traffic_tables import Roads

PATIENCE = 10.0
"""After this a waiting vehicle goes before all others, seconds."""
STARVED = 30.0
"""After this a waiting vehicle keeps the room beyond the junction that shorter ones would fill, seconds."""
DETOUR = 6.0
"""After this without room beyond the junction another way is taken, seconds."""
LAPSE = 5.0
"""A vehicle that stands before its gate for so long loses the grant, seconds."""
NEAR = 12.0
"""Who is nearer than this to where it must stop can be said to wait there, metres."""
EGO_CLAIM = 15.0
"""Within this distance the ego claims its gate, metres."""
STOPPABLE = 3.5
"""An amber light is obeyed if this deceleration is enough, m/s^2."""
_RED, _AMBER = int(Light.RED), int(Light.AMBER)

GRANTED, CONFLICT, NO_ROOM, BARRED = 0, 1, 2, 3


@kernel
def grant_gates(roads: Roads, fleet: Fleet, board: Board, time: float, dt: float) -> None:
    """Take grants back where they no longer hold, then grant gates in order; `write_users` must have run."""
    count = len(fleet.cars)
    order, queue = board.order, board.queue
    waiting = 0
    for i in range(count):
        car, path = fleet.cars[i], fleet.path[i]
        gate, line = next_gate(roads, car, path)
        if gate < 0:
            car.gate = -1
            continue
        reach = decision_distance(car.speed)
        if i == count - 1:
            reach = max(reach, EGO_CLAIM)
        before = roads.lanes[path[gate - 1]]
        if line - (before.length - before.stop) > reach:
            continue
        _note_arrival(roads, car, path, gate, line, time, dt)
        rank = float(roads.lanes[path[gate]].rank)
        if is_between(roads, car, path, fleet.trail[i], gate):
            rank = -2.0
        elif car.wait > PATIENCE:
            rank = -1.0
        # Insertion keeps the candidates ordered by (rank, arrival, index).
        at = waiting
        while at > 0 and (
            queue[order[at - 1], 0] > rank
            or (queue[order[at - 1], 0] == rank and queue[order[at - 1], 1] > car.arrival)
        ):
            order[at] = order[at - 1]
            at -= 1
        order[at] = i
        queue[i, 0], queue[i, 1], queue[i, 2], queue[i, 3] = rank, car.arrival, gate, line
        waiting += 1
    for n in range(waiting):
        i = order[n]
        _consider(roads, fleet, board, i, int(queue[i, 2]), queue[i, 3], dt)


@kernel
def next_gate(roads: Roads, car: Record, path: Ints) -> tuple[int, float]:
    """(place in the path of the first gate not granted or -1, metres from the front to the end of the lane before)."""
    start = -car.s
    for k in range(1, car.count):
        start += roads.lanes[path[k - 1]].length
        if k > car.clear and roads.lanes[path[k]].gate:
            return k, start - 0.5 * car.length
    return -1, 0.0


@kernel
def revoke(roads: Roads, fleet: Fleet, board: Board, time: float) -> None:
    """Take back grants of vehicles still before the line: the light has changed, or they have stood too long."""
    for i in range(len(fleet.cars)):
        car, path = fleet.cars[i], fleet.path[i]
        if car.clear == 0:
            continue
        start = -car.s
        k = 1
        while k <= car.clear:
            start += roads.lanes[path[k - 1]].length
            if roads.lanes[path[k]].gate:
                break
            k += 1
        if k > car.clear:
            continue
        line = start - 0.5 * car.length
        if line <= 0.0 or roads.lanes[path[0]].gate:
            continue
        clears = i < len(fleet.cars) - 1 and roads.lanes[path[k]].rank > 0
        if not (_light_allows(roads, board, car, path[k - 1], line, clears) or _is_committed(car, line)):
            car.clear = 0
        elif car.still > LAPSE:
            car.clear = 0
            car.arrival, car.wait, car.still = time, min(car.wait, PATIENCE - 2.0), 0.0  # Others first.


@kernel
def _is_committed(car: Record, line: float) -> bool:
    """Whether a vehicle is too fast to stop at a line that lies `line` metres before it.

    Who was slowed down on its way through at amber goes on at red: half braked it would end up in the junction.
    """
    return car.speed**2 > 2.0 * STOPPABLE * max(line - 0.5, 0.01)


@kernel
def _light_allows(roads: Roads, board: Board, car: Record, lane: int, line: float, clears: bool) -> bool:
    """Whether the light at the end of a lane lets a vehicle on, `line` metres before it.

    Args:
        clears: who has waited at the line to turn across the others may do so when amber has stopped them.
    """
    before = roads.lanes[lane]
    if before.signal < 0:
        return True
    state = board.lights[before.signal]
    if state == _RED:
        return line < 0.0
    if state != _AMBER or _is_committed(car, line):
        return True
    return clears and car.wait > 3.0 and line - (before.length - before.stop) < 3.0


@kernel
def _note_arrival(roads: Roads, car: Record, path: Ints, gate: int, line: float, time: float, dt: float) -> None:
    if car.gate != path[gate]:
        car.gate, car.arrival, car.wait, car.jam = path[gate], time, 0.0, 0.0
    before = roads.lanes[path[gate - 1]]
    stop = line - (before.length - before.stop)
    if car.speed < 0.5 and stop < NEAR:
        car.wait += dt
    if before.sign == STOP and car.speed < 0.3 and stop < 3.0:
        car.halted = path[gate - 1]


@kernel
def _consider(roads: Roads, fleet: Fleet, board: Board, i: int, gate: int, line: float, dt: float) -> None:
    """Grant vehicle `i` its gate, or let it claim the path if only others are in its way."""
    car, path = fleet.cars[i], fleet.path[i]
    between = is_between(roads, car, path, fleet.trail[i], gate)
    last = chain_end(roads, car, path, gate, between)
    verdict = _judge(roads, fleet, board, i, gate, last, line, between)
    if verdict == GRANTED:
        car.clear = last
        car.jam = car.still = 0.0
        start = -car.s
        for k in range(last + 1):
            if k >= gate and roads.lanes[path[k]].gate:
                put_user(board, path[k], i, -start, car, 0)
            start += roads.lanes[path[k]].length
        if last + 1 < car.count:
            board.bound[path[last + 1]] += car.length + BERTH
        return
    before = roads.lanes[path[gate - 1]]
    if verdict == CONFLICT and line - (before.length - before.stop) < NEAR:
        start = -car.s
        for k in range(last + 1):
            if k >= gate and roads.lanes[path[k]].gate:
                put_user(board, path[k], i, -start, car, 1)
            start += roads.lanes[path[k]].length
    if verdict == NO_ROOM and car.speed < 0.5:
        if car.wait > STARVED and last + 1 < car.count:
            board.bound[path[last + 1]] += car.length + BERTH
        car.jam += dt
        if car.jam > DETOUR and i < len(fleet.cars) - 1:
            _take_detour(roads, board, car, path, gate)


@kernel
def _take_detour(roads: Roads, board: Board, car: Record, path: Ints, gate: int) -> None:
    other = choose_next(roads, board.queues, car, path[gate - 1], path[gate])
    car.jam = 0.0
    if other >= 0 and other != path[gate]:
        path[gate] = other
        car.count = gate + 1


@kernel
def _judge(roads: Roads, fleet: Fleet, board: Board, i: int, gate: int, last: int, line: float, between: bool) -> int:
    car, path = fleet.cars[i], fleet.path[i]
    # One between two gates heeds no claims: the claimant may be waiting for it to get out of the way.
    if not _leader_is_through(roads, fleet, board, i, gate):
        return BARRED
    before = roads.lanes[path[gate - 1]]
    if before.sign == STOP and car.halted != path[gate - 1]:
        return BARRED
    start = -car.s
    clash = False
    for k in range(last + 1):
        lane = roads.lanes[path[k]]
        if k >= gate and lane.gate:
            clears = i < len(fleet.cars) - 1 and lane.rank > 0
            if not _light_allows(roads, board, car, path[k - 1], line, clears):
                return BARRED
            clash = clash or conflicts(roads, board, car, i, path[k], start, not between)
        start += lane.length
    if not has_room(roads, fleet, board, i, gate, last):
        return NO_ROOM
    return CONFLICT if clash else GRANTED


@kernel
def _leader_is_through(roads: Roads, fleet: Fleet, board: Board, i: int, gate: int) -> bool:
    """Whether nobody is between vehicle `i` and its gate who has not been granted one."""
    car, path = fleet.cars[i], fleet.path[i]
    start = -car.s
    for k in range(gate):
        n = board.heads[path[k]]
        while n >= 0:
            entry = board.entries[n]
            n = entry.next
            if entry.vehicle == i or start + entry.s <= 0.0 or entry.s > roads.lanes[path[k]].length:
                continue
            other = fleet.cars[entry.vehicle]
            if other.clear == 0 and not roads.lanes[fleet.path[entry.vehicle, 0]].gate:
                return False
        start += roads.lanes[path[k]].length
    return True

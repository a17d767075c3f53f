"""One step of the pedestrians: along their strips, up to a crossing, over the road when it is safe."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from me3bev_plugins.simulator.highway.compiled import kernel
from me3bev_plugins.simulator.highway.pedestrian_tables import Walks
from me3bev_plugins.simulator.highway.scene import Light
from me3bev_plugins.simulator.highway.traffic_records import Record, Records
from me3bev_plugins.simulator.highway.traffic_state import Board, Fleet, draw
from me3bev_plugins.simulator.highway.traffic_tables import Roads

STROLL, APPROACH, WAIT, CROSS = 0, 1, 2, 3
"""Modes of a pedestrian."""
TEMPTED, AT_CORNER, BOLD = 0.45, 0.15, 0.02
"""Share of those passing a crosswalk, the corner of a junction without one, or another place to cross, who do."""
GLANCES = 5
"""Who waits where there is no crosswalk looks round in every so many steps."""
ASKS = 1.0
"""Who waits longer at a crosswalk without a light makes the traffic stop, seconds."""
GIVES_UP = 25.0
"""Who has waited longer walks on, seconds."""
TURNS_BACK = 4.0
"""Who cannot go on in the middle of the road for so long goes back, seconds."""
BODY, STRIDE = 0.3, 0.8
"""Half of the room a pedestrian needs, and how far ahead it must be free: the tails of turning vehicles swing out,
metres."""
FORESEEN = 1.5
"""Nobody steps before a vehicle that would be there sooner, seconds."""
STEP_AHEAD = 2.2
"""Vehicles brake for somebody this far, or nearer, beside their lane, metres."""
PASSED = 2.2
"""Farther than this from a lane's centre nobody is in the way there, metres."""
COMING = 9.0
"""Vehicles that need not brake hard let pass who is this near to their lane and walks towards it, metres."""
LEVEL = 2.5
"""Difference of height beyond which nothing meets, metres."""
EASY, FRIGHT, FASTER, CLEAR = 2.0, 1.0, 1.5, 3.0
"""Where there is no crosswalk nobody sets out before a vehicle that would have to brake harder than this, m/s^2, if it
noticed so many seconds later and were so much faster by then, m/s, or that is nearer than the road's width and this,
metres."""
_RED = int(Light.RED)


@kernel
def step_people(roads: Roads, walks: Walks, people: Records, fleet: Fleet, board: Board, dt: float) -> None:
    """Move everybody by one step, after the vehicles; `board.hot` and `board.lights` must be up to date."""
    board.asked[:] = 0
    for i in range(len(people)):
        person = people[i]
        if person.mode == STROLL:
            _stroll(walks, person, dt)
        elif person.mode == CROSS:
            _cross(walks, person, fleet, dt)
        else:
            _wait(walks, person, fleet, board, dt)
    mark_walkers(roads, walks, people, board)


@kernel
def mark_walkers(roads: Roads, walks: Walks, people: Records, board: Board) -> None:
    """Tell the traffic which lanes have somebody on them, or about to step on them."""
    board.walkers[:] = 0.0
    for i in range(len(people)):
        person = people[i]
        if person.mode != CROSS:
            continue
        crossing = walks.crossings[person.crossing]
        for n in range(crossing.met0, crossing.met1):
            k = walks.met[n]
            link = roads.links[k]
            ahead = (link.along - person.along) * person.way
            if -PASSED < ahead < PASSED + STEP_AHEAD:
                board.walkers[k] = 1.0
            elif 0.0 < ahead < COMING:
                board.walkers[k] = max(board.walkers[k], 0.5)


@kernel
def stand(walks: Walks, person: Record) -> tuple[float, float, float, float]:
    """(x, y, z, heading along the strip) of where somebody on a strip should be."""
    strip = walks.strips[person.strip]
    u = person.s / strip.step
    k = min(max(int(u), 0), strip.count - 2)
    t = u - k
    a, b = walks.footings[strip.first + k], walks.footings[strip.first + k + 1]
    aside = max(-a.free, min(a.free, person.aside))
    x, y = a.x + t * (b.x - a.x), a.y + t * (b.y - a.y)
    return x - aside * np.sin(a.heading), y + aside * np.cos(a.heading), a.z + t * (b.z - a.z), a.heading


@kernel
def _step_to(person: Record, x: float, y: float, z: float, dt: float) -> bool:
    """Walk straight towards a point; whether it was reached."""
    dx, dy = x - person.x, y - person.y
    away = np.sqrt(dx * dx + dy * dy)
    reach = 1.3 * person.pace * dt
    if away > 1e-6:
        share = min(1.0, reach / away)
        person.x += share * dx
        person.y += share * dy
        person.z += share * (z - person.z)
        person.speed = share * away / dt
        if share * away > 0.01:
            person.heading = np.arctan2(dy, dx)
    else:
        person.speed = 0.0
    return away <= reach


@kernel
def _stroll(walks: Walks, person: Record, dt: float) -> None:
    x, y, z, _ = stand(walks, person)
    near = (x - person.x) ** 2 + (y - person.y) ** 2 < 1.0
    if near:  # Otherwise it is still on its way over from another strip.
        strip = walks.strips[person.strip]
        before = person.s
        person.s += person.way * person.pace * dt
        low, high = min(before, person.s), max(before, person.s)
        for n in range(strip.exit0, strip.exit1):
            leave = walks.exits[n]
            if low < leave.s <= high and draw(person) < _temptation(walks.crossings[leave.crossing]):
                person.crossing, person.mode, person.wait = leave.crossing, APPROACH, 0.0
                crossing = walks.crossings[leave.crossing]
                person.way = 1 if leave.side == 0 else -1
                person.along = 0.0 if leave.side == 0 else crossing.length
                person.s = leave.s
                return
        if person.s < 0.0 or person.s > strip.length:
            _go_on(walks, person)
        x, y, z, _ = stand(walks, person)
    _step_to(person, x, y, z, dt)


@kernel
def _temptation(crossing: Record) -> float:
    if crossing.marked:
        return TEMPTED
    return AT_CORNER if crossing.corner else BOLD


@kernel
def _go_on(walks: Walks, person: Record) -> None:
    """At the end of a strip: on to the next one, or back."""
    strip = walks.strips[person.strip]
    at_start = person.s < 0.0
    following = strip.before if at_start else strip.after
    if following < 0:
        person.s = 0.0 if at_start else strip.length
        person.way = 1 if at_start else -1
        return
    person.s = strip.before_s if at_start else strip.after_s
    person.strip = following
    length = walks.strips[following].length
    if person.s < 3.0:
        person.way = 1
    elif person.s > length - 3.0:
        person.way = -1
    else:
        person.way = 1 if draw(person) < 0.5 else -1


@kernel
def _spot(walks: Walks, person: Record, along: float) -> tuple[float, float, float]:
    """(x, y, z) on a crossing: abreast in its middle, in file at its ends, where turning vehicles pass close."""
    c = walks.crossings[person.crossing]
    t = along / c.length
    ux, uy = (c.x1 - c.x0) / c.length, (c.y1 - c.y0) / c.length
    room = min(1.0, 0.2 + 0.3 * max(0.0, min(along, c.length - along)))
    aside = max(-room, min(room, person.aside))
    return c.x0 + ux * along - aside * uy, c.y0 + uy * along + aside * ux, c.z0 + t * (c.z1 - c.z0)


@kernel
def _wait(walks: Walks, person: Record, fleet: Fleet, board: Board, dt: float) -> None:
    """Walk up to the kerb, wait there, and set out when the traffic allows it."""
    x, y, z = _spot(walks, person, person.along)
    if person.mode == APPROACH:
        if _step_to(person, x, y, z, dt):
            person.mode = WAIT
        return
    person.speed = 0.0
    person.wait += dt
    crossing = walks.crossings[person.crossing]
    person.heading = np.arctan2(crossing.y1 - crossing.y0, crossing.x1 - crossing.x0)
    if person.way < 0:
        person.heading += np.pi
    governed = crossing.signal1 > crossing.signal0
    for n in range(crossing.signal0, crossing.signal1):
        if board.lights[walks.signals[n]] != _RED:
            if person.wait > 2.0 * GIVES_UP:
                _leave(walks, person)
            return
    looks = crossing.marked or int(person.wait / dt + 0.5) % GLANCES == 1
    safe = looks and not board.hot[person.crossing] and (crossing.marked or _is_lonely(crossing, fleet))
    if safe:
        person.mode, person.wait = CROSS, 0.0
    elif person.wait > GIVES_UP:
        _leave(walks, person)
    elif crossing.marked and not governed and person.wait > ASKS:
        board.asked[person.crossing] = 1


@kernel
def _is_lonely(crossing: Record, fleet: Fleet) -> bool:
    """Whether every vehicle that comes nearer, wherever bound, could stop without haste after a moment of fright."""
    x, y = 0.5 * (crossing.x0 + crossing.x1), 0.5 * (crossing.y0 + crossing.y1)
    for i in range(len(fleet.cars)):
        car = fleet.cars[i]
        speed = car.speed + FASTER
        near = 0.5 * (crossing.length + car.length) + CLEAR
        reach = near + speed * FRIGHT + speed * speed / (2.0 * EASY)
        dx, dy = x - car.x, y - car.y
        away = dx * dx + dy * dy
        if abs(car.z - crossing.z0) > LEVEL or away > reach * reach:
            continue
        if away < near * near or dx * np.cos(car.heading) + dy * np.sin(car.heading) > 0.0:
            return False
    return True


@kernel
def _leave(walks: Walks, person: Record) -> None:
    """Turn from the kerb, or arrive at it, and walk on along the strip there."""
    crossing = walks.crossings[person.crossing]
    first = person.along < 0.5 * crossing.length
    person.strip = crossing.strip0 if first else crossing.strip1
    person.s = crossing.s0 if first else crossing.s1
    person.way = 1 if draw(person) < 0.5 else -1
    person.mode, person.wait = STROLL, 0.0


@kernel
def _cross(walks: Walks, person: Record, fleet: Fleet, dt: float) -> None:
    crossing = walks.crossings[person.crossing]
    along = person.along + person.way * person.pace * dt
    x, y, z = _spot(walks, person, along)
    ux, uy = (x - person.x), (y - person.y)
    size = max(np.sqrt(ux * ux + uy * uy), 1e-6)
    if _is_obstructed(person, ux / size, uy / size, fleet):
        person.speed = 0.0
        person.wait += dt
        if person.wait > TURNS_BACK and 0.0 < person.along < crossing.length:
            person.way, person.wait = -person.way, 0.0
        return
    person.wait = 0.0
    person.along = along
    person.x, person.y, person.z, person.speed = x, y, z, person.pace
    person.heading = np.arctan2(uy, ux)
    if along <= 0.0 or along >= crossing.length:
        _leave(walks, person)


@kernel
def _is_obstructed(person: Record, ux: float, uy: float, fleet: Fleet) -> bool:
    """Whether the next stride is taken by a vehicle, or one would be there in a moment."""
    for i in range(len(fleet.cars)):
        car = fleet.cars[i]
        dx, dy = person.x - car.x, person.y - car.y
        if dx * dx + dy * dy > 1600.0 or abs(person.z - car.z) > LEVEL:
            continue
        c, s = np.cos(car.heading), np.sin(car.heading)
        ahead, left = dx * c + dy * s, dy * c - dx * s
        away, sideways = ahead + STRIDE * (ux * c + uy * s), left + STRIDE * (uy * c - ux * s)
        length, width = 0.5 * car.length + BODY, 0.5 * car.width + BODY
        if abs(ahead) < length and abs(left) < width:  # It has come too near: only away from it.
            if max(abs(away) - length, abs(sideways) - width) < max(abs(ahead) - length, abs(left) - width):
                return True
            continue
        if abs(away) < length and abs(sideways) < width:
            return True
        gap = ahead - length
        coming = 0.0 < gap < FORESEEN * car.speed
        if coming and width < abs(left) < width + 1.2 and abs(sideways) < abs(left):
            return True
    return False


@kernel
def publish_people(people: Records, pose: NDArray, first: int) -> None:
    """Copy poses into the columns from `first` on of `pose` (5, A)."""
    for i in range(len(people)):
        person = people[i]
        pose[0, first + i], pose[1, first + i], pose[2, first + i] = person.x, person.y, person.z
        pose[3, first + i], pose[4, first + i] = person.heading, person.speed

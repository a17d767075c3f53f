"""The state of the world's traffic as arrays, and the small steps everything is made of: paths, draws, poses."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from me3bev_plugins.simulator.highway.compiled import kernel
from me3bev_plugins.simulator.highway.town import Floats, Ints
from me3bev_plugins.simulator.highway.traffic_records import ENTRY, PATH, TRAIL, USER, VEHICLE, Record, Records
from me3bev_plugins.simulator.highway.traffic_routes import class_of, time_into
from me3bev_plugins.simulator.highway.traffic_tables import Roads

HORIZON = 150.0
"""How far ahead a vehicle plans its way, metres."""
SEEN = 0.17
"""What counts of the queue on the road beyond a junction: part of it is gone by the time one gets there."""
NOT_NEAR = 30.0
"""Destinations are farther away than this when they are chosen, seconds."""


class Fleet(NamedTuple):
    """N vehicles and, last, the ego."""

    cars: Records
    """(N + 1,) `VEHICLE`"""
    path: Ints
    """(N + 1, PATH) lanes ahead, the current one first."""
    trail: Ints
    """(N + 1, TRAIL) lanes behind or -1, the latest first."""


class Board(NamedTuple):
    """Who is where, written anew every step: lists threaded through pools, one head per lane."""

    entries: Records
    """`ENTRY`s of the vehicles on each lane."""
    heads: Ints
    """(L,) first entry or -1."""
    users: Records
    """`USER`s of each connector."""
    user_heads: Ints
    """(L,) first user or -1."""
    bound: Floats
    """(L,) metres that granted vehicles will take up on the lane behind their junction."""
    used: Ints
    """(2,) entries and users in use."""
    lights: Ints
    """(S,) state of every signal."""
    walkers: Floats
    """(K,) per link: 1 when a pedestrian is, or is about to be, in the way of the lane there, 0.5 when one comes."""
    queues: Floats
    """(L,) what those who stand on each lane cost the next one, seconds."""
    asked: Ints
    """(C,) per crossing: 1 when somebody waits to cross."""
    hot: Ints
    """(C,) per crossing: 1 when a vehicle is on it or too near to stop before it."""
    near: Floats
    """(64, 3) scratch: lanes under the ego, with the nearest sample of each and its squared distance."""
    queue: Floats
    """(N + 1, 4) scratch: who is at a gate, by vehicle: rank, arrival, gate, distance to its line."""
    order: Ints
    """(N + 1,) scratch: the same vehicles in the order in which they are considered."""


def new_fleet(count: int) -> Fleet:
    """Room for `count` vehicles and the ego."""
    return Fleet(
        np.zeros(count + 1, VEHICLE),
        np.zeros((count + 1, PATH), np.int32),
        np.full((count + 1, TRAIL), -1, np.int32),
    )


def new_board(lanes: int, vehicles: int, signals: int, links: int, crossings: int) -> Board:
    """Empty lists for a town and a number of vehicles."""
    return Board(
        np.zeros((vehicles + 1) * 6 + 256, ENTRY),
        np.full(lanes, -1, np.int32),
        np.zeros((vehicles + 1) * 2 * PATH, USER),
        np.full(lanes, -1, np.int32),
        np.zeros(lanes),
        np.zeros(2, np.int32),
        np.zeros(signals, np.int32),
        np.zeros(links),
        np.zeros(lanes),
        np.zeros(crossings, np.int32),
        np.zeros(crossings, np.int32),
        np.zeros((64, 3)),
        np.zeros((vehicles + 1, 4)),
        np.zeros(vehicles + 1, np.int32),
    )


@kernel
def draw(record: Record) -> float:
    """The record's next random number in [0, 1) (splitmix64; the state is its field `rng`)."""
    record.rng = record.rng + np.uint64(0x9E3779B97F4A7C15)
    z = record.rng
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    z = z ^ (z >> np.uint64(31))
    return float(z >> np.uint64(11)) * (1.0 / 9007199254740992.0)


@kernel
def choose_next(roads: Roads, queues: Floats, car: Record, lane: int, barred: int) -> int:
    """The successor of `lane` that admits the vehicle and is nearest to its destination; -1 for none.

    The queue that can be seen on the road beyond counts in part.

    It is another one than `barred` if there is one. Without a destination, or where none leads there, the draw
    decides; turning back is then for where there is nothing else.
    """
    record = roads.lanes[lane]
    best, found = np.inf, -1
    if car.goal >= 0:
        for k in range(record.follow0, record.follow1):
            following = roads.follow[k]
            left = time_left(roads, car, following) + time_into(roads.lanes[following])
            if roads.lanes[following].junction >= 0 and roads.lanes[following].follow1 > roads.lanes[following].follow0:
                left += SEEN * queues[roads.follow[roads.lanes[following].follow0]]
            if following != barred and left < best:
                best, found = left, following
    if found >= 0:
        return found
    for attempt in range(4):
        count = 0
        for k in range(record.follow0, record.follow1):
            count += _suits(roads, car, roads.follow[k], barred, attempt)
        if count == 0:
            continue
        pick = int(draw(car) * count)
        for k in range(record.follow0, record.follow1):
            if _suits(roads, car, roads.follow[k], barred, attempt):
                if pick == 0:
                    return roads.follow[k]
                pick -= 1
    return -1


@kernel
def time_left(roads: Roads, car: Record, lane: int) -> float:
    """Seconds from the start of a lane to the vehicle's destination; infinite where it may not go."""
    return float(roads.times[class_of(car.admits), car.goal, lane])


@kernel
def choose_goal(roads: Roads, car: Record, lane: int) -> None:
    """Give the vehicle a destination that it can reach from a lane and that is not near, if there is one."""
    count = roads.times.shape[1]
    size = class_of(car.admits)
    for attempt in range(12):
        goal = int(draw(car) * count)
        left = roads.times[size, goal, lane]
        if left < np.inf and (left > NOT_NEAR or attempt > 5):
            car.goal = goal
            return
    car.goal = -1


@kernel
def _suits(roads: Roads, car: Record, lane: int, barred: int, attempt: int) -> bool:
    record = roads.lanes[lane]
    if attempt < 3 and not (record.admits & car.admits):
        return False
    if attempt < 2 and lane == barred:
        return False
    return attempt >= 1 or record.turn != 3


@kernel
def extend(roads: Roads, queues: Floats, car: Record, path: Ints) -> None:
    """Choose lanes until the way ahead is `HORIZON` long or fills the path."""
    length = -car.s
    for k in range(car.count):
        length += roads.lanes[path[k]].length
    while car.count < PATH and length < HORIZON:
        last = path[car.count - 1]
        if car.goal >= 0 and time_left(roads, car, last) == 0.0:
            choose_goal(roads, car, last)
        following = choose_next(roads, queues, car, last, -1)
        if following < 0:
            return
        path[car.count] = following
        car.count += 1
        length += roads.lanes[following].length


@kernel
def set_out(roads: Roads, queues: Floats, fleet: Fleet) -> None:
    """Give every vehicle but the ego a destination, the first lanes of its way there, and its pose."""
    for i in range(len(fleet.cars) - 1):
        car, path = fleet.cars[i], fleet.path[i]
        choose_goal(roads, car, path[0])
        extend(roads, queues, car, path)
        place(roads, car, path, fleet.trail[i])


@kernel
def advance(roads: Roads, queues: Floats, car: Record, path: Ints, trail: Ints, metres: float) -> None:
    """Move a vehicle along its path."""
    car.s += metres
    while car.s >= roads.lanes[path[0]].length and car.count > 1:
        car.s -= roads.lanes[path[0]].length
        for k in range(TRAIL - 1, 0, -1):
            trail[k] = trail[k - 1]
        trail[0] = path[0]
        for k in range(car.count - 1):
            path[k] = path[k + 1]
        car.count -= 1
        car.clear = max(0, car.clear - 1)
        car.leaving = -1
    if car.count == 1:
        car.s = min(car.s, roads.lanes[path[0]].length)
    extend(roads, queues, car, path)


@kernel
def sample_at(roads: Roads, lane: int, s: float) -> tuple[float, float, float, float]:
    """(x, y, z, heading) of a lane's centre; straight on beyond its ends."""
    record = roads.lanes[lane]
    u = s / record.step
    i = min(max(int(u), 0), record.count - 2)
    t = u - i
    a, b = roads.samples[record.first + i], roads.samples[record.first + i + 1]
    return a.x + t * (b.x - a.x), a.y + t * (b.y - a.y), a.z + t * (b.z - a.z), a.heading + t * (b.heading - a.heading)


@kernel
def speed_at(roads: Roads, lane: int, s: float) -> float:
    """Permitted speed on a lane, m/s."""
    record = roads.lanes[lane]
    i = min(max(int(s / record.step + 0.5), 0), record.count - 1)
    return roads.samples[record.first + i].speed


@kernel
def _along(roads: Roads, car: Record, path: Ints, trail: Ints, s: float) -> tuple[float, float, float]:
    """(x, y, z) on a vehicle's way at arc length `s` of its lane, which may lie on lanes ahead or behind."""
    if s < 0.0:
        for k in range(TRAIL):
            if trail[k] < 0:
                return sample_at(roads, path[0] if k == 0 else trail[k - 1], s)[:3]
            s += roads.lanes[trail[k]].length
            if s >= 0.0:
                return sample_at(roads, trail[k], s)[:3]
        return sample_at(roads, trail[TRAIL - 1], s)[:3]
    k = 0
    while s > roads.lanes[path[k]].length and k + 1 < car.count:
        s -= roads.lanes[path[k]].length
        k += 1
    return sample_at(roads, path[k], s)[:3]


@kernel
def place(roads: Roads, car: Record, path: Ints, trail: Ints) -> None:
    """Pose of a vehicle: both axles on its way, moved sideways while it changes lanes."""
    axle = 0.3 * car.length
    fx, fy, fz = _along(roads, car, path, trail, car.s + axle)
    rx, ry, rz = _along(roads, car, path, trail, car.s - axle)
    car.heading = np.arctan2(fy - ry, fx - rx)
    car.x, car.y, car.z = 0.5 * (fx + rx), 0.5 * (fy + ry), 0.5 * (fz + rz)
    if car.offset != 0.0:
        car.x -= car.offset * np.sin(car.heading)
        car.y += car.offset * np.cos(car.heading)

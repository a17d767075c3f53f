"""Writing the board: which vehicles are on which lanes, the ego's footprint, who may use which connector."""

from __future__ import annotations

import numpy as np

from me3bev_plugins.simulator.highway.compiled import kernel
from me3bev_plugins.simulator.highway.town import Ints
from me3bev_plugins.simulator.highway.traffic_grid import Grid, cell_range
from me3bev_plugins.simulator.highway.traffic_records import TRAIL, Record
from me3bev_plugins.simulator.highway.traffic_state import Board, Fleet
from me3bev_plugins.simulator.highway.traffic_tables import Roads

CORRIDOR = 1.1
"""Half of the width beside a lane's centre that the ego must leave free to be no obstacle there, metres."""
LEVEL = 2.5
"""Difference of height beyond which nothing meets, metres."""
SLOW, QUEUE = 2.0, 12.0
"""Those who drive more slowly than this, m/s, are a queue; what each of them costs the next one, seconds."""
BERTH = 6.5
"""What a vehicle takes up in a queue beside its own length, metres."""


@kernel
def put_entry(board: Board, lane: int, vehicle: int, s: float, half: float, speed: float) -> None:
    """Add a vehicle to a lane's list (nothing happens when the pool is full)."""
    k = board.used[0]
    if k >= len(board.entries):
        return
    entry = board.entries[k]
    entry.s, entry.half, entry.speed, entry.vehicle, entry.next = s, half, speed, vehicle, board.heads[lane]
    board.heads[lane] = k
    board.used[0] = k + 1


@kernel
def put_user(board: Board, lane: int, vehicle: int, s: float, car: Record, claim: int) -> None:
    """Add a user, or a claimant, of a connector."""
    k = board.used[1]
    if k >= len(board.users):
        return
    user = board.users[k]
    user.s, user.half, user.speed = s, 0.5 * car.length, car.speed
    user.vehicle, user.claim, user.meek, user.next = vehicle, claim, car.meek, board.user_heads[lane]
    board.user_heads[lane] = k
    board.used[1] = k + 1


@kernel
def write_entries(roads: Roads, grid: Grid, fleet: Fleet, board: Board) -> None:
    """Lists of the vehicles on every lane, also where only a nose, a tail or a vehicle changing lanes is there."""
    board.heads[:] = -1
    board.used[0] = 0
    board.queues[:] = 0.0
    for i in range(len(fleet.cars) - 1):
        car, path, trail = fleet.cars[i], fleet.path[i], fleet.trail[i]
        half = 0.5 * car.length
        put_entry(board, path[0], i, car.s, half, car.speed)
        if car.speed < SLOW:
            board.queues[path[0]] += QUEUE
        base = 0.0
        for k in range(TRAIL):
            if car.s + base >= half or trail[k] < 0:
                break
            base += roads.lanes[trail[k]].length
            put_entry(board, trail[k], i, car.s + base, half, car.speed)
        base = roads.lanes[path[0]].length
        k = 1
        while k < car.count and car.s + half > base:
            put_entry(board, path[k], i, car.s - base, half, car.speed)
            base += roads.lanes[path[k]].length
            k += 1
        if car.leaving >= 0:
            put_entry(board, car.leaving, i, car.s + car.shift, half, car.speed)
    _write_footprint(roads, grid, fleet.cars[len(fleet.cars) - 1], len(fleet.cars) - 1, board)


@kernel
def queue_beyond(board: Board, lane: int, s: float) -> float:
    """What those who stand on a lane beyond arc length `s` cost, seconds."""
    seconds = 0.0
    k = board.heads[lane]
    while k >= 0:
        entry = board.entries[k]
        k = entry.next
        if entry.s > s and entry.speed < SLOW:
            seconds += QUEUE
    return seconds


@kernel
def _write_footprint(roads: Roads, grid: Grid, ego: Record, index: int, board: Board) -> None:
    """Put the ego on every lane whose corridor its box overlaps, wherever it really is."""
    c, s = np.cos(ego.heading), np.sin(ego.heading)
    near = board.near
    found = 0
    r0, r1, c0, c1 = cell_range(grid, ego.x, ego.y, 0.5 * (ego.length + ego.width) + CORRIDOR)
    for r in range(r0, r1):
        for k in range(grid.start[r * grid.shape[1] + c0], grid.start[r * grid.shape[1] + c1]):
            n = grid.order[k]
            p = roads.samples[n]
            dx, dy = p.x - ego.x, p.y - ego.y
            if abs(dx * c + dy * s) > 0.5 * ego.length or abs(dy * c - dx * s) > 0.5 * ego.width + CORRIDOR:
                continue
            if abs(p.z - ego.z) > LEVEL:
                continue
            away = dx * dx + dy * dy
            slot = 0
            while slot < found and int(near[slot, 0]) != p.lane:
                slot += 1
            if slot == found and found < len(near):
                found += 1
                near[slot, 0], near[slot, 2] = p.lane, np.inf
            if slot < found and away < near[slot, 2]:
                near[slot, 1], near[slot, 2] = n, away
    for slot in range(found):
        n = int(near[slot, 1])
        p = roads.samples[n]
        lane = roads.lanes[p.lane]
        hc, hs = np.cos(p.heading), np.sin(p.heading)
        along = (n - lane.first) * lane.step + (ego.x - p.x) * hc + (ego.y - p.y) * hs
        cosine, sine = c * hc + s * hs, s * hc - c * hs
        half = 0.5 * (ego.length * abs(cosine) + ego.width * abs(sine))
        put_entry(board, p.lane, index, along, half, ego.speed * cosine)


@kernel
def write_users(roads: Roads, fleet: Fleet, board: Board) -> None:
    """Who is in, or may go into, which connector, and how much room they will take beyond it."""
    board.user_heads[:] = -1
    board.used[1] = 0
    board.bound[:] = 0.0
    for i in range(len(fleet.cars)):
        register(roads, fleet.cars[i], fleet.path[i], fleet.trail[i], i, board)


@kernel
def register(roads: Roads, car: Record, path: Ints, trail: Ints, i: int, board: Board) -> None:
    """Put one vehicle down as user of the connectors under it and of those it may go through."""
    half = 0.5 * car.length
    base = 0.0
    for k in range(TRAIL):
        if car.s + base >= half or trail[k] < 0:
            break
        base += roads.lanes[trail[k]].length
        if roads.lanes[trail[k]].gate:
            put_user(board, trail[k], i, car.s + base, car, 0)
    base = 0.0
    last = -1
    for k in range(min(car.clear + 1, car.count)):
        if roads.lanes[path[k]].gate:
            put_user(board, path[k], i, car.s - base, car, 0)
            last = k
        base += roads.lanes[path[k]].length
    if last >= 0 and last + 1 < car.count:
        board.bound[path[last + 1]] += car.length + BERTH

"""One step of the traffic, and the reference driver's choice for the ego."""

from __future__ import annotations

from numpy.typing import NDArray

from me3bev_plugins.simulator.highway.compiled import kernel
from me3bev_plugins.simulator.highway.pedestrian_kernel import publish_people, step_people
from me3bev_plugins.simulator.highway.pedestrian_tables import Walks
from me3bev_plugins.simulator.highway.signals import SignalPlan, write_lights
from me3bev_plugins.simulator.highway.town import Floats
from me3bev_plugins.simulator.highway.traffic_board import write_entries, write_users
from me3bev_plugins.simulator.highway.traffic_changes import change_lanes, drift
from me3bev_plugins.simulator.highway.traffic_claims import hold_distance
from me3bev_plugins.simulator.highway.traffic_drive import CURB_GAP, GENTLE, drive
from me3bev_plugins.simulator.highway.traffic_grid import Grid
from me3bev_plugins.simulator.highway.traffic_records import TRAIL, Records
from me3bev_plugins.simulator.highway.traffic_right_of_way import grant_gates, next_gate, revoke
from me3bev_plugins.simulator.highway.traffic_state import Board, Fleet, advance, place
from me3bev_plugins.simulator.highway.traffic_tables import Roads

MEEK_AFTER = 3.0
"""Who has stood inside a junction, or granted before it, for so long lets others go first, seconds."""

EASE, EASED = 1.0, 0.6
"""Who looks for a gap in the lane beside it slows down so hard, m/s^2, but not below this share of the limit."""


@kernel
def look_around(roads: Roads, grid: Grid, plan: SignalPlan, fleet: Fleet, board: Board, time: float) -> None:
    """Write the board for the present state: lights and who is where."""
    write_lights(plan, time, board.lights)
    write_entries(roads, grid, fleet, board)


@kernel
def decide(roads: Roads, fleet: Fleet, board: Board, time: float, dt: float) -> None:
    """Settle the right of way and every vehicle's acceleration; the ego drives itself."""
    ego = len(fleet.cars) - 1
    revoke(roads, fleet, board, time)
    gate, line = next_gate(roads, fleet.cars[ego], fleet.path[ego])
    if gate > 0 and line < -0.3:
        fleet.cars[ego].clear = gate  # It is in already, with right of way or without.
    write_users(roads, fleet, board)
    grant_gates(roads, fleet, board, time, dt)
    for i in range(len(fleet.cars)):
        car = fleet.cars[i]
        inside = car.clear > 0 or roads.lanes[fleet.path[i, 0]].gate
        car.meek = int(inside and (car.meek or car.still > MEEK_AFTER))
        if car.meek:
            car.hold = hold_distance(roads, board, car, fleet.path[i], i)
    for i in range(ego):
        car = fleet.cars[i]
        car.accel = drive(roads, board, car, fleet.path[i], i)
        if car.ease and car.speed > EASED * roads.lanes[fleet.path[i, 0]].limit:
            car.accel = min(car.accel, -EASE)


@kernel
def move(roads: Roads, fleet: Fleet, board: Board, dt: float) -> None:
    """Move every vehicle by one step, as highway-env does: first the position, then the speed."""
    for i in range(len(fleet.cars) - 1):
        car, path, trail = fleet.cars[i], fleet.path[i], fleet.trail[i]
        metres = car.speed * dt
        advance(roads, board.queues, car, path, trail, metres)
        angle = drift(car, metres)
        car.speed = max(0.0, car.speed + car.accel * dt)
        car.still = car.still + dt if car.speed < 0.2 else 0.0
        place(roads, car, path, trail)
        car.heading += angle
    ego = fleet.cars[len(fleet.cars) - 1]
    ego.still = ego.still + dt if ego.speed < 0.2 else 0.0


@kernel
def mark_crossings(roads: Roads, fleet: Fleet, board: Board) -> None:
    """Mark the crossings that a vehicle is on, or could not stop before."""
    board.hot[:] = 0
    for i in range(len(fleet.cars)):
        car, path, trail = fleet.cars[i], fleet.path[i], fleet.trail[i]
        half = 0.5 * car.length
        braking = car.speed * car.speed / (2.0 * GENTLE)
        start = -car.s
        for k in range(car.count):
            if start > half + braking + CURB_GAP:
                break
            lane = roads.lanes[path[k]]
            for n in range(lane.cross0, lane.cross1):
                ahead = start + roads.links[n].s - half
                if -2.0 * half - 1.0 < ahead < max(braking + CURB_GAP if car.speed > 0.3 else 0.0, 1.0):
                    board.hot[roads.links[n].crossing] = 1
            start += lane.length
        start = -car.s
        for k in range(TRAIL):
            if trail[k] < 0 or -start > half + 1.0:
                break
            lane = roads.lanes[trail[k]]
            start -= lane.length
            for n in range(lane.cross0, lane.cross1):
                if start + roads.links[n].s > -half - 1.0:
                    board.hot[roads.links[n].crossing] = 1


@kernel
def publish(fleet: Fleet, people: Records, pose: Floats, braking: NDArray) -> None:
    """Copy poses into the rows x, y, z, heading, speed of `pose` (5, A) and set the brake lights."""
    for i in range(len(fleet.cars) - 1):
        car = fleet.cars[i]
        pose[0, i], pose[1, i], pose[2, i] = car.x, car.y, car.z
        pose[3, i], pose[4, i] = car.heading, car.speed
        braking[i] = car.accel < -0.4 or car.speed < 0.1
    publish_people(people, pose, len(fleet.cars) - 1)


@kernel
def step_traffic(
    roads: Roads,
    grid: Grid,
    walks: Walks,
    plan: SignalPlan,
    fleet: Fleet,
    people: Records,
    board: Board,
    pose: Floats,
    braking: NDArray,
    time: float,
    dt: float,
) -> None:
    """Advance everything by one step and publish it; the ego's record already holds its new pose."""
    look_around(roads, grid, plan, fleet, board, time)
    decide(roads, fleet, board, time, dt)
    change_lanes(roads, fleet, board, dt)
    move(roads, fleet, board, dt)
    mark_crossings(roads, fleet, board)
    step_people(roads, walks, people, fleet, board, dt)
    publish(fleet, people, pose, braking)


@kernel
def advise_ego(roads: Roads, grid: Grid, fleet: Fleet, board: Board) -> float:
    """The acceleration a careful driver would choose in the ego's place, m/s^2."""
    write_entries(roads, grid, fleet, board)
    ego = len(fleet.cars) - 1
    return drive(roads, board, fleet.cars[ego], fleet.path[ego], ego)

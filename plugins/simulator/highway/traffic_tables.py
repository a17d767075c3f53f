"""What traffic needs to know of a town, worked out once per town and kept with it."""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from me3bev_plugins.simulator.highway.pedestrian_tables import Walks, build_walks
from me3bev_plugins.simulator.highway.town import Floats, Ints, Town
from me3bev_plugins.simulator.highway.traffic_conflicts import find_zones
from me3bev_plugins.simulator.highway.traffic_grid import Grid, build_grid
from me3bev_plugins.simulator.highway.traffic_parameters import idm_parameters, mobil_parameters
from me3bev_plugins.simulator.highway.traffic_records import (
    CROSS,
    GO,
    HALF,
    LANE,
    LENGTHS,
    SAMPLE,
    SMALL,
    SPACING,
    SPLIT,
    STOP,
    YIELD,
    Records,
)
from me3bev_plugins.simulator.highway.traffic_routes import plan_routes

LATERAL = 2.5
"""Acceleration towards the inside that a driver accepts in a bend, m/s^2."""
EASE = 2.0
"""Deceleration towards a bend or a lower limit, m/s^2."""
SLOWEST = 2.5
"""No bend is taken more slowly, m/s."""
REACH = 8.0
"""Turning vehicles sweep no more than this of the roads at a junction, metres."""
_TURNS = {"straight": 0, "right": 1, "left": 2, "uturn": 3}


class Roads(NamedTuple):
    """The lanes of a town as records, and highway-env's IDM parameters."""

    lanes: Records
    """(L,) `LANE`"""
    samples: Records
    """(P,) `SAMPLE`"""
    follow: Ints
    """Successors of all lanes, in one row."""
    before: Ints
    """Predecessors, likewise."""
    zones: Records
    """(Z,) `ZONE`"""
    zone_start: Ints
    """(4, L + 1): zones of lane i for a vehicle of size own and another one of size other are
    `zone_start[2 * own + other, i] : zone_start[2 * own + other, i + 1]`."""
    links: Records
    """(K,) `LINK`"""
    idm: Floats
    """(6,) desired acceleration, comfortable deceleration (positive), time gap, jam gap between bumpers, exponent,
    greatest acceleration."""
    mobil: Floats
    """(4,) politeness, least gain of acceleration, greatest braking imposed on others, seconds between two thoughts."""
    times: NDArray[np.float32]
    """(4, D, L) seconds to every destination, as `plan_routes` gives them."""


class Tables(NamedTuple):
    """All that is fixed for a town."""

    roads: Roads
    grid: Grid
    walks: Walks


@lru_cache(maxsize=16)
def tables(town: Town) -> Tables:
    """The tables of a town."""
    lanes, samples = _sample(town)
    follow = town.arrays.successor
    before = np.array([n for lane in town.lanes for n in lane.predecessors], np.int32)
    _control(town, lanes)
    grid = build_grid(samples)
    zones, zone_start = find_zones(town, lanes, samples)
    walks, links = build_walks(town, lanes, samples, grid)
    _gates(town, lanes, zones, zone_start)
    _admit(town, lanes, samples, zones, zone_start)
    _stop_lines(lanes, zones, zone_start, links, walks.crossings, follow)
    times = plan_routes(town, lanes)
    model = (idm_parameters(), mobil_parameters())
    return Tables(Roads(lanes, samples, follow, before, zones, zone_start, links, *model, times), grid, walks)


def _sample(town: Town) -> tuple[NDArray, NDArray]:
    """Lane records and evenly spaced samples with the speed at which each may be passed."""
    lanes = np.zeros(len(town.lanes), LANE)
    pieces = []
    first = 0
    for lane, record in zip(town.lanes, lanes, strict=True):
        count = max(2, int(np.ceil(lane.length / SPACING)) + 1)
        s = np.linspace(0.0, lane.length, count)
        piece = np.zeros(count, SAMPLE)
        for name, column in (("x", 0), ("y", 1), ("z", 2)):
            piece[name] = np.interp(s, lane.s, lane.points[:, column])
        piece["heading"] = np.interp(s, lane.s, lane.heading)
        piece["lane"] = lane.id
        piece["speed"] = _speeds(s, piece["heading"], lane.limit)
        record["length"], record["step"], record["limit"], record["width"] = (
            lane.length,
            lane.length / (count - 1),
            lane.limit,
            lane.width,
        )
        record["stop"], record["speed"], record["first"], record["count"] = lane.length, piece["speed"][0], first, count
        pieces.append(piece)
        first += count
    arrays = town.arrays
    for name in ("left", "right", "junction"):
        lanes[name] = getattr(arrays, name)
    lanes["follow0"], lanes["follow1"] = arrays.successor_start[:-1], arrays.successor_start[1:]
    arrivals = np.concatenate([[0], np.cumsum([len(lane.predecessors) for lane in town.lanes])])
    lanes["before0"], lanes["before1"] = arrivals[:-1], arrivals[1:]
    lanes["turn"] = [_TURNS[lane.turn] for lane in town.lanes]
    return lanes, np.concatenate(pieces)


def curvature(s: Floats, heading: Floats) -> Floats:
    """Curvature (P,) along a lane, smoothed over 3 m so that a kink between samples is no hairpin, 1/m."""
    reach = min(1.5, s[-1] / 2)
    ahead, behind = np.minimum(s + reach, s[-1]), np.maximum(s - reach, 0.0)
    bend: Floats = (np.interp(ahead, s, heading) - np.interp(behind, s, heading)) / np.maximum(ahead - behind, 1e-6)
    return bend


def _speeds(s: Floats, heading: Floats, limit: float) -> Floats:
    """Permitted speed (P,): the limit, less in and before bends, m/s."""
    bend = np.abs(curvature(s, heading))
    speed = np.minimum(limit, np.maximum(SLOWEST, np.sqrt(LATERAL / np.maximum(bend, 1e-9))))
    for i in range(len(s) - 2, -1, -1):
        speed[i] = min(speed[i], np.sqrt(speed[i + 1] ** 2 + 2 * EASE * (s[i + 1] - s[i])))
    return speed


def _control(town: Town, lanes: Records) -> None:
    """Signals and signs at the ends of lanes, and the rank of every connector in its junction."""
    lanes["signal"] = -1
    lanes["sign"] = GO
    for signal in town.signals:
        lanes["signal"][list(signal.lanes)] = signal.id
    for junction in town.junctions:
        kind = {"stop": STOP, "yield": YIELD}.get(junction.control)
        minor = [i for i in junction.minor if lanes["signal"][i] < 0]
        if kind is not None:
            lanes["sign"][minor] = kind
        for sign in town.signs:
            if sign.lane in minor:
                lanes["sign"][sign.lane] = STOP if sign.kind == "stop" else YIELD
        for connector in junction.connectors:
            gives_way = any(i in minor for i in town.lanes[connector].predecessors)
            turns_across = town.lanes[connector].turn in ("left", "uturn")
            lanes["rank"][connector] = 2 * gives_way + turns_across


def _admit(town: Town, lanes: Records, samples: Records, zones: Records, zone_start: Ints) -> None:
    """Which sizes of vehicles may use a lane: wide enough in its bends, and with a way on that never ends."""
    gate = lanes["gate"] > 0
    roomy = np.array([not _sweeps_far(lanes, zones, zone_start, i) for i in range(len(lanes))])
    sharpest = np.zeros(len(lanes))
    for i, lane in enumerate(lanes):
        piece = samples[lane["first"] : lane["first"] + lane["count"]]
        sharpest[i] = np.abs(curvature(np.linspace(0, lane["length"], lane["count"]), piece["heading"])).max()
    endless = _endless(town, np.ones(len(lanes), np.bool_))
    if not endless.any():
        endless[:] = True  # A town without any loop: vehicles stop where the road does.
    lanes["admits"] = np.where(endless, SMALL, 0)
    for size, length in LENGTHS.items():
        # Both axles are on the line, 0.6 of the length apart: so far the outer front corner leaves it.
        sweep = 0.08 * length**2 * sharpest + 1.25
        stays = np.array([_leaves_room(town, lanes, gate, i, length) for i in range(len(lanes))])
        fits = _endless(town, endless & roomy & stays & (sweep <= lanes["width"] / 2 + 0.2))
        if (lanes["length"] * fits).sum() > 0.2 * lanes["length"].sum():
            lanes["admits"] |= np.where(fits, size, 0)


def _sweeps_far(lanes: Records, zones: Records, zone_start: Ints, lane: int) -> bool:
    """Whether a large vehicle on a connector would need more of the roads beside it than small ones leave it there."""
    if lanes["junction"][lane] < 0:
        return False
    for zone in zones[zone_start[2, lane] : zone_start[2, lane + 1]]:
        other = lanes[zone["other"]]
        if other["junction"] >= 0:
            continue
        at_end = zone["b0"] + HALF[0] >= max(other["length"] - REACH, 0.5 * other["length"])
        at_start = zone["b1"] - HALF[0] <= min(REACH, 0.5 * other["length"])
        if not (at_end or at_start):
            return True
    return False


def _leaves_room(town: Town, lanes: Records, gate: NDArray[np.bool_], lane: int, length: float) -> bool:
    """Whether a vehicle of a length that leaves a connector can stand clear of every next one."""
    if not gate[lane]:
        return True
    frontier = [(n, 0.0) for n in town.lanes[lane].successors]
    while frontier:
        current, metres = frontier.pop()
        if gate[current]:
            if 0.0 < metres < length + 2 * REACH:
                return False
            continue
        metres += town.lanes[current].length
        if metres < length + 2 * REACH:
            frontier += [(n, metres) for n in town.lanes[current].successors]
    return True


def _endless(town: Town, allowed: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """The allowed lanes from which one can go on over allowed lanes for ever."""
    alive = allowed.copy()
    doomed = [lane.id for lane in town.lanes if alive[lane.id] and not any(alive[n] for n in lane.successors)]
    while doomed:
        lost = doomed.pop()
        if not alive[lost]:
            continue
        alive[lost] = False
        doomed += [
            p for p in town.lanes[lost].predecessors if alive[p] and not any(alive[list(town.lanes[p].successors)])
        ]
    return alive


def _gates(town: Town, lanes: Records, zones: Records, zone_start: Ints) -> None:
    """Connectors that may only be entered when granted: those that meet others, and those behind a signal or sign."""
    for lane in town.lanes:
        if lane.junction is None:
            continue
        own = zones[zone_start[0, lane.id] : zone_start[0, lane.id + 1]]
        meets = ((own["kind"] == CROSS) | (own["joint"] != SPLIT)).any()
        controlled = any(lanes["signal"][p] >= 0 or lanes["sign"][p] != GO for p in lane.predecessors)
        lanes["gate"][lane.id] = int(meets or controlled)


def _stop_lines(
    lanes: Records, zones: Records, zone_start: Ints, links: Records, crossings: Records, follow: Ints
) -> None:
    """Where vehicles that wait at a gate, or have just left one, are out of everybody's way.

    Fronts halt before pedestrians' crossings and before what others sweep as they turn; rears must get beyond it.
    """
    for i, lane in enumerate(lanes):
        if lane["junction"] >= 0:
            continue
        stop, clear = lane["length"], 0.5
        for pair in range(4):
            half = HALF[pair // 2]
            for zone in zones[zone_start[pair, i] : zone_start[pair, i + 1]]:
                if not lanes["gate"][zone["other"]]:
                    continue
                if zone["a0"] + half > lane["length"] - REACH:
                    stop = min(stop, zone["a0"] + half)
                if zone["a1"] - half < REACH:
                    clear = max(clear, zone["a1"] - half)
        for link in links[lane["cross0"] : lane["cross1"]]:
            if crossings["marked"][link["crossing"]] and lane["length"] - 10.0 < link["s"]:
                stop = min(stop, link["s"] - 3.0)
        if lanes["gate"][follow[lane["follow0"] : lane["follow1"]]].any():
            lane["stop"] = max(stop, 0.5 * lane["length"])
        lane["clear"] = clear

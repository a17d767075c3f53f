"""Random routes: where to start, which way to go, and how far a nominal driver comes."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from me3bev_plugins.simulator.highway.routes import Route, make_route
from me3bev_plugins.simulator.highway.town import Floats, Town

DURATION = 10.0
"""Seconds that the nominal driver takes for a route."""
ACCELERATION = 2.0
"""Of the nominal driver, m/s^2, and its braking."""
LATERAL = 2.5
"""Its acceleration in bends, m/s^2."""
RUN_OUT = 300.0
"""Metres of lanes beyond the route's end: room for five waypoints at the widest spacing."""
DRIVE = 0.5 * ACCELERATION * DURATION**2
"""The longest that a route can be, metres."""
BEFORE_JUNCTION = 20.0
"""Least distance from the start to the next junction, metres."""
AFTER_JUNCTION = 5.0
"""Least distance from the start back to a junction, metres."""


class _Starts(NamedTuple):
    """Where routes may begin: lanes, and the stretch [low, high] of each; `share` is cumulative by length."""

    lanes: NDArray[np.int32]
    low: Floats
    high: Floats
    share: Floats
    reach: Floats
    """(L,) metres that can be driven from the beginning of every lane, at most what a route needs."""


def _reaches(town: Town) -> Floats:
    """How far one can drive from the beginning of each lane before a dead end, up to a route and its run-out."""
    most = DRIVE + RUN_OUT
    reach = np.array([lane.length for lane in town.lanes])
    while True:
        longer = np.array(
            [min(most, lane.length + max((reach[n] for n in lane.successors), default=0.0)) for lane in town.lanes]
        )
        if np.array_equal(longer, reach):
            return reach
        reach = longer


def _distances(town: Town, *, forward: bool) -> Floats:
    """Metres from the end (backwards: the beginning) of each lane to the next junction, at most 50."""
    most = 50.0
    far = np.full(len(town.lanes), most)
    for _ in range(50):
        nearer = far.copy()
        for lane in town.lanes:
            for n in lane.successors if forward else lane.predecessors:
                other = town.lanes[n]
                beyond = 0.0 if other.junction is not None else other.length + far[n]
                nearer[lane.id] = min(nearer[lane.id], beyond)
        if np.array_equal(nearer, far):
            break
        far = nearer
    return far


@lru_cache(maxsize=16)
def _starts(town: Town) -> _Starts:
    reach = _reaches(town)
    ahead, behind = _distances(town, forward=True), _distances(town, forward=False)
    length = town.arrays.length
    low = np.maximum(0.0, AFTER_JUNCTION - behind)
    high = np.minimum(length - np.maximum(0.0, BEFORE_JUNCTION - ahead), reach - 1.0)
    road = np.array([lane.junction is None for lane in town.lanes])
    # Rather a route without a dead end; a small or broken map may have none.
    whole = np.minimum(high, length - (DRIVE + RUN_OUT - reach))
    for top in (whole, high, length - 1e-3):
        usable = np.flatnonzero(road & (top > low))
        if len(usable):
            size = (top - low)[usable]
            return _Starts(usable.astype(np.int32), low[usable], top[usable], np.cumsum(size) / size.sum(), reach)
    everything = np.arange(len(length), dtype=np.int32)
    return _Starts(everything, 0.0 * length, length, np.cumsum(length) / length.sum(), reach)


@njit(cache=True)
def _nominal(s: NDArray[Any], cap: NDArray[Any], acceleration: float, duration: float) -> float:
    """Metres covered in `duration` seconds from a standing start, below the speeds `cap` (P,) at `s` (P,)."""
    allowed = cap.copy()
    for i in range(len(s) - 2, -1, -1):
        allowed[i] = min(allowed[i], np.sqrt(allowed[i + 1] ** 2 + 2.0 * acceleration * (s[i + 1] - s[i])))
    time, speed = 0.0, 0.0
    for i in range(len(s) - 1):
        step = s[i + 1] - s[i]
        after = min(allowed[i + 1], np.sqrt(speed**2 + 2.0 * acceleration * step))
        taken = 2.0 * step / (speed + after)
        if time + taken >= duration:
            return float(s[i] + (duration - time) / taken * step)
        time, speed = time + taken, after
    return float(s[-1])


def nominal_length(town: Town, route: Route) -> float:
    """How far a nominal driver comes along a route in `DURATION` seconds from a standing start, metres.

    It accelerates and brakes with 2 m/s^2, keeps the limit, and takes bends with 2.5 m/s^2 of lateral
    acceleration.
    """
    s = np.arange(0.0, min(route.s[-1], DRIVE + 40.0), 0.5)
    heading = np.interp(s, route.s, route.heading)
    curvature = np.abs(np.convolve(np.gradient(heading, s), np.full(3, 1 / 3), mode="same"))
    limit = town.arrays.limit[route.lanes[np.searchsorted(route.begins, s, side="right") - 1]]
    cap = np.minimum(limit, np.sqrt(LATERAL / np.maximum(curvature, 1e-4)))
    return float(_nominal(s, cap, ACCELERATION, DURATION))


def random_route(town: Town, rng: np.random.Generator) -> Route:
    """A route from a random point outside junctions, with random turns.

    Every metre of road is as likely a start as any other, save near junctions. Dead ends are avoided where
    there is another way.

    Args:
        rng: the only source of randomness.
    """
    starts = _starts(town)
    pick = min(int(np.searchsorted(starts.share, rng.random(), side="right")), len(starts.lanes) - 1)
    start = float(rng.uniform(starts.low[pick], starts.high[pick]))
    lanes = [int(starts.lanes[pick])]
    rest = DRIVE + RUN_OUT - (town.lanes[lanes[-1]].length - start)
    while rest > 0:
        followers = town.lanes[lanes[-1]].successors
        if not followers:
            break
        open_ends = [n for n in followers if starts.reach[n] >= rest - 1e-6]
        if not open_ends:
            open_ends = [max(followers, key=lambda n: starts.reach[n])]
        lanes.append(open_ends[int(rng.integers(len(open_ends)))])
        rest -= town.lanes[lanes[-1]].length
    route = make_route(town, lanes, start, 0.0)
    return replace(route, length=nominal_length(town, route))

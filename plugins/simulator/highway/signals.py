"""Traffic lights: the groups of a junction are green in turn, each followed by amber and a moment of red for all."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from me3bev_plugins.simulator.highway.compiled import kernel
from me3bev_plugins.simulator.highway.scene import Light
from me3bev_plugins.simulator.highway.town import Floats, Town

AMBER = 3.0
"""Seconds."""
CLEARANCE = 1.5
"""Seconds of red for all between two groups."""
SHORT, LONG = 8.0, 12.0
"""Range from which a junction's green is drawn, seconds."""
ALONE = 8.0
"""Red of a junction with one group only, seconds."""

CLOSE = 45.0
"""Lights keep time with those at the other end of a lane that is shorter than this, metres."""

_RED, _AMBER, _GREEN = int(Light.RED), int(Light.AMBER), int(Light.GREEN)


class SignalPlan(NamedTuple):
    """When each of S signals is green, for one episode."""

    begin: Floats
    """(S,) start of its green within its junction's cycle, seconds."""
    green: Floats
    """(S,) length of the green."""
    cycle: Floats
    """(S,) length of the cycle."""


class Timing(NamedTuple):
    """When a signal is green, in turns: each lasts a green, an amber and a moment of red for all."""

    cluster: int
    first: int
    turns: int
    cycle: int


@lru_cache(maxsize=16)
def timings(town: Town) -> tuple[Timing, ...]:
    """The timing of every signal. Lights that stand close together keep time and let the same axis go at once, so that
    the short road between them is no trap. The groups along the axis of the cluster's first light come first, and take
    the turns that a junction with fewer groups has to spare.
    """
    heads: dict[int, dict[int, list[float]]] = {}
    for signal in town.signals:
        heads.setdefault(signal.junction, {}).setdefault(signal.group, []).append(signal.heading)
    found: dict[tuple[int, int], Timing] = {}
    for number, cluster in enumerate(_clusters(town, sorted(heads))):
        axis = _bearing(heads[cluster[0]][min(heads[cluster[0]])], 2)
        cycle = max(len(heads[junction]) for junction in cluster)
        for junction in cluster:
            groups = heads[junction]
            off = {g: round(_apart(_bearing(groups[g], 2), axis), 1) for g in groups}
            ordered = sorted(groups, key=lambda g: (off[g], g)) if len(cluster) > 1 else sorted(groups)
            spare = cycle - len(groups)
            for n, group in enumerate(ordered):
                found[junction, group] = Timing(number, n + spare * (n > 0), 1 + spare * (n == 0), cycle)
    return tuple(found[signal.junction, signal.group] for signal in town.signals)


def _clusters(town: Town, junctions: list[int]) -> list[list[int]]:
    """Junctions with lights, those together between which a lane is shorter than `CLOSE`."""
    cluster = {j: [j] for j in junctions}
    for lane in town.lanes:
        if lane.junction is not None or lane.length > CLOSE:
            continue
        ends = [town.lanes[n].junction for n in (*lane.predecessors, *lane.successors)]
        near = [j for j in ends if j in cluster]
        for j in near[1:]:
            if cluster[j] is not cluster[near[0]]:
                merged = sorted(cluster[j] + cluster[near[0]])
                for member in merged:
                    cluster[member] = merged
    return [members for j, members in cluster.items() if members[0] == j]


def _bearing(headings: list[float], fold: int) -> float:
    """Mean of angles that count the same after a turn of 2 pi / `fold`, times `fold`, radians."""
    return math.atan2(sum(math.sin(fold * h) for h in headings), sum(math.cos(fold * h) for h in headings))


def _apart(a: float, b: float) -> float:
    return abs((a - b + math.pi) % (2 * math.pi) - math.pi)


def draw_plan(town: Town, rng: np.random.Generator) -> SignalPlan:
    """A plan with the green and offset of every junction, or cluster of junctions, drawn from `rng`."""
    count = len(town.signals)
    plan = SignalPlan(np.zeros(count), np.zeros(count), np.ones(count))
    greens = rng.uniform(SHORT, LONG, len(town.junctions))
    offsets = rng.uniform(0.0, 1.0, len(town.junctions))
    for i, timing in enumerate(timings(town)):
        green = float(greens[timing.cluster]) if timing.cycle < 4 else SHORT
        turn = green + AMBER + CLEARANCE
        cycle = turn * timing.cycle if timing.cycle > 1 else turn + ALONE
        plan.begin[i] = (timing.first * turn + float(offsets[timing.cluster]) * cycle) % cycle
        plan.green[i], plan.cycle[i] = timing.turns * turn - AMBER - CLEARANCE, cycle
    return plan


@kernel
def write_lights(plan: SignalPlan, time: float, lights: NDArray) -> None:
    """State of every signal at a time, into `lights` (S,)."""
    for i in range(len(lights)):
        phase = (time - plan.begin[i]) % plan.cycle[i]
        if phase < plan.green[i]:
            lights[i] = _GREEN
        elif phase < plan.green[i] + AMBER:
            lights[i] = _AMBER
        else:
            lights[i] = _RED

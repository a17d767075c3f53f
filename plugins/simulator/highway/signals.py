"""Traffic lights: the groups of a junction are green in turn, each followed by amber and a moment of red for all."""

from __future__ import annotations

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

_RED, _AMBER, _GREEN = int(Light.RED), int(Light.AMBER), int(Light.GREEN)


class SignalPlan(NamedTuple):
    """When each of S signals is green, for one episode."""

    begin: Floats
    """(S,) start of its green within its junction's cycle, seconds."""
    green: Floats
    """(S,) length of the green."""
    cycle: Floats
    """(S,) length of the cycle."""


def draw_plan(town: Town, rng: np.random.Generator) -> SignalPlan:
    """A plan with every junction's green and offset drawn from `rng`."""
    count = len(town.signals)
    plan = SignalPlan(np.zeros(count), np.zeros(count), np.ones(count))
    greens = rng.uniform(SHORT, LONG, len(town.junctions))
    offsets = rng.uniform(0.0, 1.0, len(town.junctions))
    members: dict[int, list[int]] = {}
    for signal in town.signals:
        members.setdefault(signal.junction, []).append(signal.id)
    for junction, ids in members.items():
        groups = sorted({town.signals[i].group for i in ids})
        green = float(greens[junction]) if len(groups) < 4 else SHORT
        turn = green + AMBER + CLEARANCE
        cycle = turn * len(groups) if len(groups) > 1 else turn + ALONE
        for i in ids:
            plan.begin[i] = (groups.index(town.signals[i].group) * turn + float(offsets[junction]) * cycle) % cycle
            plan.green[i], plan.cycle[i] = green, cycle
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

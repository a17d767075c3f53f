"""The records that compiled traffic code works on: one structured array per kind of thing.

Fixed for a town: `LANE`, `SAMPLE`, `ZONE`, `LINK`. Changing every step: `VEHICLE`, `ENTRY`, `USER`.
"""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np

Record: TypeAlias = Any
"""One element of a structured array, handed to kernels by reference; its fields are attributes."""
Records: TypeAlias = Any
"""A structured array."""

PATH = 12
"""Lanes of a vehicle's own way ahead that are remembered, the one it is on first."""
TRAIL = 3
"""Lanes behind a vehicle that are remembered, the latest first."""
SPACING = 0.5
"""Nearly the distance between two samples of a lane, metres (each lane divides its length evenly)."""

SMALL, SHORT, MEDIUM, LONG = 1, 2, 4, 8
"""Bits of `LANE.admits`: vehicles up to 6.2 m, and trucks by `LENGTHS`."""
LENGTHS = {SHORT: 7.5, MEDIUM: 9.0, LONG: 12.0}
"""Greatest length of the trucks of each size, metres."""
GO, YIELD, STOP = 0, 1, 2
"""Values of `LANE.sign`."""
CROSS, LEAD = 0, 1
"""Values of `ZONE.kind`: paths that cross, paths that run together."""
APART, SPLIT, MERGE = 0, 1, 2
"""Values of `ZONE.joint`: nothing in common, the lane before both, the lane after both."""
HALF = (2.5, 4.5)
"""Half lengths of the small and the large vehicle for which zones were measured, metres."""
LARGE = 3.1
"""Half length beyond which a vehicle is large, metres."""

LANE = np.dtype(
    [
        ("length", "f8"),
        ("step", "f8"),  # between samples
        ("limit", "f8"),  # m/s
        ("width", "f8"),
        ("stop", "f8"),  # arc length at which a front halts
        ("clear", "f8"),  # arc length from which a vehicle's rear leaves the junction behind it free
        ("speed", "f8"),  # at which the lane may be entered, m/s
        ("first", "i4"),  # sample
        ("count", "i4"),  # of samples
        ("left", "i4"),  # neighbour or -1
        ("right", "i4"),
        ("junction", "i4"),  # or -1
        ("gate", "i4"),  # 1: may be entered only when granted
        ("admits", "i4"),
        ("signal", "i4"),  # that governs its end, or -1
        ("sign", "i4"),
        ("rank", "i4"),  # 0 first .. 3 last, of the right of way on a connector
        ("turn", "i4"),  # 0 straight, 1 right, 2 left, 3 back
        ("follow0", "i4"),  # successors
        ("follow1", "i4"),
        ("before0", "i4"),  # predecessors
        ("before1", "i4"),
        ("cross0", "i4"),  # crossings of pedestrians
        ("cross1", "i4"),
    ],
    align=True,
)

SAMPLE = np.dtype(
    [("x", "f8"), ("y", "f8"), ("z", "f8"), ("heading", "f8"), ("speed", "f8"), ("lane", "i4")], align=True
)
"""A point of a lane's centre; `speed` is the most at which a vehicle may pass it, m/s."""

ZONE = np.dtype(
    [
        ("a0", "f8"),
        ("a1", "f8"),
        ("b0", "f8"),
        ("b1", "f8"),
        ("at_a", "f8"),  # arc lengths that stand for one another, and metres of a per metre of b
        ("at_b", "f8"),
        ("ratio", "f8"),
        ("other", "i4"),
        ("kind", "i4"),
        ("joint", "i4"),  # what the two lanes have in common
    ],
    align=True,
)
"""Where a lane meets another one: the arc lengths of a vehicle's centre on this lane (a) and the other (b)."""

LINK = np.dtype([("crossing", "i4"), ("s", "f8"), ("along", "f8")], align=True)
"""A lane met by a crossing: at the lane's arc length `s`, `along` metres from the crossing's first end."""

VEHICLE = np.dtype(
    [
        ("s", "f8"),  # of the centre on its lane
        ("speed", "f8"),
        ("accel", "f8"),
        ("offset", "f8"),  # metres left of its lane's centre
        ("offset0", "f8"),  # the same when the change of lane began
        ("change", "f8"),  # metres that are left of it
        ("span", "f8"),  # metres that it takes
        ("shift", "f8"),  # arc length on the lane being left, minus `s`
        ("x", "f8"),
        ("y", "f8"),
        ("z", "f8"),
        ("heading", "f8"),
        ("length", "f8"),
        ("width", "f8"),
        ("height", "f8"),
        ("eager", "f8"),  # share of the permitted speed that it drives
        ("arrival", "f8"),  # when it came up to the gate ahead, s
        ("wait", "f8"),  # for how long it has stood there
        ("jam", "f8"),  # for how long there has been no room beyond
        ("still", "f8"),  # for how long it has stood
        ("hold", "f8"),  # how far it may go inside a junction, metres
        ("timer", "f8"),  # until it thinks of another lane
        ("rng", "u8"),
        ("kind", "i4"),
        ("size", "i4"),  # class of its zones
        ("admits", "i4"),
        ("count", "i4"),  # of its path
        ("clear", "i4"),  # how far along its path it may go through gates
        ("gate", "i4"),  # the gate for which `arrival` holds, or -1
        ("halted", "i4"),  # lane at whose stop sign it has stopped, or -1
        ("meek", "i4"),  # 1: it has stood in a junction for so long that others need not wait for it
        ("leaving", "i4"),  # lane being left, or -1
        ("ease", "i4"),  # 1: it drops back to find a gap in the lane beside it
        ("goal", "i4"),  # destination, or -1 to drive about at random
    ],
    align=True,
)

ENTRY = np.dtype(
    [("s", "f8"), ("half", "f8"), ("speed", "f8"), ("vehicle", "i4"), ("next", "i4")],
    align=True,
)
"""A vehicle on a lane, in a list per lane; `s` may lie beyond the lane's ends when only a part of it is there."""

USER = np.dtype(
    [("s", "f8"), ("half", "f8"), ("speed", "f8"), ("vehicle", "i4"), ("claim", "i4"), ("meek", "i4"), ("next", "i4")],
    align=True,
)
"""A vehicle that may use a connector (or, `claim`, is next to): `s` of its centre, negative before the connector."""

FOOTING = np.dtype([("x", "f8"), ("y", "f8"), ("z", "f8"), ("heading", "f8"), ("free", "f8")], align=True)
"""A point of a strip on which pedestrians walk; `free` is the distance to the nearest kerb, metres."""

STRIP = np.dtype(
    [
        ("length", "f8"),
        ("step", "f8"),
        ("half", "f8"),  # half of the width that is walked on
        ("before_s", "f8"),
        ("after_s", "f8"),
        ("first", "i4"),  # footing
        ("count", "i4"),
        ("before", "i4"),  # strip on which one goes on from its start, or -1, and where on it
        ("after", "i4"),  # the same from its end
        ("exit0", "i4"),
        ("exit1", "i4"),
    ],
    align=True,
)

EXIT = np.dtype([("s", "f8"), ("crossing", "i4"), ("side", "i4")], align=True)
"""Where a strip leads to one of the two ends of a crossing."""

CROSSING = np.dtype(
    [
        ("x0", "f8"),  # the two ends
        ("y0", "f8"),
        ("z0", "f8"),
        ("x1", "f8"),
        ("y1", "f8"),
        ("z1", "f8"),
        ("length", "f8"),
        ("s0", "f8"),  # where on their strips
        ("s1", "f8"),
        ("strip0", "i4"),
        ("strip1", "i4"),
        ("marked", "i4"),  # 1: a crosswalk
        ("corner", "i4"),  # 1: beside a junction
        ("met0", "i4"),  # links
        ("met1", "i4"),
        ("signal0", "i4"),
        ("signal1", "i4"),
    ],
    align=True,
)

PERSON = np.dtype(
    [
        ("x", "f8"),
        ("y", "f8"),
        ("z", "f8"),
        ("heading", "f8"),
        ("speed", "f8"),
        ("pace", "f8"),  # m/s when nothing is in the way
        ("s", "f8"),  # on its strip
        ("aside", "f8"),  # metres left of the strip's or the crossing's middle
        ("along", "f8"),  # metres from the crossing's first end
        ("wait", "f8"),
        ("rng", "u8"),
        ("strip", "i4"),
        ("way", "i4"),  # 1 or -1: along the strip or crossing, or against it
        ("mode", "i4"),
        ("crossing", "i4"),
    ],
    align=True,
)

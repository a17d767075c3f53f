"""T6: flat and wide. Two nested dual carriageways of four and five lanes with crossovers and link ramps, and one
cross street with lights that ends in turnarounds."""

from __future__ import annotations

import math

from me3bev_plugins.simulator.highway.towns.geometry import Path, polyline
from me3bev_plugins.simulator.highway.towns.streets import Layout, Node, Section, Street

FOUR, FIVE = (Section(n, 0, shoulder=1.5, sidewalk=0) for n in (4, 5))
CROSS = Section(3, 0, shoulder=0.5, sidewalk=0)
RAMP, CROSSOVER = (Section(n, 0, shoulder=1.0, sidewalk=0) for n in (1, 2))
NORTH, UPPER, LOWER, SOUTH = 18.0, -45.0, -143.0, -244.0
EAST, WEST = 666.0, -366.0
NECKS = (-326.0, 88.0)
SIDE = 5.25
"""From the middle of five lanes to the middle of the outer two."""
EDGE = 7.0
"""From the middle of five lanes to the middle of the outermost."""


def layout() -> Layout:
    """The town's streets and nodes."""
    return Layout("T6", "nested dual carriageways with crossovers", _carriageways() + _ramps(), _nodes())


def _carriageways() -> tuple[Street, ...]:
    outer_east = polyline((0, SOUTH), (EAST, SOUTH, 62), (EAST, NORTH, 50), (0, NORTH))
    outer_west = polyline((0, NORTH), (WEST, NORTH, 100), (WEST, SOUTH, 60), (0, SOUTH))
    inner = polyline((0, LOWER), (-320, LOWER, 48), (-320, UPPER, 48), (0, UPPER))
    return (
        Street("outer east", outer_east, FIVE, 60, kind="motorway"),
        Street("outer west", outer_west, FOUR, 90, kind="motorway"),
        Street("inner", inner, FOUR, 40, kind="motorway"),
        Street("upper", polyline((0, UPPER), (EAST, UPPER)), FIVE, 60, kind="motorway"),
        Street("lower", polyline((0, LOWER), (EAST, LOWER)), FIVE, 40, kind="motorway"),
        Street("northward", polyline((8, NECKS[0]), (8, NECKS[1])), CROSS, 40),
        Street("southward", polyline((-8, NECKS[1]), (-8, NECKS[0])), CROSS, 40),
        Street("north end", _turnaround(8, NECKS[1], 128, 147), CROSS, 30),
        Street("south end", _turnaround(-8, NECKS[0], -366, -408), CROSS, 30),
    )


def _turnaround(x: float, neck: float, widen: float, far: float) -> Path:
    """From x at the neck round the far end, counter-clockwise, to -x at the neck."""
    wide = math.copysign(14.5, x)
    side = [(x, neck), (x, (neck + widen) / 2, 40), (wide, widen, 25), (wide, far, 14)]
    return polyline(*side, *((-p[0], *p[1:]) for p in reversed(side)))


def _loop(x: float, bend: float, low: float, high: float, radius: float) -> Path:
    """A half turn from (x, low) round to (x, high), with its far side at x = bend."""
    return polyline((x, low), (bend, low, radius), (bend, high, radius), (x, high))


def _hook(x: float, bend: float, low: float, high: float, radius: float) -> Path:
    """From (x, low) round to x = bend and straight up to the middle of the carriageway at y = high."""
    return polyline((x, low), (bend, low, radius), (bend, high))


def _ramps() -> tuple[Street, ...]:
    def ramp(name: str, path: Path, section: Section = RAMP) -> Street:
        return Street(name, path, section, 40, kind="motorway")

    return (
        ramp("west crossover", _hook(-105, -152, NORTH - 3.5, UPPER, 20), CROSSOVER),
        ramp("middle crossover", _hook(100, 147, UPPER + SIDE, NORTH, 20), CROSSOVER),
        ramp("east crossover", _hook(475, 522, UPPER + EDGE, NORTH, 20)),
        ramp("turn north", _loop(-130, -74, SOUTH + SIDE, LOWER - SIDE, 38)),
        ramp("turn south", _loop(-190, -248, LOWER - SIDE, SOUTH + SIDE, 38)),
        ramp("long link", _slant((60, LOWER + EDGE), 105, 205, (262, UPPER - EDGE), 120)),
        ramp("short link", _slant((440, LOWER + EDGE), 482, 522, (566, UPPER - EDGE), 55)),
        ramp("south link", _slant((70, SOUTH + EDGE), 116, 201, (250, LOWER - EDGE), 100)),
    )


def _slant(start: tuple[float, float], leave: float, arrive: float, end: tuple[float, float], radius: float) -> Path:
    """From one carriageway up to the next: straight to x = leave, across, and straight again from x = arrive."""
    return polyline(start, (leave, start[1], radius), (arrive, end[1], radius), end)


def _nodes() -> tuple[Node, ...]:
    cross = tuple(
        Node(f"cross street {y:.0f}", (0, y), "signal", reach=9.5, radius=8, crosswalks=True)
        for y in (NORTH, UPPER, LOWER, SOUTH)
    )
    necks = tuple(Node(f"neck {y:.0f}", (0, y), reach=9.5) for y in NECKS)
    ends = (
        Node("upper end", (EAST, UPPER), "signal", radius=14),
        Node("lower end", (EAST, LOWER), "signal", radius=14),
    )
    lit = {("west crossover", "inner"), ("middle crossover", "outer east")}
    links = (
        ("west crossover", "outer west", "inner"),
        ("middle crossover", "upper", "outer east"),
        ("east crossover", "upper", "outer east"),
        ("turn north", "outer west", "inner"),
        ("turn south", "inner", "outer west"),
        ("long link", "lower", "upper"),
        ("short link", "lower", "upper"),
        ("south link", "outer east", "lower"),
    )
    paths = {street.name: street.path for street in _ramps()}
    ramps = []
    for ramp, source, target in links:
        start, end = paths[ramp].pose(0.0)[:2], paths[ramp].pose(paths[ramp].length)[:2]
        control = "signal" if (ramp, target) in lit else "yield"
        ramps.append(Node(f"{source} to {ramp}", start, streets=(source, ramp), reach=9, radius=15))
        ramps.append(Node(f"{ramp} to {target}", end, control, streets=(ramp, target), reach=9, radius=12))
    return (*cross, *necks, *ends, *ramps)

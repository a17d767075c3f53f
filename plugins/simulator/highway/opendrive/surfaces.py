"""Asphalt beyond the lanes themselves: shoulders, parking, turning lanes, junction floors; all as convex polygons."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import numpy as np

from me3bev_plugins.simulator.highway.opendrive.blocks import Shapes
from me3bev_plugins.simulator.highway.opendrive.junctions import Arm, Crossing, outward
from me3bev_plugins.simulator.highway.opendrive.lanes import Draft, Network
from me3bev_plugins.simulator.highway.opendrive.records import DRIVING, PAVED, is_driven
from me3bev_plugins.simulator.highway.opendrive.shapes import Key, SectionShape
from me3bev_plugins.simulator.highway.town import Floats

LONGEST = 20.0
"""Metres of one polygon along its road."""
MOST_TURN = np.radians(8.0)
"""Turn within one polygon."""
THINNEST = 0.05
"""Metres; thinner strips are left out."""
WIDEST_FLOOR = 45.0
"""Metres from a junction's middle; a wider one is a set of lanes, not a floor."""
UNEVEN = 0.15
"""Metres by which a lane may vary in width before its true area is added."""


def find_surfaces(shapes: Shapes, network: Network, crossings: list[Crossing]) -> tuple[Floats, ...]:
    """Polygons (P, 2), each convex, counter-clockwise or clockwise."""
    found: list[Floats] = []
    for shape in shapes.values():
        if not is_driven(shape.road):
            continue
        found.extend(_strips(shape, network))
    for crossing in crossings:
        found.extend(_floor(shapes, network, crossing))
    return tuple(found)


def paved_lanes(shape: SectionShape) -> list[int]:
    """Lane ids of asphalt, from left to right; unnamed lanes count where driving lanes lie beyond them."""
    lanes = shape.section.lanes
    paved = []
    for number in sorted((i for i in lanes if i != 0), reverse=True):
        beyond = any(i * number > 0 and abs(i) > abs(number) and lanes[i].type in DRIVING for i in lanes)
        if lanes[number].type in PAVED or (beyond and lanes[number].type != "median"):
            paved.append(number)
    return paved


def _strips(shape: SectionShape, network: Network) -> Iterator[Floats]:
    """Quadrilaterals along a section for what its lanes leave bare."""
    runs: list[tuple[int, int]] = []  # (leftmost, rightmost) lane of neighbouring strips.
    previous: int | None = None
    for number in paved_lanes(shape):
        if _drawn(shape, network, number):
            previous = None
            continue
        if previous is not None and previous - number == 1:
            runs[-1] = (runs[-1][0], number)
        else:
            runs.append((number, number))
        previous = number
    if not runs:
        return
    cuts = _cuts(shape)
    for leftmost, rightmost in runs:
        left = shape.edges[leftmost] if leftmost > 0 else shape.inner(leftmost)
        right = shape.edges[rightmost] if rightmost < 0 else shape.inner(rightmost)
        a, b = shape.line(left)[:, :2], shape.line(right)[:, :2]
        for first, last in pairwise(cuts):
            if max(left[first] - right[first], left[last] - right[last]) > THINNEST:
                yield np.array([a[first], a[last], b[last], b[first]])


def _drawn(shape: SectionShape, network: Network, number: int) -> bool:
    """Whether a lane of the town covers this piece already."""
    key: Key = (shape.road.id, shape.index, number)
    index = network.of.get(key)
    return index is not None and float(np.abs(shape.width(number) - network.lanes[index].width).max()) < UNEVEN


def _cuts(shape: SectionShape) -> list[int]:
    """Sample indices between which the section is short and straight enough for one polygon."""
    pieces = np.maximum((shape.s - shape.s[0]) / LONGEST, 0.0)
    turned = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(shape.heading)))]) / MOST_TURN
    steps = np.floor(pieces + turned)
    inner = np.flatnonzero(np.diff(steps) > 0) + 1
    return sorted({0, *(int(i) for i in inner), len(shape.s) - 1})


def edge(lane: Draft, side: float) -> Floats:
    """(P, 2) a lane's edge: side +1 left, -1 right."""
    points = lane.points[:, :2]
    tangent = np.gradient(points, axis=0)
    tangent /= np.maximum(np.hypot(*tangent.T), 1e-9)[:, None]
    return points + side * lane.width / 2 * np.column_stack([-tangent[:, 1], tangent[:, 0]])


def rim(network: Network, crossing: Crossing) -> list[tuple[Arm, int | None]]:
    """The arms counter-clockwise, each with the outermost connector to the next one: the junction's kerb."""
    bearings = []
    for arm in crossing.arms:
        ends = [outward(network, n, True)[0] for n in arm.incoming]
        ends += [outward(network, n, False)[0] for n in arm.outgoing]
        middle = np.mean(ends, axis=0) - crossing.centre
        bearings.append(float(np.arctan2(middle[1], middle[0])))
    order = [crossing.arms[i] for i in np.argsort(bearings)]
    kerbs: list[tuple[Arm, int | None]] = []
    for position, arm in enumerate(order):
        following = order[(position + 1) % len(order)]
        between = [
            n
            for n in crossing.connectors
            if set(network.lanes[n].predecessors) & set(arm.incoming)
            and set(network.lanes[n].successors) & set(following.outgoing)
        ]
        kerbs.append((arm, max(between, key=lambda n: _outness(network, arm, n)) if between else None))
    return kerbs


def _outness(network: Network, arm: Arm, connector: int) -> float:
    """How far right a connector begins and ends: metres, summed."""
    lane = network.lanes[connector]
    first, last = lane.headings
    start, end = lane.points[0], lane.points[-1]
    reference = network.lanes[arm.incoming[0]].points[-1]
    return float(
        (start - reference)[:2] @ (np.sin(first), -np.cos(first))
        + (end - reference)[:2] @ (np.sin(last), -np.cos(last))
    )


def _floor(shapes: Shapes, network: Network, crossing: Crossing) -> Iterator[Floats]:
    """Triangles from a junction's middle to its kerb."""
    lanes = network.lanes
    kerb: list[Floats] = []
    for arm, connector in rim(network, crossing):
        if arm.outgoing:
            kerb.append(_verge_point(shapes, lanes, arm.outgoing, 0))
        if connector is not None:
            first = max((_spare(shapes, lanes[n], -1) for n in lanes[connector].predecessors), default=0.0)
            last = max((_spare(shapes, lanes[n], 0) for n in lanes[connector].successors), default=0.0)
            kerb.append(_coarse(_kerb(lanes[connector], first, last)))
        elif arm.incoming:
            kerb.append(_verge_point(shapes, lanes, arm.incoming, -1))
    if not kerb:
        return
    points = np.concatenate(kerb)
    middle = np.array(crossing.centre)
    if len(points) < 3 or float(np.hypot(*(points - middle).T).max()) > WIDEST_FLOOR:
        return
    for first_point, last_point in zip(points, np.roll(points, -1, axis=0), strict=True):
        if np.hypot(*(last_point - first_point)) > THINNEST:
            yield np.array([middle, first_point, last_point])


def _verge_point(shapes: Shapes, lanes: list[Draft], side: tuple[int, ...], end: int) -> Floats:
    """(1, 2) the outer edge of asphalt where an arm's lanes start (0) or end (-1)."""
    outer = min(side, key=lambda n: _spare(shapes, lanes[n], end))
    lane = lanes[outer]
    return edge(lane, -1 - 2 * _spare(shapes, lane, end) / lane.width)[[end]]


def _spare(shapes: Shapes, lane: Draft, end: int) -> float:
    """Metres of asphalt to the right of a lane at its start (0) or end (-1): shoulder, parking."""
    road, index, number = lane.keys[end]
    shape = shapes[road, index]
    at = end if number < 0 else -1 - end
    side = [n for n in paved_lanes(shape) if n * number > 0]
    return float(abs(shape.edges[max(side, key=abs)][at] - shape.edges[number][at])) if side else 0.0


def _kerb(lane: Draft, first: float, last: float) -> Floats:
    """(P, 2) the right edge of a connector, out by `first` metres at its start and `last` at its end.

    In a tight bend to the right it stays where it does not fold.
    """
    points = lane.points[:, :2]
    steps = np.diff(points, axis=0)
    length = np.hypot(*steps.T)
    s = np.concatenate([[0.0], np.cumsum(length)])
    turned = float(np.unwrap(np.arctan2(steps[:, 1], steps[:, 0]))[[0, -1]] @ (1.0, -1.0))
    room = 0.7 * s[-1] / turned if turned > 0.2 else np.inf
    out = lane.width / 2 + first + (last - first) * s / max(s[-1], 1e-9)
    out = np.minimum(out, max(room, lane.width / 2))
    tangent = np.gradient(points, axis=0)
    tangent /= np.maximum(np.hypot(*tangent.T), 1e-9)[:, None]
    return points + out[:, None] * np.column_stack([tangent[:, 1], -tangent[:, 0]])


def _coarse(points: Floats) -> Floats:
    """Every point at which the line has turned by 8 degrees, and both ends."""
    steps = np.diff(points, axis=0)
    angle = np.unwrap(np.arctan2(steps[:, 1], steps[:, 0]))
    inner = np.flatnonzero(np.diff(np.floor(np.abs(angle - angle[0]) / MOST_TURN)) != 0) + 1
    return points[sorted({0, *(int(i) for i in inner), len(points) - 1})]

"""Crosswalks: those of the file, and one across each arm of a signalised junction that has none."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from me3bev_plugins.simulator.highway.opendrive.blocks import Shapes
from me3bev_plugins.simulator.highway.opendrive.footprint import rectangle
from me3bev_plugins.simulator.highway.opendrive.junctions import Arm, Crossing, outward
from me3bev_plugins.simulator.highway.opendrive.lanes import Network
from me3bev_plugins.simulator.highway.opendrive.records import Document, ObjectRecord, Road
from me3bev_plugins.simulator.highway.opendrive.sidewalks import has_sidewalk, verge
from me3bev_plugins.simulator.highway.town import Crosswalk, Floats

DEPTH = 3.0
"""Metres from one edge of a placed crosswalk to the other, along the road."""
BEYOND = 2.2
"""Metres from the stop line to the middle of a placed crosswalk."""
STAGGER = 8.0
"""Metres; an arm whose lanes end further apart gets no crosswalk."""
LEVEL = 2.5
"""Metres of height beyond which two things do not meet."""

Segments = tuple[Floats, Floats, Floats, Floats]
"""Start (P, 3), end (P, 3), arc length at the start (P,) and lane (P,) of every piece of centre line."""


def find_crosswalks(
    document: Document, shapes: Shapes, network: Network, crossings: list[Crossing]
) -> tuple[Crosswalk, ...]:
    """All crosswalks that cross at least one lane."""
    segments = _segments(network)
    owner = {n: i for i, crossing in enumerate(crossings) for n in crossing.connectors}
    for index, crossing in enumerate(crossings):
        for n in (*crossing.incoming, *crossing.outgoing):
            owner.setdefault(n, index)
    found = []
    for road in document.roads.values():
        for item in road.objects:
            if item.type == "crosswalk":
                corners, level = _outline(road, item)
                walk = _crosswalk(corners, level, segments, network, owner)
                if walk is not None:
                    found.append(walk)
    served = {walk.junction for walk in found}
    for index, crossing in enumerate(crossings):
        if crossing.control == "signal" and index not in served:
            for corners, level in _placed(document, shapes, network, crossing):
                walk = _crosswalk(corners, level, segments, network, owner)
                if walk is not None:
                    found.append(walk)
    return tuple(found)


def _segments(network: Network) -> Segments:
    lanes = network.lanes
    start = np.concatenate([lane.points[:-1] for lane in lanes])
    end = np.concatenate([lane.points[1:] for lane in lanes])
    s = [np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(lane.points[:, :2], axis=0).T))[:-1]]) for lane in lanes]
    lane = np.repeat(np.arange(len(lanes)), [len(lane.points) - 1 for lane in lanes])
    return start, end, np.concatenate(s), lane.astype(np.float64)


def _outline(road: Road, item: ObjectRecord) -> tuple[Floats, float]:
    """(4, 2) corners in the world and their height."""
    x, y, heading, _ = (float(v[0]) for v in road.line.at(np.array([item.s])))
    centre = np.array([x - item.t * np.sin(heading), y + item.t * np.cos(heading)])
    turn = heading + item.heading
    level = float(road.elevation(np.array([item.s]))[0]) + item.z
    if len(item.corners) < 3:
        return rectangle(centre, (max(item.length, 1.0), max(item.width, 1.0)), turn), level
    rotation = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    corners = np.array(item.corners)
    if len(corners) > 3 and np.hypot(*(corners[0] - corners[-1])) < 0.05:
        corners = corners[:-1]
    world = centre + corners @ rotation
    return (world if len(world) == 4 else _box(world)), level


def _box(points: Floats) -> Floats:
    """The box of least area around points, trying the direction of each edge."""
    best: tuple[float, Floats] | None = None
    for step in np.roll(points, -1, axis=0) - points:
        length = np.hypot(*step)
        if length < 0.05:
            continue
        axis = step / length
        frame = np.array([axis, [-axis[1], axis[0]]])
        local = points @ frame.T
        low, high = local.min(0), local.max(0)
        area = float(np.prod(high - low))
        if best is None or area < best[0]:
            corners = np.array([[low[0], low[1]], [high[0], low[1]], [high[0], high[1]], [low[0], high[1]]])
            best = area, corners @ frame
    return best[1] if best is not None else rectangle(points[0], (1.0, 1.0), 0.0)


def _crosswalk(
    corners: Floats, level: float, segments: Segments, network: Network, owner: dict[int, int]
) -> Crosswalk | None:
    """The crosswalk with the lanes it crosses, its corners turned so that people walk across them."""
    start, end, s, lane = segments
    middle = corners.mean(0)
    reach = float(np.hypot(*(corners - middle).T).max()) + 1.0
    near = np.flatnonzero((np.hypot(*(start[:, :2] - middle).T) < reach) & (np.abs(start[:, 2] - level) < LEVEL))
    enters, inside = _clip(start[near, :2], end[near, :2], corners)
    lanes: dict[int, float] = {}
    direction = np.zeros(2)
    for index, share in zip(near[inside], enters[inside], strict=True):
        step = end[index, :2] - start[index, :2]
        turn = 2 * np.arctan2(step[1], step[0])  # Doubled, so that opposite directions agree.
        direction += np.hypot(*step) * np.array([np.cos(turn), np.sin(turn)])
        lanes.setdefault(int(lane[index]), float(s[index] + share * np.hypot(*step)))
    if not lanes:
        return None
    along = np.arctan2(direction[1], direction[0]) / 2
    walk = (corners[2] + corners[3] - corners[0] - corners[1]) / 2
    other = (corners[3] + corners[0] - corners[1] - corners[2]) / 2
    traffic = np.array([np.cos(along), np.sin(along)])
    if abs(walk @ traffic) * np.hypot(*other) > abs(other @ traffic) * np.hypot(*walk):
        corners = np.roll(corners, -1, axis=0)
    junctions = [owner[n] for n in lanes if n in owner and (network.lanes[n].junction is not None)]
    junctions = junctions or [owner[n] for n in lanes if n in owner and _near_end(network, n, lanes[n])]
    return Crosswalk(corners, tuple(sorted(lanes.items())), junctions[0] if junctions else None)


def _near_end(network: Network, lane: int, s: float) -> bool:
    length = network.lanes[lane].length
    return bool(min(s, length - s) < 25.0)


def _clip(start: Floats, end: Floats, corners: Floats) -> tuple[Floats, np.ndarray]:
    """Share of each segment at which it enters a convex polygon, and whether it does."""
    step = end - start
    enters, leaves = np.zeros(len(start)), np.ones(len(start))
    outside = np.zeros(len(start), bool)
    following = np.roll(corners, -1, axis=0)
    area = float((corners[:, 0] * following[:, 1] - corners[:, 1] * following[:, 0]).sum())
    for a, b in zip(corners, following, strict=True):
        normal = np.array([b[1] - a[1], a[0] - b[0]]) * (1.0 if area > 0 else -1.0)  # Points outwards.
        distance, rate = (start - a) @ normal, step @ normal
        outside |= (np.abs(rate) < 1e-12) & (distance > 0)
        share = -distance / np.where(np.abs(rate) < 1e-12, 1.0, rate)
        enters = np.where(rate < -1e-12, np.maximum(enters, share), enters)
        leaves = np.where(rate > 1e-12, np.minimum(leaves, share), leaves)
    return enters, ~outside & (enters < leaves)


def _placed(document: Document, shapes: Shapes, network: Network, crossing: Crossing) -> Iterator[tuple[Floats, float]]:
    """Corners and height of a crosswalk just past the stop line of each street with a sidewalk."""
    for arm in crossing.arms:
        corners = _across(document, shapes, network, arm)
        if corners is not None:
            lane = (*arm.incoming, *arm.outgoing)[0]
            yield corners, float(network.lanes[lane].points[-1 if arm.incoming else 0, 2])


def _across(document: Document, shapes: Shapes, network: Network, arm: Arm) -> Floats | None:
    ends = [(n, True) for n in arm.incoming] + [(n, False) for n in arm.outgoing]
    if any(network.lanes[n].highway for n, _ in ends):
        return None
    poses = [outward(network, n, inward) for n, inward in ends]
    away = np.array([np.mean([np.cos(h) for _, h in poses]), np.mean([np.sin(h) for _, h in poses])])
    away /= max(float(np.hypot(*away)), 1e-9)
    aside = np.array([-away[1], away[0]])
    depth = [float(p @ away) for p, _ in poses]
    if max(depth) - min(depth) > STAGGER:
        return None
    reach: list[float] = []
    walkable = False
    for n, inward in ends:
        road, index, number = network.lanes[n].keys[-1 if inward else 0]
        shape = shapes[road, index]
        at = -1 if (number < 0) == inward else 0
        for sign in (1, -1):
            walkable = walkable or has_sidewalk(shape, sign)
            reach.append(float(shape.line(verge(shape, sign))[at, :2] @ aside))
    if not walkable:
        return None
    low, high = min(reach) - 0.6, max(reach) + 0.6
    middle = away * (min(depth) - BEYOND) + aside * (low + high) / 2
    return rectangle(middle, (high - low, DEPTH), float(np.arctan2(aside[1], aside[0])))

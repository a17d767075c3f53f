"""What lies on a town's ground, as polygons in painting order: asphalt, sidewalks, lines, crosswalks."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from me3bev_plugins.simulator.highway.ground_tiles import Paint
from me3bev_plugins.simulator.highway.town import Crosswalk, Lane, Town

Floats = NDArray[np.float64]

LINE = 0.15
"""Width of lane lines, metres."""
STOP_LINE = 0.5
DASH, PERIOD = 3.0, 9.0
"""Broken lines: 3 m on, 6 m off."""
STRIPE = 0.5
"""Width of a crosswalk's stripes and of the gaps between them, metres."""

Painted = tuple[Floats, Paint, Floats | None]
"""Polygons (N, K, 2) of one class, metres, and the height of each (N,) where it is known."""


def lane_polygons(town: Town) -> Iterator[Painted]:
    """Asphalt under lanes."""
    for lane in town.lanes:
        half = 0.5 * lane.width + 0.1
        yield strip(lane.points[:, :2], -half, half), Paint.ASPHALT, _heights(lane)


def base_polygons(town: Town) -> Iterator[Painted]:
    """What lies under the lanes: sidewalks and roadside paths, then wider asphalt."""
    for walk in town.sidewalks:
        if len(walk.points) > 1:
            code = Paint.SIDEWALK if walk.paved else Paint.PATH
            yield strip(walk.points, -0.5 * walk.width, 0.5 * walk.width), code, None
    for surface in town.surfaces:
        if len(surface) > 2:
            yield surface[None, :, :2], Paint.ASPHALT, None


def line_polygons(town: Town) -> Iterator[Painted]:
    """Lane lines, then stop lines, then crosswalks."""
    for lane in town.lanes:
        yield from _edge_lines(town, lane)
    stopping = {n for signal in town.signals for n in signal.lanes} | {s.lane for s in town.signs if s.kind == "stop"}
    for lane in town.lanes:
        if lane.id in stopping:
            yield _stop_line(lane)[None], Paint.ZEBRA, lane.points[-1:, 2]
    for crosswalk in town.crosswalks:
        yield from _crosswalk(crosswalk)


def strip(points: Floats, low: float, high: float) -> Floats:
    """Quads (P - 1, 4, 2) between the lines `low` and `high` metres left of a polyline (P, 2)."""
    edges = [offset_line(points, side) for side in (low, high)]
    return np.stack([edges[0][:-1], edges[0][1:], edges[1][1:], edges[1][:-1]], axis=1)


def offset_line(points: Floats, left: float) -> Floats:
    """The polyline (P, 2) moved `left` metres to its left."""
    step = np.diff(points, axis=0)
    step /= np.maximum(np.hypot(step[:, 0], step[:, 1]), 1e-9)[:, None]
    tangent = np.concatenate([step[:1], step[:-1] + step[1:], step[-1:]])
    tangent /= np.maximum(np.hypot(tangent[:, 0], tangent[:, 1]), 1e-9)[:, None]
    return points + left * np.stack([-tangent[:, 1], tangent[:, 0]], axis=1)


def _heights(lane: Lane) -> Floats:
    """Of each piece between two points."""
    z = lane.points[:, 2]
    return np.asarray(0.5 * (z[1:] + z[:-1]))


def _edge_lines(town: Town, lane: Lane) -> Iterator[Painted]:
    sides = ((lane.left_marking, 1.0, lane.left), (lane.right_marking, -1.0, lane.right))
    for marking, side, neighbour in sides:
        if marking == "none":
            continue
        # A line between two lanes of one direction is named by both: the left lane paints it.
        if side > 0 and neighbour is not None and town.lanes[neighbour].right_marking != "none":
            continue
        yellow = marking.startswith("yellow")
        inward = 0.16 if yellow and marking.endswith("solid") else 0.0
        edge = offset_line(lane.points[:, :2], side * (0.5 * lane.width - inward))
        code = Paint.YELLOW if yellow else Paint.WHITE
        if marking.endswith("solid"):
            yield strip(edge, -0.5 * LINE, 0.5 * LINE), code, _heights(lane)
        else:
            for dash, share in _dashes(edge):
                height = float(np.interp(share * lane.length, lane.s, lane.points[:, 2]))
                yield dash, code, np.full(len(dash), height)


def _dashes(edge: Floats) -> Iterator[tuple[Floats, float]]:
    """Dashes and where along the line each is (0..1).

    Placed symmetrically about the line's middle, so that both directions paint the same ones.
    """
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(edge, axis=0).T))])
    middle = 0.5 * along[-1]
    count = int(middle // PERIOD) + 1
    for k in range(-count, count + 1):
        first, last = np.clip(middle + k * PERIOD + np.array([-0.5, 0.5]) * DASH, 0.0, along[-1])
        if last - first > 0.3:
            at = np.linspace(first, last, 4)
            dash = np.stack([np.interp(at, along, edge[:, 0]), np.interp(at, along, edge[:, 1])], axis=1)
            yield strip(dash, -0.5 * LINE, 0.5 * LINE), float(0.5 * (first + last) / along[-1])


def _stop_line(lane: Lane) -> Floats:
    """The corners (4, 2) of the line across the lane's end."""
    end = lane.points[-1, :2]
    along = np.array([np.cos(lane.heading[-1]), np.sin(lane.heading[-1])])
    left = np.array([-along[1], along[0]]) * (0.5 * lane.width - 0.15)
    back = end - STOP_LINE * along
    return np.array([back - left, end - left, end + left, back + left])


def _crosswalk(crosswalk: Crosswalk) -> Iterator[Painted]:
    """The whole crossing as gap, then stripes along the direction of traffic."""
    c = crosswalk.corners
    yield c[None], Paint.ZEBRA_GAP, None
    length = 0.5 * (np.hypot(*(c[2] - c[1])) + np.hypot(*(c[3] - c[0])))
    count = max(1, round((length - STRIPE) / (2 * STRIPE)))
    width = 1.0 / (2 * count + 1)
    share = (2 * np.arange(count + 1)[:, None] + np.array([0.0, 1.0])) * width
    first = c[0] + share[..., None] * (c[3] - c[0])
    second = c[1] + share[..., None] * (c[2] - c[1])
    yield np.stack([first[:, 0], first[:, 1], second[:, 1], second[:, 0]], axis=1), Paint.ZEBRA, None

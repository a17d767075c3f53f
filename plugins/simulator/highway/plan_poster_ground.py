"""The ground of a town's plan: greenery, houses, sidewalks, roads by their limit, markings, arrows, bridges."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import EllipseCollection, LineCollection, PolyCollection
from matplotlib.colors import to_rgb

from me3bev_plugins.simulator.highway.ground_levels import find_levels
from me3bev_plugins.simulator.highway.ground_paint import offset_line
from me3bev_plugins.simulator.highway.plan_poster import POINTS, Frame
from me3bev_plugins.simulator.highway.town import Floats, Lane, Marking, Town

ASPHALT, DECK_EDGE = "#50545c", "#1d2026"
SIDEWALK, PATH, TREE, HOUSE = "#c6c4bd", "#d9c48f", "#b3cc9c", "#cdbfae"
LIMITS = (
    (30.5, "#2f9e8f"),
    (40.5, "#6aa84f"),
    (50.5, "#c9a227"),
    (60.5, "#d9822b"),
    (80.5, "#cc5a3a"),
    (np.inf, "#a8324a"),
)
"""Colour of a road by its limit: up to so many km/h."""
NEAR_BRIDGE = 45.0
"""Metres around a crossing on two levels within which the upper road is drawn as a bridge."""
ARROW = 4.5
"""Metres of an arrow's length, at least `ARROW_PIXELS`; one every `ARROW_GAP` pixels."""
ARROW_PIXELS, ARROW_GAP = 9.0, 85.0
MARKED = 1.9
"""Pixels per metre from which on markings are drawn as they are; below, only lines between lanes."""
GROUND, LOWER, UPPER = 1.0, 3.0, 5.0
"""Drawing order."""


def limit_colour(limit: float) -> str:
    """Of a road limited to so many m/s."""
    return next(colour for most, colour in LIMITS if limit * 3.6 < most)


def draw_ground(axes: Axes, town: Town, frame: Frame) -> None:
    """Everything that lies on the ground."""
    _surroundings(axes, town)
    axes.add_collection(PolyCollection([s[:, :2] for s in town.surfaces], facecolors=ASPHALT, zorder=GROUND + 0.5))
    below, above = split_levels(town)
    _roads(axes, frame, below, LOWER)
    for lane, points in above:
        for width, colour in ((lane.width + 3.6, "#00000026"), (lane.width + 1.8, DECK_EDGE)):
            axes.add_collection(PolyCollection([_strip(points, width)], facecolors=colour, zorder=UPPER - 1))
    _roads(axes, frame, above, UPPER)
    _crosswalks(axes, town)


Piece = tuple[Lane, Floats]
"""A lane and the part of its points (P, 3) on one level."""


def split_levels(town: Town) -> tuple[list[Piece], list[Piece]]:
    """The parts of lanes that lie on the ground, and those that pass over others, with their ramps' nearest ends."""
    sites = find_levels(town).sites
    below: list[Piece] = []
    above: list[Piece] = []
    for lane in town.lanes:
        up = np.zeros(len(lane.points), bool)
        if len(sites):
            away = np.hypot(*(lane.points[:, None, :2] - sites[None, :, :2]).transpose(2, 0, 1))
            nearest = away.argmin(axis=1)
            up = (away.min(axis=1) < NEAR_BRIDGE) & (lane.points[:, 2] > sites[nearest, 2])
        cuts = [0, *(np.flatnonzero(np.diff(up.astype(int))) + 1), len(up) - 1]
        for first, last in pairwise(cuts):
            if last > first:
                (above if up[first] else below).append((lane, lane.points[first : last + 1]))
    return below, above


def _surroundings(axes: Axes, town: Town) -> None:
    trees = [prop for prop in town.props if prop.kind == "tree"]
    sizes = np.array([2 * tree.radius + 2.0 for tree in trees])
    if trees:
        places = [tree.position for tree in trees]
        crowns = EllipseCollection(
            sizes, sizes, np.zeros(len(trees)), units="xy", offsets=places, facecolors=TREE, zorder=GROUND
        )
        crowns.set_offset_transform(axes.transData)
        axes.add_collection(crowns)
    walks = [_strip(walk.points, walk.width) for walk in town.sidewalks]
    colours = [SIDEWALK if walk.paved else PATH for walk in town.sidewalks]
    axes.add_collection(PolyCollection(walks, facecolors=colours, zorder=GROUND + 0.2))
    houses = [_box(b.centre, b.size, b.heading) for b in town.buildings]
    shade = [0.45 * np.array(to_rgb(HOUSE)) + 0.55 * np.array(b.colour) / 255 for b in town.buildings]
    axes.add_collection(
        PolyCollection(houses, facecolors=shade, edgecolors="#8d8274", linewidths=0.5, zorder=GROUND + 0.3)
    )


def _box(centre: tuple[float, float], size: tuple[float, float], heading: float) -> Floats:
    along, left = np.array([np.cos(heading), np.sin(heading)]), np.array([-np.sin(heading), np.cos(heading)])
    half = np.array([[1, 1], [1, -1], [-1, -1], [-1, 1]]) * np.array(size) / 2
    return np.asarray(np.array(centre) + half[:, :1] * along + half[:, 1:] * left)


def _strip(points: Floats, width: float) -> Floats:
    """The outline (2 P, 2) of a strip along a line."""
    return np.concatenate([offset_line(points[:, :2], width / 2), offset_line(points[:, :2], -width / 2)[::-1]])


def _roads(axes: Axes, frame: Frame, pieces: Sequence[Piece], order: float) -> None:
    """Asphalt, colours, markings and arrows of one level."""
    inside = [(lane, points) for lane, points in pieces if lane.junction is not None]
    roads = [(lane, points) for lane, points in pieces if lane.junction is None]
    asphalt = [_strip(points, lane.width + 0.3) for lane, points in pieces]
    axes.add_collection(PolyCollection(asphalt, facecolors=ASPHALT, zorder=order))
    shapes = [_strip(points, lane.width) for lane, points in roads]
    colours = [limit_colour(lane.limit) for lane, _ in roads]
    # The edge closes the hairline between a lane and the next.
    axes.add_collection(
        PolyCollection(shapes, facecolors=colours, edgecolors=colours, linewidths=0.3, zorder=order + 0.1)
    )
    guides = [points[:, :2] for _, points in inside]
    axes.add_collection(
        LineCollection(guides, colors="#aab0ba", linewidths=frame.line(0.12, 0.5), alpha=0.55, zorder=order + 0.2)
    )
    _markings(axes, frame, roads, order + 0.3)
    arrows = [arrow for lane, points in roads for arrow in _arrows(lane, points, frame)]
    axes.add_collection(PolyCollection(arrows, facecolors="white", alpha=0.92, zorder=order + 0.4))


def _markings(axes: Axes, frame: Frame, roads: Sequence[Piece], order: float) -> None:
    """Lines between lanes and at the edges, in their colour and pattern."""
    lines: dict[Marking, list[Floats]] = {}
    for lane, points in roads:
        lines.setdefault(lane.right_marking, []).append(offset_line(points[:, :2], -lane.width / 2))
        if lane.left is None:
            lines.setdefault(lane.left_marking, []).append(offset_line(points[:, :2], lane.width / 2))
    width = frame.line(0.15, 0.7)
    for marking in [kind for kind in lines if kind != "none"]:
        colour = "#f2c94c" if "yellow" in marking else "white"
        dash, gap = (metres * frame.scale * POINTS / width for metres in (3.0, 6.0))
        broken = "broken" in marking and frame.scale >= MARKED
        style = (0, (dash, gap)) if broken else "solid"
        faint = 0.5 if "broken" in marking and not broken else 0.9
        axes.add_collection(
            LineCollection(
                lines[marking],
                colors=colour,
                linewidths=width,
                linestyles=[style],
                alpha=faint,
                capstyle="butt",
                zorder=order,
            )
        )


def _arrows(lane: Lane, points: Floats, frame: Frame) -> Iterator[Floats]:
    """Arrows along a lane, in its direction."""
    length = max(ARROW, ARROW_PIXELS / frame.scale)
    half = min(0.32 * length, 0.42 * lane.width)
    s = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points[:, :2], axis=0).T))])
    if s[-1] < 1.6 * length:
        return
    count = max(1, round(s[-1] * frame.scale / ARROW_GAP))
    for at in (np.arange(count) + 0.5) / count * s[-1]:
        (x0, x1), (y0, y1) = (np.interp([at - length / 2, at + length / 2], s, points[:, k]) for k in (0, 1))
        along = np.array([x1 - x0, y1 - y0])
        along /= max(float(np.hypot(*along)), 1e-9)
        left, tip = np.array([-along[1], along[0]]) * half, np.array([x1, y1])
        shaft, neck, tail = 0.28 * left, tip - 0.55 * length * along, tip - length * along
        yield np.array([tip, neck + left, neck + shaft, tail + shaft, tail - shaft, neck - shaft, neck - left])


def _crosswalks(axes: Axes, town: Town) -> None:
    """Zebra stripes."""
    stripes = []
    for crosswalk in town.crosswalks:
        a, b, c, d = crosswalk.corners
        # People walk from edge ab to edge cd; stripes lie across that way.
        walk = float(np.hypot(*((c + d) / 2 - (a + b) / 2)))
        count = max(2, round(walk / 1.2))
        for k in range(count):
            low, high = (k + 0.2) / count, (k + 0.75) / count
            stripes.append(np.array([a + low * (d - a), b + low * (c - b), b + high * (c - b), a + high * (d - a)]))
    axes.add_collection(PolyCollection(stripes, facecolors="white", alpha=0.9, zorder=LOWER + 0.6))

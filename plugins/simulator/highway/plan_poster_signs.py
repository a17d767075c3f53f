"""What is put on top of a town's plan: junction outlines, lights, signs, heights of bridges, a route."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.path import Path
from matplotlib.patheffects import withStroke
from matplotlib.transforms import ScaledTranslation

from me3bev_plugins.simulator.highway.ground_levels import find_levels
from me3bev_plugins.simulator.highway.plan_poster import Frame
from me3bev_plugins.simulator.highway.routes import Route
from me3bev_plugins.simulator.highway.town import Floats, Junction, Town

OUTLINE, INK = "#2b2f6b", "#22252b"
ROUTE, START, END = "#1565ff", "#16a34a", "#dc2626"
LAMPS = (("#ef4444", 1), ("#f6b73c", 0), ("#22c55e", -1))
"""Colour and place of a signal head's lamps, from above."""
STOP, YIELD = "#c81e1e", "#d97706"
SITE = 40.0
"""Metres; crossings on two levels nearer to each other are one place."""
HILL, APART = 2.0, 120.0
"""Least height of a hilltop that is labelled, and distance from another, metres."""
RAMPS = 200.0
"""Metres around a bridge within which heights are those of its ramps."""
ON_TOP = 10.0
"""Drawing order."""


def draw_signs(axes: Axes, town: Town, frame: Frame) -> None:
    """Junction outlines, traffic lights, stop and yield signs, heights of bridges."""
    outlines = [outline(town, junction) for junction in town.junctions if junction.connectors]
    axes.add_collection(
        PolyCollection(
            outlines,
            facecolors="none",
            edgecolors=OUTLINE,
            linewidths=1.0,
            linestyles=(0, (4, 2)),
            alpha=0.75,
            zorder=ON_TOP,
        )
    )
    size = symbol_size(frame)
    for kind, marker, face, edge in (("stop", "8", STOP, "white"), ("yield", "v", "white", STOP)):
        places = np.array([sign.position[:2] for sign in town.signs if sign.kind == kind]).reshape(-1, 2)
        axes.scatter(
            places[:, 0],
            places[:, 1],
            s=size**2,
            marker=marker,
            c=face,
            edgecolors=edge,
            linewidths=1.1,
            zorder=ON_TOP + 1,
        )
    lights = np.array([signal.position[:2] for signal in town.signals]).reshape(-1, 2)
    draw_lights(axes, lights, size)
    for x, y, rise in bridges(town):
        axes.annotate(
            f"bridge, {rise:+.0f} m",
            (x, y),
            (0, 14),
            textcoords="offset points",
            ha="center",
            va="bottom",
            size=9,
            color=INK,
            bbox={"boxstyle": "round,pad=0.25", "facecolor": "white", "edgecolor": INK, "alpha": 0.85},
            zorder=ON_TOP + 3,
        )
    for x, y, z in hilltops(town):
        axes.annotate(
            f"{z:.0f} m",
            (x, y),
            (9, 6),
            textcoords="offset points",
            size=9,
            color=INK,
            path_effects=[withStroke(linewidth=2.5, foreground="white")],
            zorder=ON_TOP + 3,
        )
        axes.scatter([x], [y], s=30, marker="^", c=INK, edgecolors="white", linewidths=0.8, zorder=ON_TOP + 3)


def symbol_size(frame: Frame) -> float:
    """Points across a symbol: larger where there is room."""
    return float(np.clip(4.0 * frame.scale, 6.5, 11.0))


def draw_lights(axes: Axes, places: Floats, size: float) -> None:
    """Signal heads: upright boxes with three lamps, on places (N, 2) of the axes' data."""
    if axes.figure is None or not len(places):
        return
    axes.scatter(
        places[:, 0],
        places[:, 1],
        s=(1.35 * size) ** 2,
        marker=_BAR,
        c="#15171b",
        edgecolors="white",
        linewidths=0.6,
        zorder=12,
    )
    for colour, row in LAMPS:
        shift = ScaledTranslation(0, row * 0.38 * size / 72, axes.figure.dpi_scale_trans)
        axes.scatter(
            places[:, 0],
            places[:, 1],
            s=(0.34 * size) ** 2,
            c=colour,
            linewidths=0,
            zorder=13,
            transform=axes.transData + shift,
        )


_BAR = Path([(-0.42, -1.0), (0.42, -1.0), (0.42, 1.0), (-0.42, 1.0), (-0.42, -1.0)], closed=True)


def outline(town: Town, junction: Junction) -> Floats:
    """The convex outline (P, 2) of a junction's lanes."""
    corners = []
    for number in junction.connectors:
        lane = town.lanes[number]
        half = 0.5 * lane.width + 0.6
        points, heading = lane.points[:, :2], lane.heading
        left = np.column_stack([-np.sin(heading), np.cos(heading)])
        corners += [points + half * left, points - half * left]
    return convex_hull(np.concatenate(corners))


def convex_hull(points: Floats) -> Floats:
    """Corners (H, 2) of the hull of points (N, 2), counter-clockwise (Andrew's monotone chain)."""
    ordered = np.unique(points, axis=0)

    def chain(run: Floats) -> list[Floats]:
        kept: list[Floats] = []
        for point in run:
            while len(kept) > 1 and _cross(kept[-1] - kept[-2], point - kept[-2]) <= 0:
                kept.pop()
            kept.append(point)
        return kept[:-1]

    return np.array(chain(ordered) + chain(ordered[::-1]))


def _cross(a: Floats, b: Floats) -> float:
    return float(a[0] * b[1] - a[1] * b[0])


def bridges(town: Town) -> list[tuple[float, float, float]]:
    """(x, y, metres above the road below) of every place where roads cross above one another."""
    left = find_levels(town).sites
    found = []
    while len(left):
        frontier, left = left[:1], left[1:]
        members = [frontier]
        while len(frontier):
            near = (np.linalg.norm(left[:, None, :2] - frontier[None, :, :2], axis=2) < SITE).any(axis=1)
            frontier, left = left[near], left[~near]
            members.append(frontier)
        x, y, middle = np.concatenate(members).mean(axis=0)
        beside = np.hypot(*(town.arrays.xyz[:, :2] - (x, y)).T) < SITE
        z = town.arrays.xyz[beside, 2]
        found.append((float(x), float(y), float(np.median(z[z > middle]) - np.median(z[z <= middle]))))
    return found


def hilltops(town: Town) -> list[tuple[float, float, float]]:
    """(x, y, z) of the highest points of roads, away from bridges."""
    tops: list[tuple[float, float, float]] = []
    near = np.array([(x, y) for x, y, _ in bridges(town)]).reshape(-1, 2)
    xyz = town.arrays.xyz
    for x, y, z in xyz[np.argsort(-xyz[:, 2], kind="stable")]:
        if z < HILL:
            break
        ramps = (np.hypot(x - near[:, 0], y - near[:, 1]) < RAMPS).any()
        if not ramps and all(np.hypot(x - a, y - b) > APART for a, b, _ in tops):
            around = np.hypot(xyz[:, 0] - x, xyz[:, 1] - y) < APART
            if z >= xyz[around, 2].max() - 0.01:
                tops.append((float(x), float(y), float(z)))
    return tops


def draw_route(axes: Axes, route: Route, frame: Frame) -> None:
    """The part of a route that is to be driven, from A to B."""
    s = np.append(np.arange(0.0, route.length, 1.0), route.length)
    path = route.positions(s)[:, :2]
    edge = withStroke(linewidth=frame.line(1.9, 7.5), foreground="white")
    axes.plot(*path.T, color=ROUTE, lw=frame.line(1.2, 4.5), solid_capstyle="round", path_effects=[edge], zorder=15)
    for (x, y), letter, colour in ((path[0], "A", START), (path[-1], "B", END)):
        axes.scatter([x], [y], s=17**2, c=colour, edgecolors="white", linewidths=1.5, zorder=16)
        axes.text(x, y, letter, size=10, weight="bold", color="white", ha="center", va="center_baseline", zorder=17)

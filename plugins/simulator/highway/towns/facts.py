"""What a town is like in figures: lane kilometres, junctions by kind, limits, widths, bends and blocks.

"Road" figures leave out what lies inside junctions. Shares and percentiles are by length.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass

import numpy as np

from me3bev_plugins.simulator.highway.ground_levels import find_levels
from me3bev_plugins.simulator.highway.town import Floats, Junction, Lane, Town
from me3bev_plugins.simulator.highway.towns.carriageways import Carriageways

STRAIGHT = 1e-3
"""1/m; less curvature than this is straight."""
MERGE = np.radians(70.0)
"""A junction whose turns are all below this is a merge."""
SHORTEST_BLOCK = 10.0
ROUNDABOUT_RADIUS = 40.0
SITE = 40.0
"""Metres; crossings on two levels nearer to each other are one place."""


@dataclass(frozen=True)
class Facts:
    """Measured figures of a town; lengths in metres unless named otherwise."""

    box: tuple[float, float]
    road_km: float
    connector_km: float
    intersections: dict[str, int]
    """By kind: "3", "4", "5" arms (or more), "merge", "roundabout", "pass" (two arms, no choice of way)."""
    signalised: int
    lanes_per_direction: dict[int, float]
    posted_kmh: dict[int, float]
    width: tuple[float, float, float]
    """5th, 50th and 95th percentile."""
    straight: float
    """Share of road lanes that are straight."""
    bend_radius: float
    """Median over the curved part."""
    block: tuple[float, float, float]
    """10th, 50th and 90th percentile from junction to junction, one for each direction of a road."""
    z: tuple[float, float]
    """Lowest and highest lane."""
    furniture: dict[str, int]
    """How many "light" (heads), "stop", "yield" (signs) and "crosswalk"."""
    levels: int
    """Places where roads cross above one another."""

    @property
    def lane_km(self) -> float:
        """All driving lanes, inside junctions too."""
        return self.road_km + self.connector_km


def measure(town: Town) -> Facts:
    """The facts of a town."""
    roads = [lane for lane in town.lanes if lane.junction is None]
    inside = [lane for lane in town.lanes if lane.junction is not None]
    lengths = np.array([lane.length for lane in roads])
    x0, y0, x1, y1 = town.bounds
    lanes_each: dict[int, float] = defaultdict(float)
    ways = Carriageways(town)
    for number, group in enumerate(ways.lanes):
        lanes_each[len(group)] += ways.length(number)
    limits: dict[int, float] = defaultdict(float)
    for lane in roads:
        limits[round(lane.limit * 3.6)] += lane.length
    straight, radius = _bends(roads)
    z = np.concatenate([lane.points[:, 2] for lane in town.lanes])
    widths = np.array([lane.width for lane in roads])
    return Facts(
        box=(x1 - x0, y1 - y0),
        road_km=float(lengths.sum()) / 1000,
        connector_km=sum(lane.length for lane in inside) / 1000,
        intersections=_intersections(town, ways),
        signalised=sum(junction.control == "signal" for junction in town.junctions),
        lanes_per_direction=_shares(lanes_each),
        posted_kmh=_shares(limits),
        width=(_weighted(widths, lengths, 5), _weighted(widths, lengths, 50), _weighted(widths, lengths, 95)),
        straight=straight,
        bend_radius=radius,
        block=_blocks(town, ways),
        z=(float(z.min()), float(z.max())),
        furniture={
            "light": len(town.signals),
            "stop": sum(sign.kind == "stop" for sign in town.signs),
            "yield": sum(sign.kind == "yield" for sign in town.signs),
            "crosswalk": len(town.crosswalks),
        },
        levels=_level_sites(town),
    )


def _shares(lengths: dict[int, float]) -> dict[int, float]:
    total = sum(lengths.values())
    return {key: lengths[key] / total for key in sorted(lengths)}


def _weighted(values: Floats, weights: Floats, percent: float) -> float:
    order = np.argsort(values)
    reached = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(reached, percent / 100 * reached[-1])])


def _bends(roads: list[Lane]) -> tuple[float, float]:
    """Straight share and median radius of the rest."""
    run, bend = [], []
    for lane in roads:
        step = np.diff(lane.points[:, :2], axis=0)
        size = np.hypot(*step.T)
        heading = np.unwrap(np.arctan2(step[:, 1], step[:, 0]))
        between = (size[:-1] + size[1:]) / 2
        run.append(between)
        bend.append(np.abs(np.diff(heading)) / between)
    length, curvature = np.concatenate(run), np.concatenate(bend)
    curved = curvature > STRAIGHT
    if not curved.any():
        return 1.0, float("inf")
    return float(length[~curved].sum() / length.sum()), _weighted(1 / curvature[curved], length[curved], 50)


def _blocks(town: Town, ways: Carriageways) -> tuple[float, float, float]:
    """Percentiles of the length from junction to junction; a change of limit or a junction without choice ends none."""
    passes = {junction.id for junction in town.junctions if _kind(ways, junction) == "pass"}
    ahead = ways.ahead(passes)
    reached = {after for group in ahead for after in ahead[group]}
    found = []
    for group in range(len(ways.lanes)):
        if group in reached:
            continue
        length, at, seen = ways.length(group), group, {group}
        while follow := ahead.get(at, set()) - seen:
            at = min(follow, key=lambda n: -len(ways.lanes[n]))
            seen.add(at)
            length += ways.length(at)
        if length >= SHORTEST_BLOCK:
            found.append(length)
    p10, p50, p90 = np.percentile(found, [10, 50, 90]) if found else (0.0, 0.0, 0.0)
    return float(p10), float(p50), float(p90)


def _intersections(town: Town, ways: Carriageways) -> dict[str, int]:
    round_ones = _roundabouts(town)
    counts = {"3": 0, "4": 0, "5": 0, "merge": 0, "roundabout": len(round_ones), "pass": 0}
    ringed = {n for ring in round_ones for n in ring}
    for junction in town.junctions:
        if junction.id not in ringed:
            counts[_kind(ways, junction)] += 1
    return counts


def _kind(ways: Carriageways, junction: Junction) -> str:
    lanes = ways.town.lanes
    turns = [abs(lanes[n].heading[-1] - lanes[n].heading[0]) for n in junction.connectors]
    joined = {
        (int(ways.of[a]), int(ways.of[b]))
        for n in junction.connectors
        for a in lanes[n].predecessors
        for b in lanes[n].successors
    }
    if junction.arms < 3 and len(joined) == len({a for a, _ in joined}) == len({b for _, b in joined}):
        return "pass"
    if max(turns) < MERGE:
        return "merge"
    return str(min(max(junction.arms, 3), 5))


def _level_sites(town: Town) -> int:
    """Places where lanes lie above one another; those within `SITE` of each other are one."""
    left = find_levels(town).sites[:, :2]
    count = 0
    while len(left):
        frontier, left = left[:1], left[1:]
        while len(frontier):
            near = (np.linalg.norm(left[:, None] - frontier[None], axis=2) < SITE).any(axis=1)
            frontier, left = left[near], left[~near]
        count += 1
    return count


def _roundabouts(town: Town) -> list[set[int]]:
    """Sets of three or more junctions joined in a ring by short bends to the left."""
    onto: dict[int, int] = {}
    for junction in town.junctions:
        for n in junction.outgoing:
            lane = town.lanes[n]
            turned = float(lane.heading[-1] - lane.heading[0])
            ends = {town.lanes[m].junction for m in lane.successors} - {None, junction.id}
            if turned > 0.1 and lane.length / turned < ROUNDABOUT_RADIUS and lane.length < 60 and ends:
                onto[junction.id] = next(end for end in ends if end is not None)
    rings: list[set[int]] = []
    for start in onto:
        ring, at = [start], onto[start]
        while at in onto and at not in ring:
            ring.append(at)
            at = onto[at]
        if at == start and len(ring) > 2 and set(ring) not in rings:
            rings.append(set(ring))
    return rings

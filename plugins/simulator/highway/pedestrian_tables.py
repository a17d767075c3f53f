"""Where pedestrians walk and cross in a town: strips beside the roads, and the crossings that join them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from me3bev_plugins.simulator.highway.pedestrian_crossings import REACH, find_crossings
from me3bev_plugins.simulator.highway.pedestrian_ground import KERB, survey
from me3bev_plugins.simulator.highway.town import Ints, Sidewalk, Town
from me3bev_plugins.simulator.highway.traffic_grid import Grid
from me3bev_plugins.simulator.highway.traffic_records import CROSSING, EXIT, FOOTING, LINK, STRIP, Records

SPACING = 1.0
"""Between two points of a strip, metres."""
SHORTEST = 5.0
"""Shorter strips are not walked on, metres."""
JOIN = 3.5
"""Ends of strips as near as this are joined, metres."""


class Walks(NamedTuple):
    """The walkable part of a town."""

    strips: Records
    """(W,) `STRIP`"""
    footings: Records
    """(Q,) `FOOTING`: points of all strips."""
    exits: Records
    """(E,) `EXIT`, by strip and arc length."""
    crossings: Records
    """(C,) `CROSSING`"""
    met: Ints
    """Links of all crossings in one row; those of crossing c are `met[met0:met1]`."""
    signals: Ints
    """Signals that stop the traffic over a crossing, likewise."""


def build_walks(town: Town, lanes: Records, samples: Records, grid: Grid) -> tuple[Walks, NDArray]:
    """The walks and the links (K,) `LINK` between lanes and crossings; `lanes` is told which are whose."""
    strips, footings = _strips(town, lanes, samples, grid)
    if not len(strips):
        nobody = np.zeros(0, np.int32)
        return Walks(strips, footings, np.zeros(0, EXIT), np.zeros(0, CROSSING), nobody, nobody), np.zeros(0, LINK)
    crossings, met, signals, links = find_crossings(town, lanes, samples, grid, strips, footings)
    _join(strips, footings, samples, lanes, grid)
    return Walks(strips, footings, _exits(strips, crossings), crossings, met, signals), links


def _strips(town: Town, lanes: Records, samples: Records, grid: Grid) -> tuple[NDArray, NDArray]:
    """Evenly spaced points of all sidewalks, without those on a road."""
    pieces: list[NDArray] = []
    records: list[tuple[int, int, float, float]] = []
    first = 0
    for walk in (*town.sidewalks, *_landings(town)):
        s = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(walk.points, axis=0).T))])
        if s[-1] < SHORTEST:
            continue
        at = np.linspace(0.0, s[-1], int(np.ceil(s[-1] / SPACING)) + 1)
        line = np.zeros(len(at), FOOTING)
        line["x"], line["y"] = (np.interp(at, s, walk.points[:, k]) for k in (0, 1))
        line["heading"] = np.arctan2(np.gradient(line["y"]), np.gradient(line["x"]))
        survey(line, samples, lanes, grid)
        step = at[1] - at[0]
        for begin, end in _runs(line["free"] > 0.0):
            if (end - begin - 1) * step >= SHORTEST:
                pieces.append(line[begin:end])
                records.append((first, end - begin, step, walk.width))
                first += end - begin
    strips = np.zeros(len(records), STRIP)
    for strip, (at_first, count, step, width) in zip(strips, records, strict=True):
        strip["first"], strip["count"], strip["step"] = at_first, count, step
        strip["length"] = (count - 1) * step
        strip["half"] = max(0.2, width / 2 - 0.4)
    return strips, np.concatenate(pieces) if pieces else np.zeros(0, FOOTING)


def _landings(town: Town) -> list[Sidewalk]:
    """Short strips along the road at the ends of crosswalks that no sidewalk comes near."""
    known = np.concatenate([walk.points for walk in town.sidewalks]) if town.sidewalks else np.zeros((0, 2))
    found = []
    for crosswalk in town.crosswalks:
        ends = np.array([crosswalk.corners[:2].mean(0), crosswalk.corners[2:].mean(0)])
        across = (ends[1] - ends[0]) / np.hypot(*(ends[1] - ends[0]))
        for end, outward in ((ends[0], -across), (ends[1], across)):
            if len(known) and np.hypot(*(known - end).T).min() < REACH:
                continue
            middle, along = end + 1.5 * outward, np.array([-across[1], across[0]])
            found.append(Sidewalk(middle + np.linspace(-6.0, 6.0, 13)[:, None] * along, 2.0, paved=False))
    return found


def _runs(mask: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Begin and end of every run of true values."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8)))
    return [(int(a), int(b)) for a, b in edges.reshape(-1, 2)]


def _join(strips: Records, footings: Records, samples: Records, lanes: Records, grid: Grid) -> None:
    """Let walkers go on from the ends of strips: to the end of another strip, or to the side of one."""
    owner = np.repeat(np.arange(len(strips)), strips["count"])
    for i, strip in enumerate(strips):
        for name, at in (("before", strip["first"]), ("after", strip["first"] + strip["count"] - 1)):
            here = footings[at]
            away = np.hypot(footings["x"] - here["x"], footings["y"] - here["y"])
            away[(owner == i) & (np.abs(np.arange(len(footings)) - at) < 20)] = np.inf
            # Ends of other strips come first; the side of one only where no end is near.
            ends = np.zeros(len(footings), np.bool_)
            ends[strips["first"]] = ends[strips["first"] + strips["count"] - 1] = True
            target = int(np.argmin(np.where(ends, away, away + JOIN)))
            if away[target] > JOIN or not _is_clear(here, footings[target], samples, lanes, grid):
                strip[name] = -1
                continue
            strip[name] = owner[target]
            strip[f"{name}_s"] = (target - strips["first"][owner[target]]) * strips["step"][owner[target]]


def _is_clear(a: np.void, b: np.void, samples: Records, lanes: Records, grid: Grid) -> bool:
    """Whether the straight way from one point to another touches no lane."""
    line = np.zeros(8, FOOTING)
    for name in ("x", "y"):
        line[name] = np.linspace(a[name], b[name], 8)
    survey(line, samples, lanes, grid)
    return bool((line["free"] > -KERB).all())


def _exits(strips: Records, crossings: Records) -> NDArray:
    """Where walkers may leave strips for crossings; `strips` is told which are whose."""
    rows = sorted(
        (int(crossing[f"strip{side}"]), float(crossing[f"s{side}"]), c, side)
        for c, crossing in enumerate(crossings)
        for side in (0, 1)
    )
    exits = np.zeros(len(rows), EXIT)
    for record, (_, s, crossing, side) in zip(exits, rows, strict=True):
        record["s"], record["crossing"], record["side"] = s, crossing, side
    owners = np.array([row[0] for row in rows], np.int64)
    strips["exit0"] = np.searchsorted(owners, np.arange(len(strips)), "left")
    strips["exit1"] = np.searchsorted(owners, np.arange(len(strips)), "right")
    return exits

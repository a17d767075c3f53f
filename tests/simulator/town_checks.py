"""What must hold for every town."""

from __future__ import annotations

import numpy as np

from me3bev_plugins.simulator.highway.town import Town

KINK = 1.05
"""Degrees between one step of a lane and the next, and across a joint."""


def reachable(edges: list[list[int]], start: int) -> set[int]:
    """Everything that can be reached."""
    seen, queue = {start}, [start]
    while queue:
        for target in edges[queue.pop()]:
            if target not in seen:
                seen.add(target)
                queue.append(target)
    return seen


def check_town(town: Town, joint_kink: float = KINK, kink: float = KINK) -> None:
    """Joints are shared bit for bit, lanes are smooth and close to even, ids agree, and everything can be driven to.

    Args:
        joint_kink: degrees allowed from one lane to the next.
        kink: degrees allowed from one step of a lane to the next.
    """
    assert [lane.id for lane in town.lanes] == list(range(len(town.lanes)))
    for lane in town.lanes:
        assert lane.points.shape[1] == 3
        assert np.isfinite(lane.points).all()
        steps = np.hypot(*np.diff(lane.points[:, :2], axis=0).T)
        assert steps.min() > 0
        assert steps.max() <= 1.01
        assert lane.limit > 0
        assert lane.width >= 1
        directions = np.unwrap(np.arctan2(*np.diff(lane.points[:, :2], axis=0).T[::-1]))
        assert np.degrees(np.abs(np.diff(directions)).max(initial=0)) < kink, lane.id
        for target in lane.successors:
            following = town.lanes[target]
            assert lane.id in following.predecessors
            assert np.array_equal(lane.points[-1], following.points[0])
            turn = (following.heading[0] - lane.heading[-1] + np.pi) % (2 * np.pi) - np.pi
            assert abs(np.degrees(turn)) < joint_kink, (lane.id, target)
        if lane.left is not None:
            assert town.lanes[lane.left].right == lane.id
    edges = [[*lane.successors, *(n for n in (lane.left, lane.right) if n is not None)] for lane in town.lanes]
    back: list[list[int]] = [[] for _ in edges]
    for source, targets in enumerate(edges):
        for target in targets:
            back[target].append(source)
    everything = set(range(len(edges)))
    assert reachable(edges, 0) == everything
    assert reachable(back, 0) == everything
    _check_junctions(town)


def _check_junctions(town: Town) -> None:
    for index, junction in enumerate(town.junctions):
        assert junction.id == index
        assert all(town.lanes[n].junction == index for n in junction.connectors)
        assert set(junction.incoming) == {p for n in junction.connectors for p in town.lanes[n].predecessors} - set(
            junction.connectors
        )
        assert junction.minor <= set(junction.incoming)
        governed = [n for signal in town.signals if signal.junction == index for n in signal.lanes]
        assert sorted(governed) == (sorted(junction.incoming) if junction.control == "signal" else [])
    assert [signal.id for signal in town.signals] == list(range(len(town.signals)))
    for crosswalk in town.crosswalks:
        assert crosswalk.corners.shape == (4, 2)
        assert all(0 <= s <= town.lanes[n].length for n, s in crosswalk.lanes)


def crossings_without_junction(town: Town, reach: float = 1.5) -> list[tuple[int, int, float]]:
    """(lane, lane, metres between their heights) wherever two lanes pass within `reach` of each other in the plane.

    Lanes that follow one another or lie in one junction are left out.
    """
    arrays = town.arrays
    lane = np.repeat(np.arange(len(town.lanes)), np.diff(arrays.start))
    cells: dict[tuple[int, int], list[int]] = {}
    for index, (x, y) in enumerate(np.floor(arrays.xyz[:, :2] / reach).astype(int)):
        cells.setdefault((int(x), int(y)), []).append(index)
    linked = {(a.id, b) for a in town.lanes for b in a.successors}
    found = []
    for (x, y), here in cells.items():
        around = [n for dx in (-1, 0, 1) for dy in (-1, 0, 1) for n in cells.get((x + dx, y + dy), ())]
        for i in here:
            for j in around:
                a, b = int(lane[i]), int(lane[j])
                same = town.lanes[a].junction is not None and town.lanes[a].junction == town.lanes[b].junction
                if a >= b or same or (a, b) in linked or (b, a) in linked:
                    continue
                if np.hypot(*(arrays.xyz[i, :2] - arrays.xyz[j, :2])) < reach:
                    found.append((a, b, float(abs(arrays.xyz[i, 2] - arrays.xyz[j, 2]))))
    return found

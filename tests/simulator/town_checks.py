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


def check_town(town: Town, joint_kink: float = KINK) -> None:
    """Joints are shared bit for bit, lanes are smooth and close to even, ids agree, and everything can be driven to."""
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
        assert np.degrees(np.abs(np.diff(directions)).max(initial=0)) < KINK, lane.id
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

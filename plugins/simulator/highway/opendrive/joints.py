"""Make lanes meet: one shared point per joint, and only what can be driven for ever."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from me3bev_plugins.simulator.highway.town import Floats

EASE = 2.0
"""Metres over which the smallest gap is spread."""
KINK = np.radians(1.0)
JUMP = np.radians(20.0)
EVEN = 0.5
SMOOTHINGS = 240
LONGEST_STEP = 1.01
"""Metres between two points of a lane."""
STRETCH = 18.0
"""Metres over which a gap of one metre is spread, so that no lane kinks."""


def share_joints(
    points: list[Floats], successors: Sequence[Sequence[int]], loose: Sequence[tuple[bool, bool]]
) -> list[Floats]:
    """Lane points moved so that joined ends are the same point, bit for bit.

    Args:
        points: (P, 3) of each lane in driving direction.
        successors: lanes that follow each lane.
        loose: whether each lane's start and end come to a joint without having a say in where it is.
    """
    count = len(points)
    parent = list(range(2 * count))  # Start of lane i is 2 i, its end 2 i + 1.

    def find(node: int) -> int:
        while parent[node] != node:
            parent[node] = parent[parent[node]]
            node = parent[node]
        return node

    for lane, targets in enumerate(successors):
        for target in targets:
            parent[find(2 * lane + 1)] = find(2 * target)
    ends = np.array([p[i] for p in points for i in (0, -1)]).reshape(-1, 3)
    roots = np.array([find(node) for node in range(2 * count)], dtype=np.int64)
    say = np.where(np.array(loose).ravel(), 1e-12, 1.0)  # Only loose ends at a joint: their mean after all.
    total = np.zeros((2 * count, 3))
    np.add.at(total, roots, say[:, None] * ends)
    shared = total / np.maximum(np.bincount(roots, say, minlength=2 * count), 1e-12)[:, None]
    return [_move_ends(p, shared[roots[2 * i]], shared[roots[2 * i + 1]]) for i, p in enumerate(points)]


def smooth(points: Floats) -> Floats:
    """Points (P, 3) with kinks ironed out: files hold some, where two curves do not quite meet."""
    points = points.copy()
    if np.abs(_turns(points)).max(initial=0.0) > JUMP:
        # Samples lie close where a line jumps aside; even ones let it be drawn out.
        s = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points[:, :2], axis=0).T))])
        even = np.linspace(0.0, s[-1], max(2, int(np.ceil(s[-1] / EVEN)) + 1))
        points = np.column_stack([np.interp(even, s, points[:, axis]) for axis in range(3)])
    for attempt in range(SMOOTHINGS):
        kinks = np.abs(_turns(points)) > KINK
        if not kinks.any():
            break
        reach = 2 + attempt // 8  # A kink that stays is given more room.
        near = np.convolve(kinks, np.ones(2 * reach + 1))[reach : reach + len(kinks)] > 0
        relaxed = (points[:-2] + 2 * points[1:-1] + points[2:]) / 4
        points[1:-1] = np.where(near[:, None], relaxed, points[1:-1])
    return points


def _turns(points: Floats) -> Floats:
    """(P - 2,) how far the line turns at each inner point, radians."""
    steps = np.diff(points[:, :2], axis=0)
    turn = steps[:-1, 0] * steps[1:, 1] - steps[:-1, 1] * steps[1:, 0]
    return np.asarray(np.arctan2(turn, (steps[:-1] * steps[1:]).sum(1)))


def _move_ends(points: Floats, first: Floats, last: Floats) -> Floats:
    s = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points[:, :2], axis=0).T))])
    moved = points + _fade(s, first - points[0]) + _fade(s[-1] - s, last - points[-1])
    moved[0], moved[-1] = first, last
    return moved


def dense(points: Floats) -> Floats:
    """Points (P, 3) with more between any two that lie too far apart, as where a file's curves do not meet."""
    steps = np.hypot(*np.diff(points[:, :2], axis=0).T)
    if steps.max(initial=0.0) <= LONGEST_STEP:
        return points
    pieces = np.maximum(np.ceil(steps / LONGEST_STEP), 1).astype(np.int64)
    which = np.repeat(np.arange(len(steps)), pieces)
    share = (np.arange(len(which)) - np.repeat(np.cumsum(pieces) - pieces, pieces)) / pieces[which]
    filled = points[which] + share[:, None] * (points[which + 1] - points[which])
    return np.vstack([filled, points[-1:]])


def _fade(distance: Floats, shift: Floats) -> Floats:
    """(P, 3) the shift at distance 0, smoothly gone further on and always gone at the other end."""
    reach = min(max(EASE, STRETCH * float(np.hypot(shift[0], shift[1]))), float(distance.max()))
    x = np.clip(distance / max(reach, 1e-9), 0.0, 1.0)
    return (1.0 - x * x * (3.0 - 2.0 * x))[:, None] * shift


def strongest_component(successors: Sequence[Sequence[int]], weights: Sequence[float]) -> list[bool]:
    """Which nodes belong to the strongly connected component of the greatest weight (Tarjan, without recursion)."""
    count = len(successors)
    order = [-1] * count
    low = [0] * count
    stacked = [False] * count
    stack: list[int] = []
    component = [-1] * count
    found = 0
    clock = 0
    for root in range(count):
        if order[root] >= 0:
            continue
        work = [(root, 0)]
        while work:
            node, at = work.pop()
            if at == 0:
                order[node] = low[node] = clock
                clock += 1
                stack.append(node)
                stacked[node] = True
            for position in range(at, len(successors[node])):
                target = successors[node][position]
                if order[target] < 0:
                    work.extend([(node, position + 1), (target, 0)])
                    break
                if stacked[target]:
                    low[node] = min(low[node], low[target])
            else:
                if low[node] == order[node]:
                    while True:
                        member = stack.pop()
                        stacked[member] = False
                        component[member] = found
                        if member == node:
                            break
                    found += 1
                if work:
                    low[work[-1][0]] = min(low[work[-1][0]], low[node])
    total = np.bincount(component, weights=np.asarray(weights, float), minlength=1) if count else np.zeros(1)
    best = int(np.argmax(total))
    return [c == best for c in component]

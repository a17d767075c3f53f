"""A town small enough to reason about: a ring of 140 x 100 m, two streets that cross in it at a light.

Every street is two-way. The street from west to east has two lanes each way and a marked crossing at the light; its
two ends meet the ring behind a stop sign and a yield sign; the ends of the other street are equal to the ring. The
ring has a marked crossing of its own.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from me3bev_plugins.simulator.highway.town import Crosswalk, Junction, Lane, Sidewalk, Sign, Signal, Town

WIDTH, TRIM = 3.5, 12.0
NODES = {"west": (-70.0, 0.0), "east": (70.0, 0.0), "south": (0.0, -50.0), "north": (0.0, 50.0), "centre": (0.0, 0.0)}
CORNERS = {"sw": (-70.0, -50.0), "se": (70.0, -50.0), "nw": (-70.0, 50.0), "ne": (70.0, 50.0)}
STREETS = (
    ("west", "sw", "south", 1), ("south", "se", "east", 1), ("east", "ne", "north", 1), ("north", "nw", "west", 1),
    ("west", None, "centre", 2), ("centre", None, "east", 2),
    ("south", None, "centre", 1), ("centre", None, "north", 1),
)  # fmt: skip
CONTROL = {"west": "stop", "east": "yield", "south": "none", "north": "none", "centre": "signal"}


@dataclass
class Arm:
    """The end of a street at a node: lanes that come in and go out, from the middle of the road outwards."""

    angle: float
    incoming: list[int]
    outgoing: list[int]
    lanes: int
    walks: dict[int, np.ndarray] = field(default_factory=dict)
    """Ends of the sidewalks, by side seen from the node: 1 left, -1 right."""


def build_tiny_town(limit: float = 11.0) -> Town:
    """Build it; `limit` in m/s holds everywhere."""
    lanes: list[Lane] = []
    sidewalks: list[Sidewalk] = []
    arms: dict[str, list[Arm]] = {name: [] for name in NODES}
    crosswalks: list[tuple[np.ndarray, list[Lane]]] = []
    for start, corner, end, count in STREETS:
        line = _centre_line(np.array(NODES[start]), corner and np.array(CORNERS[corner]), np.array(NODES[end]))
        forward = _side(lanes, line, count, limit)
        backward = _side(lanes, line[::-1], count, limit)
        edges = [_offset(line, side * (count * WIDTH + 1.8)) for side in (1, -1)]
        sidewalks += [Sidewalk(edge, 2.4) for edge in edges]
        both = [lanes[i] for i in (*forward, *backward)]
        if (start, end) == ("west", "centre"):
            crosswalks.append((_across(line, len(line) - 4, count), both))
        if (start, end) == ("west", "south"):
            crosswalks.append((_across(line, len(line) // 2, count), both))
        ahead, back = line[1] - line[0], line[-2] - line[-1]
        arms[start].append(Arm(np.arctan2(*ahead[::-1]), backward, forward, count, {1: edges[0][0], -1: edges[1][0]}))
        arms[end].append(Arm(np.arctan2(*back[::-1]), forward, backward, count, {1: edges[1][-1], -1: edges[0][-1]}))
    junctions, signals, signs = _junctions(lanes, arms, limit)
    sidewalks += [walk for name in NODES for walk in _corners(np.array(NODES[name]), arms[name])]
    return Town(
        "tiny",
        tuple(_link_back(lanes)),
        tuple(junctions),
        tuple(signals),
        tuple(signs),
        tuple(_crosswalk(corners, near) for corners, near in crosswalks),
        tuple(sidewalks),
    )


def _centre_line(start: np.ndarray, corner: np.ndarray | None, end: np.ndarray) -> np.ndarray:
    """Points about a metre apart from node to node, trimmed at both, with a rounded corner of 15 m."""

    def straight(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        return a + np.linspace(0, 1, int(np.ceil(np.hypot(*(b - a)))) + 1)[:, None] * (b - a)

    if corner is None:
        direction = (end - start) / np.hypot(*(end - start))
        return straight(start + TRIM * direction, end - TRIM * direction)
    into, out = (corner - start) / np.hypot(*(corner - start)), (end - corner) / np.hypot(*(end - corner))
    centre = corner - 15 * into + 15 * out
    turn = np.linspace(0, np.pi / 2, 25)[1:-1, None]
    arc = centre - 15 * out * np.cos(turn) + 15 * into * np.sin(turn)
    return np.concatenate(
        [straight(start + TRIM * into, corner - 15 * into), arc, straight(corner + 15 * out, end - TRIM * out)]
    )


def _offset(line: np.ndarray, metres: float) -> np.ndarray:
    """The line moved to the left."""
    tangent = np.gradient(line, axis=0)
    tangent /= np.hypot(*tangent.T)[:, None]
    return line + metres * np.stack([-tangent[:, 1], tangent[:, 0]], 1)


def _flat(points: np.ndarray) -> np.ndarray:
    return np.column_stack([points, np.zeros(len(points))])


def _side(lanes: list[Lane], line: np.ndarray, count: int, limit: float) -> list[int]:
    """Add the lanes that follow a centre line on its right; returns their ids from the middle outwards."""
    ids = [len(lanes) + k for k in range(count)]
    for k, i in enumerate(ids):
        lanes.append(
            Lane(
                i,
                _flat(_offset(line, -(k + 0.5) * WIDTH)),
                WIDTH,
                limit,
                left=ids[k - 1] if k else None,
                right=ids[k + 1] if k + 1 < count else None,
            )
        )
    return ids


def _bezier(a: Lane, b: Lane) -> np.ndarray:
    p, q = a.points[-1, :2], b.points[0, :2]
    reach = 0.42 * np.hypot(*(q - p))
    u = p + reach * np.array([np.cos(a.heading[-1]), np.sin(a.heading[-1])])
    v = q - reach * np.array([np.cos(b.heading[0]), np.sin(b.heading[0])])
    t = np.linspace(0, 1, max(8, int(np.hypot(*(q - p)) / 0.7)))[:, None]
    return (1 - t) ** 3 * p + 3 * (1 - t) ** 2 * t * u + 3 * (1 - t) * t**2 * v + t**3 * q


def _junctions(
    lanes: list[Lane], arms: dict[str, list[Arm]], limit: float
) -> tuple[list[Junction], list[Signal], list[Sign]]:
    junctions: list[Junction] = []
    signals: list[Signal] = []
    signs: list[Sign] = []
    for number, (name, ends) in enumerate(arms.items()):
        connectors = []
        for arm in ends:
            for other in ends:
                if other is not arm:
                    connectors += _connect(lanes, arm, other, number, limit)
        minor = frozenset(i for arm in ends if arm.lanes == 2 and name in ("west", "east") for i in arm.incoming)
        for arm in ends:
            last = lanes[arm.incoming[-1]]
            post, heading = (*last.points[-1, :2], 4.0), float(last.heading[-1])
            if CONTROL[name] == "signal":
                group = round(abs(np.sin(arm.angle)))
                signals.append(Signal(len(signals), number, tuple(arm.incoming), group, post, heading))
            signs += [Sign(CONTROL[name], i, post, heading) for i in arm.incoming if i in minor]
        junctions.append(
            Junction(
                number,
                tuple(connectors),
                tuple(i for arm in ends for i in arm.incoming),
                tuple(i for arm in ends for i in arm.outgoing),
                CONTROL[name],
                len(ends),
                minor,
                NODES[name],
            )
        )
    return junctions, signals, signs


def _connect(lanes: list[Lane], arm: Arm, other: Arm, junction: int, limit: float) -> list[int]:
    """Connectors from one arm to another: straight on lane by lane, turns from and to the outer lane on that side."""
    bend = (other.angle - arm.angle - np.pi + np.pi) % (2 * np.pi) - np.pi
    turn = "straight" if abs(bend) < 0.5 else "left" if bend > 0 else "right"
    if turn == "straight":
        pairs = [(arm.incoming[k], other.outgoing[min(k, other.lanes - 1)]) for k in range(arm.lanes)]
    else:
        side = 0 if turn == "left" else -1
        pairs = [(arm.incoming[side], other.outgoing[side])]
    made = []
    for a, b in pairs:
        i = len(lanes)
        lanes.append(Lane(i, _flat(_bezier(lanes[a], lanes[b])), WIDTH, limit, (b,), junction=junction, turn=turn))
        lanes[a] = replace(lanes[a], successors=(*lanes[a].successors, i))
        made.append(i)
    return made


def _link_back(lanes: list[Lane]) -> list[Lane]:
    before: dict[int, list[int]] = {lane.id: [] for lane in lanes}
    for lane in lanes:
        for n in lane.successors:
            before[n].append(lane.id)
    return [replace(lane, predecessors=tuple(before[lane.id])) for lane in lanes]


def _corners(node: np.ndarray, arms: list[Arm]) -> list[Sidewalk]:
    """Sidewalks around the corners between neighbouring arms."""
    ordered = sorted(arms, key=lambda arm: arm.angle)
    found = []
    for arm, following in zip(ordered, [*ordered[1:], ordered[0]], strict=True):
        a, b = arm.walks[1], following.walks[-1]
        along_a = np.array([np.cos(arm.angle), np.sin(arm.angle)])
        along_b = np.array([np.cos(following.angle), np.sin(following.angle)])
        if abs(along_a[0] * along_b[1] - along_a[1] * along_b[0]) < 0.1:
            points = np.array([a, b])
        else:
            t = np.linalg.solve(np.column_stack([along_a, -along_b]), b - a)
            points = np.array([a, a + t[0] * along_a, b])
        found.append(Sidewalk(points, 2.4))
    return found


def _across(line: np.ndarray, at: int, count: int) -> np.ndarray:
    """Corners of a crossing 3 m wide at a point of a street."""
    reach = count * WIDTH + 0.4
    low, high = line[at - 1], line[at + 2]
    normal = np.array([-(high - low)[1], (high - low)[0]]) / np.hypot(*(high - low))
    return np.array([low + reach * normal, high + reach * normal, high - reach * normal, low - reach * normal])


def _crosswalk(corners: np.ndarray, lanes: list[Lane]) -> Crosswalk:
    middle = corners.mean(0)
    across = corners[2] - corners[1]
    along = np.array([-across[1], across[0]]) / np.hypot(*across)
    met = []
    for lane in lanes:
        away = np.abs((lane.points[:, :2] - middle) @ along) + 10 * (np.hypot(*(lane.points[:, :2] - middle).T) > 12)
        met.append((lane.id, float(lane.s[np.argmin(away)])))
    return Crosswalk(corners, tuple(met), None)

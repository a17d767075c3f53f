"""The first moment of an episode: which vehicles there are, and where they stand or drive."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from me3bev_plugins.simulator.highway.ego_path import EgoPath
from me3bev_plugins.simulator.highway.scene import Ego, Kind
from me3bev_plugins.simulator.highway.town import Floats, Ints, Town
from me3bev_plugins.simulator.highway.traffic_records import LARGE, LENGTHS, SMALL
from me3bev_plugins.simulator.highway.traffic_state import speed_at
from me3bev_plugins.simulator.highway.traffic_tables import Roads

GAP = 8.0
"""Least distance between bumpers, metres."""
CLEAR_AHEAD, CLEAR_BEHIND = 12.0, 25.0
"""Free road before and behind the ego, metres."""
CLEAR_BESIDE = 2.8
"""Lanes whose centre comes as near as this to the ego's long axis are kept free there, metres."""
LEVEL = 2.5
"""Difference of height beyond which nothing meets, metres."""
LONGEST = 12.0
"""Of all vehicles, metres."""
_SHARES = {Kind.CAR: 0.72, Kind.VAN: 0.12, Kind.TRUCK: 0.08, Kind.MOTORCYCLE: 0.08}
_SIZES = {
    Kind.CAR: ((4.2, 5.0), (1.8, 2.0), (1.4, 1.7)),
    Kind.VAN: ((5.2, 6.1), (1.95, 2.1), (1.9, 2.5)),
    Kind.TRUCK: ((6.8, 12.0), (2.3, 2.5), (2.8, 3.6)),
    Kind.MOTORCYCLE: ((2.0, 2.3), (0.75, 0.9), (1.6, 1.8)),
}
"""Ranges of length, width and height, metres."""
_COLOURS = np.array(
    [
        (236, 236, 238), (188, 192, 198), (104, 108, 114), (34, 36, 40), (158, 30, 34), (28, 62, 128),
        (46, 96, 148), (40, 84, 58), (196, 168, 110), (214, 126, 36), (222, 196, 46), (92, 62, 46),
    ],
    np.uint8,
)  # fmt: skip


class Stretch(NamedTuple):
    """A piece of a lane on which vehicles may be put."""

    lane: int
    low: float
    high: float


class Models(NamedTuple):
    """What the vehicles are (N each)."""

    kind: Ints
    length: Floats
    width: Floats
    height: Floats
    colour: np.ndarray


def draw_models(rng: np.random.Generator, count: int, admitted: int) -> Models:
    """Kinds, sizes and colours; trucks only as long as some lanes of the town admit."""
    kinds = list(_SHARES)
    kind = rng.choice([int(k) for k in kinds], count, p=list(_SHARES.values())).astype(np.int32)
    longest = max((length for size, length in LENGTHS.items() if admitted & size), default=0.0)
    if not longest:
        kind[kind == Kind.TRUCK] = Kind.VAN
    sizes = rng.random((count, 3))
    for k in kinds:
        for axis, (low, high) in enumerate(_SIZES[k]):
            chosen = kind == k
            if k == Kind.TRUCK and axis == 0:
                high = longest
            sizes[chosen, axis] = low + (high - low) * sizes[chosen, axis]
    colour = _COLOURS[rng.integers(0, len(_COLOURS), count)]
    return Models(kind, sizes[:, 0].copy(), sizes[:, 1].copy(), sizes[:, 2].copy(), colour)


def size_bit(length: float) -> int:
    """Which lanes a vehicle may use: a bit of `LANE.admits`."""
    return SMALL if length <= 2 * LARGE else next(size for size, most in LENGTHS.items() if length <= most)


def stretches(town: Town, roads: Roads, ego: Ego, path: EgoPath) -> list[Stretch]:
    """The free pieces of all lanes outside junctions, without the surroundings of the ego."""
    taken = _around_ego(town, ego, path)
    found = []
    for lane in town.lanes:
        record = roads.lanes[lane.id]
        if lane.junction is not None or not record["admits"]:
            continue
        gated = any(roads.lanes["gate"][n] for n in lane.successors)
        begins = any(town.lanes[p].junction is not None for p in lane.predecessors)
        low = 1.0 if begins else GAP / 2
        high = float(record["stop"]) - 1.0 if gated else lane.length - GAP / 2
        pieces = [(low, high)]
        for start, end in (*taken.get(lane.id, ()), *_shared(roads, lane.id)):
            pieces = [p for a, b in pieces for p in ((a, min(b, start)), (max(a, end), b)) if p[1] - p[0] > 2.0]
        found += [Stretch(lane.id, a, b) for a, b in pieces if b - a > 2.0]
    return found


def _shared(roads: Roads, lane: int) -> list[tuple[float, float]]:
    """Intervals of a lane that would be too near to a vehicle on another lane, where that one has them to itself."""
    own = roads.zones[roads.zone_start[3, lane] : roads.zone_start[3, lane + 1]]
    met = own[(own["other"] < lane) & (roads.lanes["junction"][own["other"]] < 0)]
    return [(float(zone["a0"]) - LONGEST / 2, float(zone["a1"]) + LONGEST / 2) for zone in met]


def _around_ego(town: Town, ego: Ego, path: EgoPath) -> dict[int, list[tuple[float, float]]]:
    """Intervals of lanes that must stay empty: before and behind the ego, across borders of lanes, and beside it."""
    here = town.lanes[int(path.lanes[path.index])]
    front, rear = path.s + ego.length / 2 + CLEAR_AHEAD, path.s - ego.length / 2 - CLEAR_BEHIND
    taken = _beside_ego(town, ego)
    taken.setdefault(here.id, []).append((rear, front))
    behind = [(p, -rear) for p in here.predecessors if rear < 0]
    seen = {here.id}
    while behind:
        lane, metres = behind.pop()
        if lane in seen:
            continue
        seen.add(lane)
        length = town.lanes[lane].length
        taken.setdefault(lane, []).append((length - metres, length))
        behind += [(p, metres - length) for p in town.lanes[lane].predecessors if metres > length]
    ahead = [(n, front - here.length) for n in here.successors if front > here.length]
    while ahead:
        lane, metres = ahead.pop()
        taken.setdefault(lane, []).append((0.0, metres))
        length = town.lanes[lane].length
        ahead += [(n, metres - length) for n in town.lanes[lane].successors if metres > length]
    return taken


def _beside_ego(town: Town, ego: Ego) -> dict[int, list[tuple[float, float]]]:
    """Intervals of the lanes that run through the ego's box, such as those that have just parted from its own."""
    arrays = town.arrays
    dx, dy = arrays.xyz[:, 0] - ego.x, arrays.xyz[:, 1] - ego.y
    c, s = np.cos(ego.heading), np.sin(ego.heading)
    beyond = np.maximum(np.abs(dx * c + dy * s) - ego.length / 2, 0.0)
    near = np.hypot(beyond, dy * c - dx * s) < CLEAR_BESIDE
    near &= np.abs(arrays.xyz[:, 2] - ego.z) < LEVEL
    lanes = np.repeat(np.arange(len(town.lanes)), np.diff(arrays.start))
    taken: dict[int, list[tuple[float, float]]] = {}
    for lane in np.unique(lanes[near]):
        met = arrays.s[near & (lanes == lane)]
        taken[int(lane)] = [(float(met.min()) - LONGEST / 2, float(met.max()) + LONGEST / 2)]
    return taken


def put_vehicles(
    rng: np.random.Generator, roads: Roads, models: Models, places: list[Stretch]
) -> tuple[Ints, Ints, Floats, Floats]:
    """Spread vehicles over the stretches by length; who finds no room is left out.

    Returns:
        (index of the model, lane, arc length, speed) of everyone placed, ordered by model.
    """
    if not places:
        empty = np.zeros(0)
        return empty.astype(np.int32), empty.astype(np.int32), empty, empty
    room = np.array([p.high - p.low + GAP for p in places])
    lanes = np.array([p.lane for p in places])
    admits = roads.lanes["admits"][lanes]
    weight = np.cumsum(room) / room.sum()
    picks = np.searchsorted(weight, rng.random((len(models.length), 24)))
    order = rng.permutation(len(places))
    members: list[list[int]] = [[] for _ in places]
    for i, length in enumerate(models.length):
        need, bit = length + GAP, size_bit(length)
        fits = next((p for p in picks[i] if room[p] >= need and admits[p] & bit), None)
        if fits is None:
            fits = next((p for p in order if room[p] >= need and admits[p] & bit), None)
        if fits is not None:
            members[fits].append(i)
            room[fits] -= need
    rows = [row for p, who in enumerate(members) for row in _line_up(rng, roads, models, places[p], room[p], who)]
    rows.sort()
    index, lane, s, speed = (np.array(column) for column in zip(*rows, strict=True)) if rows else [np.zeros(0)] * 4
    return index.astype(np.int32), lane.astype(np.int32), s.astype(np.float64), speed.astype(np.float64)


def _line_up(
    rng: np.random.Generator, roads: Roads, models: Models, place: Stretch, slack: float, who: list[int]
) -> list[tuple[int, int, float, float]]:
    """Rows (model, lane, arc length, speed) for the vehicles of one stretch, with random gaps and safe speeds."""
    spread = np.sort(rng.random(len(who))) * slack
    share = rng.uniform(0.5, 1.0, len(who))
    fronts, at = [], place.low
    for i, extra in zip(who, spread, strict=True):
        fronts.append(at + extra + models.length[i])
        at += models.length[i] + GAP
    rows = []
    limit, leader = place.high + GAP / 2, 0.0
    for i, front, part in zip(reversed(who), reversed(fronts), reversed(share), strict=True):
        s = front - models.length[i] / 2
        safe = np.sqrt(leader**2 + 2 * 2.0 * max(limit - front - 4.0, 0.0))
        leader = float(min(part * speed_at(roads, place.lane, s), safe))
        rows.append((i, place.lane, float(s), leader))
        limit = front - models.length[i]
    return rows

"""Speed limits: posted signs spread downstream; where none reaches, what the road's type says."""

from __future__ import annotations

import re
from collections import deque
from collections.abc import Iterator

from me3bev_plugins.simulator.highway.opendrive.lanes import FALLBACK, HIGHWAY, Network
from me3bev_plugins.simulator.highway.opendrive.records import DRIVING, Document, Road, SignalRecord
from me3bev_plugins.simulator.highway.opendrive.road_reader import UNITS

SPEED_SIGN = "274"
NAMED_SPEED = re.compile(r"sp+e+d[ _-]?(?:limit)?[ _-]?(\d{2,3})", re.IGNORECASE)
"""Sign objects of exports that carry the number in their name ("Speed_30"), km/h, in either spelling met."""
CUT = 15.0
"""Metres; a sign nearer to the end of a section than this counts from that end."""


def speed_signs(road: Road) -> Iterator[tuple[float, tuple[int, ...], float]]:
    """(s, lanes, m/s) of every speed sign on a road."""
    for sign in road.signals:
        if sign.type == SPEED_SIGN and sign.value and sign.value > 0:
            value = sign.value * UNITS.get(sign.unit or "km/h", UNITS["km/h"])
            yield sign.s, governed_lanes(road, sign), value
    for item in road.objects:
        found = NAMED_SPEED.match(item.name)
        if found:
            stands = SignalRecord("", item.s, item.t, "none")
            yield item.s, governed_lanes(road, stands), int(found[1]) * UNITS["km/h"]


def governed_lanes(road: Road, sign: SignalRecord) -> tuple[int, ...]:
    """Driving lanes that a sign speaks to: those it names, else those of the side it stands on.

    Exports disagree on what orientation '+' means, and a sign stands to the right of the traffic it
    speaks to; so the side tells.
    """
    section = next((part for part in road.sections if sign.s <= part.end + 1e-6), road.sections[-1])
    driving = [lane.id for lane in section.lanes.values() if lane.id != 0 and lane.type in DRIVING]
    named = tuple(lane for lane in driving if sign.covers(lane))
    if named or sign.lanes:
        return named
    side = [lane for lane in driving if lane * sign.t > 0]
    return tuple(side or driving)


def assign_limits(document: Document, network: Network) -> None:
    """Set the limit of every lane of the network."""
    _nominal(network)
    lanes = network.lanes
    posted: dict[int, float] = {}
    after: dict[int, float] = {}
    for road in document.roads.values():
        for s, governed, value in speed_signs(road):
            for lane in governed:
                found = locate(network, road, s, lane)
                if found is not None:
                    index, share = found
                    (posted if share < 0.5 else after)[index] = value
    queue: deque[tuple[int, float]] = deque()
    reached = dict(posted)
    for index, value in posted.items():
        if index not in after:
            queue.append((index, value))
    queue.extend(after.items())
    while queue:  # Breadth first, so that the nearest sign upstream wins.
        index, value = queue.popleft()
        for target in lanes[index].successors:
            if target not in reached:
                reached[target] = value
                if target not in after:
                    queue.append((target, value))
    for index, value in reached.items():
        lanes[index].limit = value


def locate(network: Network, road: Road, s: float, lane: int) -> tuple[int, float] | None:
    """The network's lane at s and how far along it that is, as a share."""
    number = next((i for i, part in enumerate(road.sections) if s <= part.end + 1e-6), len(road.sections) - 1)
    key = (road.id, number, lane)
    index = network.of.get(key)
    if index is None:
        return None
    draft = network.lanes[index]
    section = road.sections[number]
    along = s - section.start if lane < 0 else section.end - s
    return index, (draft.begins[draft.keys.index(key)] + along) / max(draft.length, 1e-9)


def _nominal(network: Network) -> None:
    """Type speeds; a lane without one takes that of the lanes before it, else of those after it."""
    lanes = network.lanes
    for lane in lanes:
        if lane.nominal is None:
            around = [lanes[n].nominal for n in lane.predecessors] or [lanes[n].nominal for n in lane.successors]
            known = [value for value in around if value is not None]
            lane.limit = min(known) if known else FALLBACK
        else:
            lane.limit = lane.nominal
            lane.highway = lane.nominal > HIGHWAY
    for lane in lanes:  # A connector between motorways is one too.
        if lane.nominal is None:
            ends = (lane.predecessors, lane.successors)
            lane.highway = all(any(lanes[n].highway for n in end if lanes[n].nominal is not None) for end in ends)

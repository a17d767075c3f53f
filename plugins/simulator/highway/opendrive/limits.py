"""Speed limits: posted signs spread downstream; where none reaches, what the road's type says."""

from __future__ import annotations

import re
from collections.abc import Iterator
from itertools import pairwise

import numpy as np

from me3bev_plugins.simulator.highway.opendrive.lanes import FALLBACK, HIGHWAY, Network
from me3bev_plugins.simulator.highway.opendrive.records import DRIVING, Document, Road, SignalRecord
from me3bev_plugins.simulator.highway.opendrive.road_reader import UNITS
from me3bev_plugins.simulator.highway.town import Floats

SPEED_SIGN = "274"
NAMED_SPEED = re.compile(r"sp+e+d[ _-]?(?:limit)?[ _-]?(\d{2,3})", re.IGNORECASE)
"""Sign objects of exports that carry the number in their name ("Speed_30"), km/h, in either spelling met."""
MOST_ROUNDS = 1000
"""Lanes over which a limit is carried on at most."""


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
    """Set the limit of every lane of the network: the one that holds along most of it."""
    _nominal(network)
    lanes = network.lanes
    signs: dict[int, list[tuple[float, float]]] = {}
    for road in document.roads.values():
        for s, governed, value in speed_signs(road):
            for lane in governed:
                found = locate(network, road, s, lane)
                if found is not None:
                    index, share = found
                    signs.setdefault(index, []).append((share, value))
    if not signs:
        return
    values = sorted({value for posted in signs.values() for _, value in posted})
    holds = _entering(network, signs, values)
    for index, posted in signs.items():
        cuts = [(share, values.index(value)) for share, value in sorted(posted)]
        holds[index] *= cuts[0][0]
        for (share, kind), (end, _) in pairwise([*cuts, (1.0, 0)]):
            holds[index, kind] += max(end - share, 0.0)
    holds = holds.round(6)
    for lane, share in zip(lanes, holds, strict=True):
        if share.max() > 0 and share.max() >= 1.0 - share.sum():
            lane.limit = values[int(share.argmax())]  # The lowest of equals.


def _entering(network: Network, signs: dict[int, list[tuple[float, float]]], values: list[float]) -> Floats:
    """(L, V) share of the traffic that enters each lane under each limit; what no sign reaches is zero.

    A sign holds downstream until the next one; where ways meet, each counts as much as the others.
    """
    edges = [(index, target) for index, lane in enumerate(network.lanes) for target in lane.successors]
    source, target = np.array(edges, np.int64).reshape(-1, 2).T
    entering = np.zeros((len(network.lanes), len(values)))
    signed = np.array(list(signs), np.int64)
    leaving = np.eye(len(values))[[values.index(max(posted)[1]) for posted in signs.values()]]
    for _ in range(MOST_ROUNDS):
        out = entering.copy()
        out[signed] = leaving
        joined = np.zeros_like(entering)
        np.add.at(joined, target, out[source])
        joined /= np.maximum(joined.sum(axis=1, keepdims=True), 1e-12)
        settled = np.abs(joined - entering).max() < 1e-4
        entering = joined
        if settled:
            break
    return entering


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

"""Who goes first: traffic lights, stop and yield signs, roundabouts."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from me3bev_plugins.simulator.highway.opendrive.junctions import Crossing, roundabout_lanes
from me3bev_plugins.simulator.highway.opendrive.lanes import Network
from me3bev_plugins.simulator.highway.opendrive.limits import governed_lanes, locate
from me3bev_plugins.simulator.highway.opendrive.records import Document, Road, SignalRecord
from me3bev_plugins.simulator.highway.town import Sign, Signal

LIGHTS = frozenset({"1000001", "1000009", "1000010", "1000011", "1000012"})
"""Signal types that are traffic lights for vehicles."""
STOP, YIELD = "206", "205"
HEAD_HEIGHT = 5.0
SIGN_HEIGHT = 2.2
NEAREST, FURTHEST = 12.0, 20.0
"""Metres from the stop line to a head: far enough ahead to be seen by who waits at the line."""
SAME_PHASE = np.radians(35.0)
REACH = 60.0
"""Metres before a junction within which a sign or light speaks for it."""

Kinds = dict[int, str]


def settle_control(document: Document, network: Network, crossings: list[Crossing]) -> Kinds:
    """Set each crossing's control, governed and minor lanes.

    Returns:
        "stop" or "yield" for every lane that ends at such a sign.
    """
    entrance = {lane: crossing for crossing in crossings for lane in crossing.incoming}
    lights = _lights(document)
    for road, record in _standing(document, lights):
        for lane in _incoming(network, entrance, road, record):
            entrance[lane].governed.add(lane)
    signs: Kinds = {}
    for road, record in _signs(document):
        for lane in _incoming(network, entrance, road, record):
            signs[lane] = "stop" if record.type == STOP or signs.get(lane) == "stop" else "yield"
    ring = roundabout_lanes(network)
    silent = not lights and not signs
    for crossing in crossings:
        outside = [lane for lane in crossing.incoming if lane not in ring]
        circling = ring.intersection(crossing.incoming) or ring.intersection(crossing.connectors)
        if crossing.governed or (silent and not circling and _busy(network, crossing)):
            # A light on one approach only would leave the others without a rule.
            crossing.control = "signal"
            crossing.governed = set(crossing.incoming)
            for lane in crossing.incoming:
                signs.pop(lane, None)
            continue
        if circling and not any(lane in signs for lane in crossing.incoming):
            signs.update(dict.fromkeys(outside, "yield"))
        minor = [lane for lane in crossing.incoming if lane in signs]
        crossing.minor = frozenset(minor)
        if minor:
            crossing.control = "stop" if any(signs[lane] == "stop" for lane in minor) else "yield"
    return signs


def _lights(document: Document) -> frozenset[str]:
    """Ids of the signals that are traffic lights."""
    return frozenset(
        record.id
        for road in document.roads.values()
        for record in road.signals
        if not record.reference and record.type in LIGHTS
    )


def _standing(document: Document, lights: frozenset[str]) -> Iterator[tuple[Road, SignalRecord]]:
    """Where each light applies: at its references if it has any that name lanes, else where it stands."""
    referred = {
        record.id for road in document.roads.values() for record in road.signals if record.reference and record.lanes
    }
    for road in document.roads.values():
        for record in road.signals:
            if record.id in lights and (record.reference or record.lanes or record.id not in referred):
                yield road, record


def _signs(document: Document) -> Iterator[tuple[Road, SignalRecord]]:
    for road in document.roads.values():
        for record in road.signals:
            if not record.reference and record.type in (STOP, YIELD):
                yield road, record


def _incoming(network: Network, entrance: dict[int, Crossing], road: Road, record: SignalRecord) -> Iterator[int]:
    """Lanes leading into a junction that a record on a road, or on a connector, speaks to."""
    for number in governed_lanes(road, record):
        found = locate(network, road, record.s, number)
        if found is None:
            continue
        lane = found[0]
        if network.lanes[lane].junction is not None:
            yield from (n for n in network.lanes[lane].predecessors if n in entrance)
            continue
        left = (1.0 - found[1]) * network.lanes[lane].length
        while lane not in entrance and left < REACH and len(network.lanes[lane].successors) == 1:
            lane = network.lanes[lane].successors[0]
            left += network.lanes[lane].length
        if lane in entrance and left < REACH:
            yield lane


def _busy(network: Network, crossing: Crossing) -> bool:
    """Whether a junction of a town without any signals would have them: four arms, or three with several lanes."""
    lanes = network.lanes
    motorway = any(lanes[n].highway for n in crossing.incoming)
    crosses = any(lanes[n].turn == "left" for n in crossing.connectors)
    several = any(len(arm.incoming) > 1 for arm in crossing.arms)
    return not motorway and crosses and (len(crossing.arms) >= 4 or (len(crossing.arms) == 3 and several))


def place_signals(network: Network, crossings: list[Crossing]) -> tuple[Signal, ...]:
    """One head for each approach of each signalised junction."""
    signals: list[Signal] = []
    for index, crossing in enumerate(crossings):
        if crossing.control != "signal":
            continue
        approaches = [lanes for arm in crossing.arms if (lanes := [n for n in arm.incoming if n in crossing.governed])]
        headings = [_mean_heading(network, lanes) for lanes in approaches]
        phases = phase_groups(headings)
        if max(phases, default=0) == 0:  # One phase would be green for ever.
            phases = list(range(len(approaches)))
        for lanes, heading, phase in zip(approaches, headings, phases, strict=True):
            position = _head(network, crossing, lanes, heading)
            signals.append(Signal(len(signals), index, tuple(lanes), phase, position, heading))
    return tuple(signals)


def phase_groups(headings: list[float]) -> list[int]:
    """Phase of each approach: approaches along one axis, in either direction, are green together."""
    axes: list[float] = []
    phases = []
    for heading in headings:
        turns = [abs((heading - axis + np.pi / 2) % np.pi - np.pi / 2) for axis in axes]
        if not turns or min(turns) > SAME_PHASE:
            axes.append(heading)
            phases.append(len(axes) - 1)
        else:
            phases.append(int(np.argmin(turns)))
    return phases


def _mean_heading(network: Network, lanes: list[int]) -> float:
    angles = np.array([network.lanes[lane].headings[1] for lane in lanes])
    return float(np.arctan2(np.sin(angles).sum(), np.cos(angles).sum()))


def _head(network: Network, crossing: Crossing, lanes: list[int], heading: float) -> tuple[float, float, float]:
    """Beyond the junction, to the right of the approach's lanes."""
    ahead, aside = np.array([np.cos(heading), np.sin(heading)]), np.array([np.sin(heading), -np.cos(heading)])
    ends = np.array([network.lanes[lane].points[-1] for lane in lanes])
    rightmost = int(np.argmax(ends[:, :2] @ aside))
    foot = ends[rightmost, :2] + aside * (network.lanes[lanes[rightmost]].width / 2 + 1.0)
    exits = np.array([network.lanes[n].points[-1, :2] for n in crossing.connectors])
    depth = float(np.clip(((exits - foot) @ ahead).max() + 1.0, NEAREST, FURTHEST))
    x, y = foot + ahead * depth
    return float(x), float(y), float(ends[:, 2].mean()) + HEAD_HEIGHT


def place_signs(network: Network, crossings: list[Crossing], kinds: Kinds) -> tuple[Sign, ...]:
    """A sign to the right of each minor lane's end."""
    signs = []
    for lane in sorted(n for crossing in crossings for n in crossing.minor):
        draft = network.lanes[lane]
        heading = draft.headings[1]
        x, y, z = draft.points[-1]
        out = draft.width / 2 + 1.2
        position = (float(x + out * np.sin(heading)), float(y - out * np.cos(heading)), float(z) + SIGN_HEIGHT)
        signs.append(Sign("stop" if kinds[lane] == "stop" else "yield", lane, position, heading))
    return tuple(signs)

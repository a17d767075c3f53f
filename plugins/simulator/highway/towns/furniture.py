"""What stands at the roadside or is painted across the road: traffic lights, signs and crosswalks, as OpenDRIVE."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterator

from me3bev_plugins.simulator.highway.towns.arms import CROSSWALK, Arm
from me3bev_plugins.simulator.highway.towns.network import Crossroads, Road

LIGHT, STOP, YIELD, LIMIT = "1000001", "206", "205", "274"
SIGNALS_PER_JUNCTION = 20
"""Ids of signals, signs and controllers are spaced by this for each junction."""


def controllers(root: ET.Element, junction: Crossroads) -> None:
    """One controller for each phase group of a junction's lights."""
    for group in _phases(junction):
        element = ET.SubElement(root, "controller", id=_controller_id(junction, group), name="", sequence=str(group))
        for index in _lit(junction):
            if junction.groups[index] == group:
                ET.SubElement(element, "control", signalId=_signal_id(junction, index), type="0")


def controller_links(element: ET.Element, junction: Crossroads) -> None:
    """Name a junction's controllers in the junction."""
    for group in _phases(junction):
        ET.SubElement(element, "controller", id=_controller_id(junction, group), type="0", sequence=str(group))


def crosswalks(element: ET.Element, road: Road, junctions: list[Crossroads]) -> None:
    """A crossing in front of each end of a road that leads to a junction with crosswalks."""
    objects = ET.SubElement(element, "objects")
    for junction, index, arm in _ends(road, junctions):
        if not junction.node.crossed(road.street):
            continue
        section, (near, far) = road.street.section, CROSSWALK
        right, left = section.asphalt(-1), section.asphalt(1)
        run, middle = road.high - road.low, (near + far) / 2
        thing = ET.SubElement(
            objects,
            "object",
            id=_signal_id(junction, index),
            name="crosswalk",
            type="crosswalk",
            s=_text(0.0 if arm.away > 0 else run),
            t="0",
            zOffset="0",
            hdg="0",
            pitch="0",
            roll="0",
            orientation="none",
            length=_text(far - near),
            width=_text(left - right),
        )
        outline = ET.SubElement(thing, "outline")
        # Corners in order along the walk: edge 0-1 is the right kerb, edge 2-3 the left one.
        ahead, half = -arm.away * middle, (far - near) / 2
        for u, v in ((ahead - half, right), (ahead + half, right), (ahead + half, left), (ahead - half, left)):
            ET.SubElement(outline, "cornerLocal", u=_text(u), v=_text(v), z="0", height="0")


def signals(element: ET.Element, road: Road, junctions: list[Crossroads]) -> None:
    """Lights, stop and yield signs at the ends of a road, and speed signs where its limit begins."""
    parent = ET.SubElement(element, "signals")
    for junction, index, arm in _ends(road, junctions):
        entering = arm.entering()
        faced = junction.node.control in ("stop", "yield") and junction.yielding(index)
        if not entering or not (faced or junction.node.control == "signal"):
            continue
        kind = {"signal": LIGHT, "stop": STOP, "yield": YIELD}[junction.node.control]
        sign = _post(parent, road, _signal_id(junction, index), kind, forward=arm.away < 0, ahead=0.0)
        ids = [lane.id for lane in entering]
        ET.SubElement(sign, "validity", fromLane=str(min(ids)), toLane=str(max(ids)))
    for forward, signed in zip((True, False), road.signed, strict=True):
        if signed:
            number = str(100000 + 2 * road.id + forward)
            sign = _post(parent, road, number, LIMIT, forward, ahead=min(6.0, 0.3 * (road.high - road.low)))
            sign.set("value", _text(road.limit))
            sign.set("unit", "km/h")


def _post(parent: ET.Element, road: Road, number: str, kind: str, forward: bool, ahead: float) -> ET.Element:
    """A light or sign right of traffic in one direction: `ahead` metres past its start, or at its end if 0."""
    run, section = road.high - road.low, road.street.section
    along = ahead if ahead else run
    side = -1 if forward else 1
    return ET.SubElement(
        parent,
        "signal",
        id=number,
        name="",
        s=_text(along if forward else run - along),
        t=_text(section.asphalt(side) + side * 0.8),
        zOffset="4.5" if kind == LIGHT else "2.2",
        hOffset="0",
        pitch="0",
        roll="0",
        orientation="+" if forward else "-",
        dynamic="yes" if kind == LIGHT else "no",
        country="OpenDRIVE",
        type=kind,
        subtype="-1",
        value="-1",
        height="1",
        width="0.5",
    )


def _ends(road: Road, junctions: list[Crossroads]) -> Iterator[tuple[Crossroads, int, Arm]]:
    """The junctions at the ends of a road, with the index and the arm the road is there."""
    for junction in junctions:
        for index, (arm, number) in enumerate(zip(junction.arms, junction.roads, strict=True)):
            if number == road.id:
                yield junction, index, arm


def _lit(junction: Crossroads) -> list[int]:
    if junction.node.control != "signal":
        return []
    return [i for i, arm in enumerate(junction.arms) if arm.entering()]


def _phases(junction: Crossroads) -> list[int]:
    return sorted({junction.groups[i] for i in _lit(junction)})


def _signal_id(junction: Crossroads, index: int) -> str:
    return str(junction.id * SIGNALS_PER_JUNCTION + index)


def _controller_id(junction: Crossroads, group: int) -> str:
    return str(junction.id * SIGNALS_PER_JUNCTION + SIGNALS_PER_JUNCTION // 2 + group)


def _text(value: float) -> str:
    text = f"{value:.6f}".rstrip("0").rstrip(".")
    return "0" if text in ("", "-0") else text

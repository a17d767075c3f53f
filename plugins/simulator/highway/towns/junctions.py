"""Which lanes a junction joins, and how far its arms are trimmed so that a car can drive every one of them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from me3bev_plugins.simulator.highway.towns.arms import ROOM_FOR_CROSSWALK, Arm, arms_at, clear_of_each_other, part
from me3bev_plugins.simulator.highway.towns.connect import connect
from me3bev_plugins.simulator.highway.towns.geometry import Path, meet, wrap
from me3bev_plugins.simulator.highway.towns.streets import Layout, Node

STRAIGHT = math.radians(50)
"""A turn below this can be the way straight on."""
U_TURN = math.radians(136)


@dataclass(frozen=True)
class Link:
    """Entering lane `lane` of arm `source` continues on leaving lane `onto` of arm `target` (indices from the left)."""

    source: int
    lane: int
    target: int
    onto: int


def join(layout: Layout, node: Node) -> tuple[list[Arm], list[Link]]:
    """Arms of a node, trimmed, and the links between their lanes."""
    arms = arms_at(layout, node)
    part(arms)
    if node.links:
        links = _explicit(node, arms)
    elif node.ring:
        links = _roundabout(arms)
    else:
        links = _by_rule(node, arms)
    clear_of_each_other(arms)
    _widen(node, arms, links)
    for arm in arms:
        arm.trim += ROOM_FOR_CROSSWALK if node.crossed(arm.street) else 0.0
    return arms, links


def curve(arms: list[Arm], link: Link) -> Path | None:
    """The way along a link, or None where there is none."""
    source, target = arms[link.source], arms[link.target]
    return connect(source.entry(source.entering()[link.lane]), target.exit(target.leaving()[link.onto]))


def turn(arms: list[Arm], source: int, target: int) -> float:
    """Change of heading from one arm to another, radians, left positive."""
    change: float = wrap(arms[target].outward - arms[source].outward - math.pi)
    return change


def _widen(node: Node, arms: list[Arm], links: list[Link]) -> None:
    """Trim arms further until every link can be driven with the node's radius."""
    for _ in range(400):
        tight = [link for link in links if (path := curve(arms, link)) is None or path.tightest < node.radius]
        if not tight:
            return
        for index in sorted({i for link in tight for i in _limiting(arms, link)}):
            arms[index].trim += 0.25
    raise ValueError(f"node {node.name}: no trim lets {tight} be driven with a radius of {node.radius} m")


def _limiting(arms: list[Arm], link: Link) -> tuple[int, ...]:
    """The arm whose end is too near the turn, or both."""
    source, target = arms[link.source], arms[link.target]
    start, end = source.entry(source.entering()[link.lane]), target.exit(target.leaving()[link.onto])
    corner = meet(start, end)
    if corner is None:
        return link.source, link.target
    before = (corner[0] - start[0]) * math.cos(start[2]) + (corner[1] - start[1]) * math.sin(start[2])
    after = (end[0] - corner[0]) * math.cos(end[2]) + (end[1] - corner[1]) * math.sin(end[2])
    if abs(before - after) < 0.2 or abs(wrap(end[2] - start[2])) < math.radians(20):
        return link.source, link.target
    return (link.source,) if before < after else (link.target,)


def _targets(node: Node, arms: list[Arm], source: int) -> list[tuple[float, int]]:
    """(turn, arm) that traffic entering from an arm may go to, leftmost first."""
    out, street = [], arms[source].street
    for target, arm in enumerate(arms):
        angle = turn(arms, source, target)
        loop = arm.street is street and not street.section.backward and abs(angle) > STRAIGHT
        side: Literal["left", "right"] = "left" if angle > 0 else "right"
        banned = arm.street is not street and (street.name, side) in node.banned
        if target != source and arm.leaving() and abs(angle) < U_TURN and not loop and not banned:
            out.append((angle, target))
    return sorted(out, reverse=True)


def _by_rule(node: Node, arms: list[Arm]) -> list[Link]:
    """All lanes go straight on; the leftmost also turn left and the rightmost right, onto the nearest lanes."""
    targets = [_targets(node, arms, i) for i in range(len(arms))]
    return complete(arms, targets, [link for i in range(len(arms)) for link in _spread(arms, i, targets[i])])


def _spread(arms: list[Arm], source: int, targets: list[tuple[float, int]]) -> list[Link]:
    lanes = len(arms[source].entering())
    main = min(targets, key=lambda t: abs(t[0]), default=None)
    if main is not None and abs(main[0]) > STRAIGHT:
        main = None
    links = []
    for angle, target in targets if lanes else []:
        room = len(arms[target].leaving())
        turning = lanes if main is None else 1
        if main is None and len(targets) > 1:
            turning = (lanes + 1) // 2
        if (angle, target) == main:
            links += _straight(arms, source, target)
        elif angle > (main[0] if main else 0.0):
            links += [Link(source, i, target, min(i, room - 1)) for i in range(turning)]
        else:
            links += [Link(source, lanes - 1 - i, target, max(room - 1 - i, 0)) for i in range(turning)]
    return links


def _straight(arms: list[Arm], source: int, target: int) -> list[Link]:
    """Lanes joined one to one with the least sidestep."""
    lanes, room = len(arms[source].entering()), len(arms[target].leaving())
    best: tuple[float, list[Link]] = (math.inf, [])
    for shift in range(min(0, room - lanes), max(0, room - lanes) + 1):
        links = [Link(source, i, target, i + shift) for i in range(lanes) if 0 <= i + shift < room]
        cost = sum(_sidestep(arms, link) for link in links)
        if cost < best[0] - 1e-6:
            best = cost, links
    return best[1]


def _sidestep(arms: list[Arm], link: Link) -> float:
    """Metres between the two lanes across their mean direction, both drawn on to the node."""
    source, target = arms[link.source], arms[link.target]
    x0, y0, _ = source.at_node(source.entering()[link.lane])
    x1, y1, _ = target.at_node(target.leaving()[link.onto])
    ahead = wrap(source.root + math.pi)
    mean = ahead + wrap(target.root - ahead) / 2
    return float(abs((y1 - y0) * math.cos(mean) - (x1 - x0) * math.sin(mean)))


def complete(arms: list[Arm], targets: list[list[tuple[float, int]]], links: list[Link]) -> list[Link]:
    """Add the most natural link for every lane that the rules left without one."""
    possible = [
        Link(source, lane, target, onto)
        for source, arm in enumerate(arms)
        for _, target in targets[source]
        for lane in range(len(arm.entering()))
        for onto in range(len(arms[target].leaving()))
    ]

    def cost(link: Link) -> tuple[float, float, float]:
        angle = turn(arms, link.source, link.target)
        if abs(angle) < STRAIGHT:
            return 0.0, _sidestep(arms, link), abs(angle)
        # Turn from the outermost lane, so as not to cut across the lanes beside it.
        lanes, room = len(arms[link.source].entering()), len(arms[link.target].leaving())
        aside = link.lane if angle > 0 else lanes - 1 - link.lane
        return 1.0, aside + (link.onto if angle > 0 else room - 1 - link.onto), abs(angle)

    links = list(dict.fromkeys(links))
    for i, arm in enumerate(arms):
        for lane in range(len(arm.entering())):
            if not any((link.source, link.lane) == (i, lane) for link in links):
                links.append(min((p for p in possible if (p.source, p.lane) == (i, lane)), key=cost))
        for lane in range(len(arm.leaving())):
            if not any((link.target, link.onto) == (i, lane) for link in links):
                links.append(min((p for p in possible if (p.target, p.onto) == (i, lane)), key=cost))
    return links


def _explicit(node: Node, arms: list[Arm]) -> list[Link]:
    """The links a node lists; where a street has two arms, the one with such a lane that turns less is meant."""
    out = []
    for source, lane, target, onto in node.links:
        choices = [
            Link(i, lane, j, onto)
            for i, a in enumerate(arms)
            for j, b in enumerate(arms)
            if i != j
            and (a.street.name, b.street.name) == (source, target)
            and lane < len(a.entering())
            and onto < len(b.leaving())
        ]
        out.append(min(choices, key=lambda link: abs(turn(arms, link.source, link.target))))
    return out


def _roundabout(arms: list[Arm]) -> list[Link]:
    """A leg of a roundabout of two lanes driven counter-clockwise.

    Where the leg has two lanes out, the outer lane must leave and the inner may, so that no two cars cut each
    other off; where it has one, the outer lane may leave. The inner lane always goes on round.
    """
    leg = next(i for i, arm in enumerate(arms) if arm.street.section.backward)
    before = next(i for i, arm in enumerate(arms) if i != leg and arm.away < 0)
    after = next(i for i, arm in enumerate(arms) if i != leg and arm.away > 0)
    outer = len(arms[before].entering()) - 1
    links = [Link(before, 0, after, 0)]
    if len(arms[leg].leaving()) > 1:
        links += [Link(before, 0, leg, 0), Link(before, outer, leg, 1)]
    else:
        links += [Link(before, outer, leg, 0), Link(before, outer, after, outer)]
    lanes = len(arms[leg].entering())
    return [*links, Link(leg, 0, after, 0), Link(leg, lanes - 1, after, outer)]

"""T3: a medley. Ring arterial with a centre turn lane, two avenues through a two-lane roundabout, a five-arm
junction with a diagonal, a hilly small grid, a close that ends in a bulb, a slip road."""

from __future__ import annotations

import math

from me3bev_plugins.simulator.highway.towns.geometry import bulb, circle, polyline
from me3bev_plugins.simulator.highway.towns.streets import Layout, Node, Section, Street

ARTERIAL = Section(2, 2, turn_lane=3.5, shoulder=0.5)
AVENUE = Section(2, 2, median=4.0, shoulder=0.5)
STREET = Section(1, 1, shoulder=0.5)
LANE = Section(1, 0, shoulder=0.5)
HILL = 7.0
ROUND = 22.0


def layout() -> Layout:
    """The town's streets and nodes."""
    return Layout("T3", "arterial ring, roundabout, five-arm junction, hill", _streets(), _nodes())


def _streets() -> tuple[Street, ...]:
    ring = polyline((-80, -201, 48), (242, -201, 85), (242, 204, 55), (-80, 204, 45), closed=True)
    west = polyline((-80, 138), (-147, 138, 55), (-147, -132, 25), (-80, -132), (169, -132, 36), (169, -60))
    hill_north, hill_south = ((85, 191), 0.0), ((85, 13), 0.0)
    return (
        Street("ring", ring, ARTERIAL, 60, climbs=(((60, -201), 0.0), ((217, -176), 2.5), ((242, -75), 0.0))),
        Street("north avenue", polyline((4, 204), (0, ROUND)), AVENUE, 50),
        Street("south avenue", polyline((0, -ROUND), (0, -201)), AVENUE, 50),
        Street("east avenue", polyline((ROUND, 0), (242, -3)), AVENUE, 50),
        Street("west street", polyline((-ROUND, 0), (-147, 0)), STREET, 40),
        Street("roundabout", circle((0, 0), ROUND, math.pi / 4), Section(2, 0, shoulder=0.5), 30),
        Street("collector", west, STREET, 40),
        Street("diagonal", polyline((-80, 0), (-147, -58)), STREET, 40),
        Street(
            "hill street", polyline((-80, 138), (152, 136)), STREET, 40, climbs=(((12, 137), 0.0), ((70, 136), HILL))
        ),
        Street(
            "first",
            polyline((85, 204), (83, -1)),
            STREET,
            30,
            climbs=(hill_north, ((85, 149), HILL), ((84, 64), HILL), hill_south),
        ),
        Street(
            "second",
            polyline((153, 204), (150, -2)),
            STREET,
            30,
            climbs=(((153, 191), 0.0), ((152, 149), HILL), ((151, 64), HILL), ((150, 13), 0.0)),
        ),
        Street("top", polyline((84, 75), (151, 74)), STREET, 30, climbs=(((84, 75), HILL),)),
        Street("close", polyline((242, -60), (102, -60)), STREET, 30),
        Street("bulb", bulb((102, -60, math.pi), 20, 13, 1.75), LANE, 30),
        Street("slip", polyline((0, -160), (-36, -172, 40), (-58, -192)), LANE, 40),
    )


def _nodes() -> tuple[Node, ...]:
    lights = (
        Node("ring and hill street", (-80, 138), "signal", crosswalks=True),
        Node("five arms", (-80, 0), "signal", crosswalks=True),
        Node("ring and collector", (-80, -132), "signal", crosswalks=True),
        Node("avenue and hill street", (2, 138), "signal", ("north avenue", "hill street"), crosswalks=True),
        Node("avenue and collector", (0, -132), "signal", crosswalks=True),
        Node("first and hill street", (85, 137), "signal", ("first", "hill street"), crosswalks=True),
        Node("ring and north avenue", (4, 204), "signal", crosswalks=True),
        Node("ring and first", (85, 204), "signal", crosswalks=True),
        Node("ring and south avenue", (0, -201), "signal", crosswalks=True),
        Node("ring and east avenue", (242, -3), "signal", crosswalks=True),
        Node("ring and close", (242, -60), "signal", crosswalks=True),
    )
    signs = (
        Node("ring and second", (153, 204), "yield"),
        Node("second and hill street", (152, 136), "stop", ("second", "hill street")),
        Node("avenue and first", (83, -1), "yield", ("east avenue", "first")),
        Node("avenue and second", (150, -2), "yield", ("east avenue", "second")),
        Node("first and top", (84, 75), "stop", ("first", "top")),
        Node("second and top", (151, 74), "stop", ("second", "top")),
        Node("collector and west street", (-147, 0), "stop"),
        Node("collector and diagonal", (-147, -58), "yield"),
        Node("collector and close", (169, -60), "stop"),
        Node("bulb", (102, -60), reach=2.5),
        Node("slip off", (0, -160), banned=(("south avenue", "left"),)),
        Node("slip on", (-58, -192), "yield", reach=2.5, banned=(("slip", "left"),)),
    )
    legs = ("north avenue", "south avenue", "east avenue", "west street")
    points = ((0.0, ROUND), (0.0, -ROUND), (ROUND, 0.0), (-ROUND, 0.0))
    ring = tuple(
        Node(f"roundabout and {leg}", point, "yield", minor=(leg,), ring=True)
        for leg, point in zip(legs, points, strict=True)
    )
    return lights + signs + ring

"""T7: the country. Narrow two-lane roads, a winding hilly loop around them, many junctions with stop or yield
signs, a turnaround and a lay-by."""

from __future__ import annotations

import math

from me3bev_plugins.simulator.highway.towns.geometry import bulb, polyline
from me3bev_plugins.simulator.highway.towns.streets import Layout, Node, Section, Street

LOOP = Section(1, 1, width=3.5, shoulder=0.5, sidewalk=0)
COUNTRY = Section(1, 1, width=3.2, shoulder=0.5, sidewalk=0)
TRACK = Section(1, 1, width=3.1, shoulder=0.5, sidewalk=0)
VILLAGE = Section(1, 1, width=3.2, shoulder=0.5)
ONE_WAY = Section(1, 0, width=3.2, shoulder=0.5, sidewalk=0)
SOUTH_WEST = (
    (-202, -107, 12),
    (-110, -117, 200),
    (-40, -125, 160),
    (33, -114, 85),
    (77, -88, 20),
    (66, -56, 19),
)
EAST = ((91, -40, 22), (88, -5, 22), (67, 8, 10), (81, 30, 18), (56, 62, 38), (68, 122, 50), (42, 168, 60))
NORTH = ((39, 222, 32), (0, 243, 80), (-38, 253, 38), (-72, 203, 42), (-124, 203, 42), (-158, 246, 45), (-200, 252, 20))
WEST = ((-200, 60, 400), (-204, -20, 400))


def layout() -> Layout:
    """The town's streets and nodes."""
    return Layout("T7", "narrow country roads and a winding hilly loop", _streets(), _nodes())


def _streets() -> tuple[Street, ...]:
    return (
        _loop(),
        Street("spine", polyline((0, 243), (0, 132)), COUNTRY, 40, kind="rural"),
        Street("high street", polyline((0, 132), (0, -60)), VILLAGE, 30),
        Street(
            "middle", polyline((-74, 160), (-80, 125, 60), (-101, 90, 60), (-101, -40, 200), (-110, -117)), COUNTRY, 30
        ),
        Street("north road", polyline((-200, 162), (0, 159)), COUNTRY, 40, kind="rural"),
        Street("green", polyline((-89, 108), (0, 107)), VILLAGE, 30),
        Street("lay-by", polyline((-27, 107), (-27, 88, 9), (-62, 88, 9), (-62, 108)), ONE_WAY, 30),
        Street("mill road", polyline((-101, 64), (-36, 64.6)), TRACK, 30),
        Street("mill street", polyline((-36, 64.6), (0, 65)), VILLAGE, 30),
        Street("church street", polyline((-101, 1), (0, 2, 400), (36, 5.3)), VILLAGE, 30),
        Street("east road", polyline((36, 5.3), (76, 9)), COUNTRY, 30, kind="rural"),
        Street("farm road", polyline((-202, 36), (-101, 35)), COUNTRY, 30, kind="rural"),
        Street("low road", polyline((-204, -50), (-104, -52, 200), (-46, -56.6)), COUNTRY, 40, kind="rural"),
        Street("low street", polyline((-46, -56.6), (0, -60, 300), (36, -61)), VILLAGE, 30),
        Street("coast road", polyline((36, -61), (72, -62)), COUNTRY, 40, kind="rural"),
        Street("yard", polyline((-97, 87), (-150, 93)), TRACK, 30),
        Street("barn road", polyline((-150, 93), (-150, -51)), COUNTRY, 30, kind="rural"),
        Street("turnaround", bulb((-150, 93, math.radians(135)), 14, 10), ONE_WAY, 30),
    )


def _loop() -> Street:
    hills = (
        ((76, 40), 0.0),
        ((58, 64), 4.5),
        ((66, 120), 9.0),
        ((40, 205), 2.0),
        ((20, 234), 0.0),
        ((-30, 248), 0.5),
        ((-98, 203), 6.5),
        ((-160, 246), 0.5),
        ((-200, 200), -0.5),
        ((-200, 180), 0.0),
    )
    slow = (((-202, -30), 30.0), ((-202, -95), 40.0), ((58, 60), 40.0), ((-200, 120), 30.0), ((88, -38), 30.0))
    path = polyline(*SOUTH_WEST, *EAST, *NORTH, *WEST, closed=True)
    return Street("loop", path, LOOP, 40, zones=slow, climbs=hills, kind="rural")


def _nodes() -> tuple[Node, ...]:
    lights = (
        Node("loop and spine", (0, 243), "signal", ("loop", "spine")),
        Node("high street and church street", (0, 2), "signal", crosswalks=True),
        Node("loop and east road", (71, 8), "signal", ("loop", "east road")),
        Node("loop and coast road", (68, -62), "signal", ("loop", "coast road")),
        Node("middle and low road", (-103, -52), "signal", ("middle", "low road"), crosswalks=True),
    )
    stops = tuple(
        Node(f"{one} and {other}", point, "stop", (one, other), minor=(one, other))
        for one, other, point in (
            ("loop", "farm road", (-201, 36)),
            ("barn road", "farm road", (-150, 36)),
            ("middle", "farm road", (-101, 35)),
            ("loop", "low road", (-203, -50)),
            ("high street", "low street", (0, -60)),
            ("high street", "mill street", (0, 65)),
        )
    )
    # Where three roads of equal rank meet, all of them face a yield sign.
    equals = tuple(
        Node(f"{one} and {other}", point, "yield", (one, other), minor=(one, other))
        for one, other, point in (
            ("loop", "north road", (-200, 162)),
            ("north road", "middle", (-74, 160)),
            ("spine", "north road", (0, 159)),
            ("loop", "middle", (-110, -117)),
        )
    )
    yields = tuple(
        Node(f"{one} and {other}", point, "yield", (one, other))
        for one, other, point in (
            ("high street", "green", (0, 107)),
            ("middle", "green", (-89, 108)),
            ("middle", "yard", (-100, 87)),
            ("middle", "mill road", (-101, 64)),
            ("middle", "church street", (-101, 1)),
            ("barn road", "low road", (-150, -51)),
            ("green", "lay-by", (-27, 107)),
            ("green", "lay-by", (-62, 108)),
        )
    )
    changes = ((0, 132), (-36, 64.6), (36, 5.3), (-46, -56.6), (36, -61))
    gates = tuple(Node(f"village gate {i}", point) for i, point in enumerate(changes, 1))
    return (*lights, *stops, *equals, *yields, *gates, Node("turnaround", (-150, 93)))

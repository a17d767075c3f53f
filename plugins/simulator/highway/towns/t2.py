"""T2: a quarter of T1's size from the same kit: shorter blocks below one long upper loop."""

from __future__ import annotations

from me3bev_plugins.simulator.highway.towns.geometry import polyline
from me3bev_plugins.simulator.highway.towns.streets import Layout, Node, Section, Street

STREET = Section(1, 1, width=4.0, shoulder=0.5, sidewalk=4.0)
SIDE = 201.0
MIDDLE, LOWER = 117.0, 66.0
WEST, EAST = 49.0, 139.0


def layout() -> Layout:
    """The town's streets and nodes."""
    return Layout("T2", "short blocks and a long loop", _streets(), _nodes())


def _streets() -> tuple[Street, ...]:
    outline = polyline((0, 0, 12), (SIDE, 0, 12), (SIDE, SIDE, 12), (0, SIDE, 12), closed=True)
    zones = (
        ((80.0, 0.0), 60.0),
        ((160.0, 0.0), 30.0),
        ((SIDE - 24, SIDE), 60.0),
        ((SIDE - 52, SIDE), 90.0),
        ((52.0, SIDE), 60.0),
        ((24.0, SIDE), 30.0),
    )
    return (
        Street("outline", outline, STREET, 30, zones=zones),
        Street("middle street", polyline((0, MIDDLE), (SIDE, MIDDLE)), STREET, 30),
        Street("lower street", polyline((WEST, LOWER), (SIDE, LOWER)), STREET, 30),
        Street("west street", polyline((WEST, 0), (WEST, MIDDLE)), STREET, 30),
        Street("east street", polyline((EAST, LOWER), (EAST, MIDDLE)), STREET, 30),
    )


def _nodes() -> tuple[Node, ...]:
    points = [(x, y) for x in (EAST, SIDE) for y in (LOWER, MIDDLE)]
    points += [(0.0, MIDDLE), (WEST, 0.0), (WEST, LOWER), (WEST, MIDDLE)]
    return tuple(Node(f"{x:.0f}, {y:.0f}", (x, y), "signal", radius=6.0) for x, y in points)

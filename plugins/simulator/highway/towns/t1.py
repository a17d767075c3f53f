"""T1: a small town. A rectangle of two-lane streets with a ladder of east-west streets inside, only three-arm
junctions, all with lights."""

from __future__ import annotations

from me3bev_plugins.simulator.highway.towns.geometry import polyline
from me3bev_plugins.simulator.highway.towns.streets import Layout, Node, Section, Street

STREET = Section(1, 1, width=4.0, shoulder=0.5, sidewalk=4.0)
EAST, NORTH = 398.0, 333.0
WEST_SIDE, EAST_SIDE = 91.0, 337.0
RUNGS = (131.0, 197.0, 272.0)


def layout() -> Layout:
    """The town's streets and nodes."""
    return Layout("T1", "ladder of two-lane streets", _streets(), _nodes())


def _streets() -> tuple[Street, ...]:
    outline = polyline((0, 0, 11), (EAST, 0, 11), (EAST, NORTH, 11), (0, NORTH, 11), closed=True)
    # Fast along the two long sides, slowing down in two steps before their corners.
    fast = (
        ((EAST, 24.0), 60.0),
        ((EAST, 50.0), 90.0),
        ((EAST, NORTH - 50), 60.0),
        ((EAST, NORTH - 24), 30.0),
        ((0.0, NORTH - 24), 60.0),
        ((0.0, NORTH - 50), 90.0),
        ((0.0, 50.0), 60.0),
        ((0.0, 24.0), 30.0),
    )
    rungs = tuple(
        Street(f"rung {i}", polyline((WEST_SIDE, y), (EAST_SIDE, y)), STREET, 30) for i, y in enumerate(RUNGS, 1)
    )
    return (
        Street("outline", outline, STREET, 30, zones=fast),
        Street("west side", polyline((WEST_SIDE, 0), (WEST_SIDE, NORTH)), STREET, 30),
        Street("east side", polyline((EAST_SIDE, 0), (EAST_SIDE, NORTH)), STREET, 30),
        *rungs,
        Street("link", polyline((156, RUNGS[-1]), (156, NORTH)), STREET, 30),
    )


def _nodes() -> tuple[Node, ...]:
    points = [(x, y) for x in (WEST_SIDE, EAST_SIDE) for y in (0.0, *RUNGS, NORTH)]
    points += [(156.0, RUNGS[-1]), (156.0, NORTH)]
    return tuple(Node(f"{x:.0f}, {y:.0f}", (x, y), "signal", radius=7.5) for x, y in points)

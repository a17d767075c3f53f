"""Meshes of what moves: cars of three bodies, vans, trucks, motorcycles with their riders, pedestrians."""

from __future__ import annotations

import numpy as np

from me3bev_plugins.simulator.highway.materials import Role
from me3bev_plugins.simulator.highway.mesh_builder import FINE, MeshBuilder, Point, Span

Spans = tuple[Span, Span]


def car(low: Span, high: Span, belt: float, lamps: Span, wheel: float, rear_pillar: float) -> MeshBuilder:
    """A car whose cabin spans `low` (x) at the belt line (z) and `high` on the roof.

    Args:
        lamps: z of the head lamps.
        wheel: radius as a share of the height.
        rear_pillar: share of the side that is body behind the rear door.
    """
    b = MeshBuilder()
    b.box((-0.46, 0.46), (-0.44, 0.44), (0.02, 0.2), Role.DARK)
    b.frustum(((-0.5, 0.5), (-0.495, 0.495), 0.14), ((-0.5, 0.5), (-0.5, 0.5), 0.4), Role.FIRST, Role.FIRST)
    b.frustum(((-0.5, 0.5), (-0.5, 0.5), 0.4), ((-0.485, 0.45), (-0.46, 0.46), belt), Role.FIRST, Role.FIRST)
    b.frustum((low, (-0.455, 0.455), belt), (high, (-0.36, 0.36), 0.985), Role.GLASS, Role.FIRST)
    b.frustum(
        (high, (-0.36, 0.36), 0.985), ((high[0] + 0.02, high[1] - 0.03), (-0.32, 0.32), 1.0), Role.FIRST, Role.FIRST
    )
    for sign in (-1.0, 1.0):
        bottom, top = sign * 0.459, sign * 0.364
        middle = 0.5 * (low[0] + low[1]), 0.5 * (high[0] + high[1])
        back = low[0] + rear_pillar * (low[1] - low[0]), high[0] + rear_pillar * (high[1] - high[0])
        for (x0, x1), (x2, x3) in (
            ((middle[0] - 0.02, middle[0] + 0.02), (middle[1] - 0.02, middle[1] + 0.02)),
            ((low[0], back[0]), (high[0], back[1])),
            ((low[1] - 0.025, low[1]), (high[1] - 0.025, high[1])),
        ):
            side = [(x0, bottom, belt), (x1, bottom, belt), (x3, top, 0.985), (x2, top, 0.985)]
            b.face(side if sign < 0 else side[::-1], Role.FIRST, FINE)
        for x in (-0.3, 0.31):
            b.wheel(x, sign * 0.503, (0.33 * wheel, wheel), sign)
        b.box(
            (low[1] - 0.06, low[1] - 0.01),
            (sign * 0.5 - 0.05, sign * 0.5 + 0.05),
            (belt, belt + 0.1),
            Role.FIRST,
            0.5 * FINE,
        )
    b.lamps(0.503, lamps)
    b.front(0.504, (-0.25, 0.25), (0.3, lamps[1] - 0.02), Role.DARK, FINE)
    b.front(0.504, (-0.4, 0.4), (0.15, 0.21), Role.DARK, FINE)
    b.front(0.506, (-0.13, 0.13), (0.22, 0.29), Role.PLATE, 0.6 * FINE)
    b.rear(-0.503, (-0.13, 0.13), (0.3, 0.38), Role.PLATE, FINE)
    b.rear(-0.504, (-0.4, 0.4), (0.15, 0.22), Role.DARK, FINE)
    return b


def far_car(low: Span, high: Span, belt: float) -> MeshBuilder:
    """A car at a distance."""
    b = MeshBuilder()
    b.frustum(((-0.5, 0.5), (-0.5, 0.5), 0.08), ((-0.49, 0.46), (-0.47, 0.47), belt), Role.FIRST, Role.FIRST)
    b.frustum((low, (-0.455, 0.455), belt), (high, (-0.36, 0.36), 1.0), Role.GLASS, Role.FIRST)
    b.lamps(0.502, (0.38, 0.5))
    return b


def van() -> MeshBuilder:
    b = MeshBuilder()
    b.box((-0.46, 0.46), (-0.44, 0.44), (0.0, 0.14), Role.DARK)
    b.frustum(((-0.5, 0.5), (-0.5, 0.5), 0.1), ((-0.5, 0.47), (-0.5, 0.5), 0.5), Role.FIRST, Role.FIRST)
    b.frustum(((-0.5, 0.38), (-0.5, 0.5), 0.5), ((-0.49, 0.24), (-0.46, 0.46), 1.0), Role.FIRST, Role.FIRST)
    b.face([(0.372, -0.44, 0.54), (0.372, 0.44, 0.54), (0.262, 0.41, 0.94), (0.262, -0.41, 0.94)], Role.GLASS)
    b.rear(-0.503, (-0.36, 0.36), (0.56, 0.86), Role.GLASS)
    b.rear(-0.505, (-0.012, 0.012), (0.14, 0.95), Role.DARK, FINE)
    for sign in (-1.0, 1.0):
        glass: list[Point] = [(0.1, 0.503 * sign, 0.54), (0.33, 0.503 * sign, 0.54), (0.24, 0.478 * sign, 0.84)]
        glass.append((0.1, 0.478 * sign, 0.84))
        b.face(glass if sign < 0 else glass[::-1], Role.GLASS)
        for x in (-0.3, 0.32):
            b.wheel(x, sign * 0.503, (0.065, 0.16), sign)
        b.side(sign * 0.504, (-0.28, 0.06), (0.3, 0.34), Role.DARK, FINE)
    b.lamps(0.502, (0.3, 0.4))
    b.front(0.503, (-0.24, 0.24), (0.18, 0.34), Role.DARK, FINE)
    b.rear(-0.504, (-0.12, 0.12), (0.24, 0.3), Role.PLATE, FINE)
    return b


def far_van() -> MeshBuilder:
    b = MeshBuilder()
    b.frustum(((-0.5, 0.5), (-0.5, 0.5), 0.06), ((-0.5, 0.47), (-0.5, 0.5), 0.5), Role.FIRST, Role.FIRST)
    b.frustum(((-0.5, 0.38), (-0.5, 0.5), 0.5), ((-0.49, 0.24), (-0.46, 0.46), 1.0), Role.FIRST, Role.FIRST)
    b.face([(0.372, -0.44, 0.54), (0.372, 0.44, 0.54), (0.262, 0.41, 0.94), (0.262, -0.41, 0.94)], Role.GLASS)
    b.rear(-0.503, (-0.36, 0.36), (0.56, 0.86), Role.GLASS)
    b.lamps(0.502, (0.3, 0.4))
    return b


def truck() -> MeshBuilder:
    b = MeshBuilder()
    b.box((-0.48, 0.48), (-0.42, 0.42), (0.06, 0.2), Role.DARK)
    b.box((-0.5, 0.24), (-0.5, 0.5), (0.2, 1.0), Role.SECOND)
    b.frustum(((0.27, 0.5), (-0.48, 0.48), 0.1), ((0.27, 0.485), (-0.47, 0.47), 0.78), Role.FIRST, Role.FIRST)
    b.frustum(((0.27, 0.46), (-0.44, 0.44), 0.78), ((0.27, 0.33), (-0.42, 0.42), 0.94), Role.FIRST, Role.FIRST)
    b.face([(0.498, -0.43, 0.44), (0.498, 0.43, 0.44), (0.491, 0.42, 0.7), (0.491, -0.42, 0.7)], Role.GLASS)
    for sign in (-1.0, 1.0):
        b.side(sign * 0.483, (0.34, 0.46), (0.46, 0.68), Role.GLASS)
        b.side(sign * 0.503, (-0.46, 0.2), (0.56, 0.66), Role.FIRST, 2 * FINE)
        for x in (-0.38, -0.22, 0.38):
            b.wheel(x, sign * 0.503, (0.06, 0.14), sign, 2 * FINE)
    b.lamps(0.503, (0.18, 0.26))
    b.front(0.503, (-0.24, 0.24), (0.14, 0.34), Role.DARK, FINE)
    b.rear(-0.503, (-0.02, 0.02), (0.24, 0.96), Role.DARK, FINE)
    b.rear(-0.502, (-0.44, 0.44), (0.11, 0.17), Role.PLATE, 2 * FINE)
    return b


def far_truck() -> MeshBuilder:
    b = MeshBuilder()
    b.box((-0.5, 0.24), (-0.5, 0.5), (0.12, 1.0), Role.SECOND)
    b.frustum(((0.27, 0.5), (-0.48, 0.48), 0.06), ((0.27, 0.485), (-0.47, 0.47), 0.78), Role.FIRST, Role.FIRST)
    b.face([(0.498, -0.43, 0.44), (0.498, 0.43, 0.44), (0.491, 0.42, 0.7), (0.491, -0.42, 0.7)], Role.GLASS)
    b.lamps(0.503, (0.18, 0.26))
    return b


def motorcycle() -> MeshBuilder:
    """With its rider, who leans forward."""
    b = MeshBuilder()
    for x in (-0.35, 0.35):
        turn = 2 * np.pi * (np.arange(8) + 0.5) / 8
        rim: list[Point] = [(x + 0.145 * float(np.cos(t)), 0.0, 0.2 * (1 + float(np.sin(t)))) for t in turn]
        b.box((x - 0.1, x + 0.1), (-0.07, 0.07), (0.06, 0.34), Role.RUBBER)
        b.sheet(rim, Role.RUBBER)
    b.frustum(((-0.2, 0.22), (-0.16, 0.16), 0.16), ((-0.24, 0.26), (-0.18, 0.18), 0.4), Role.METAL, Role.DARK)
    b.frustum(((-0.04, 0.26), (-0.2, 0.2), 0.4), ((0.0, 0.2), (-0.16, 0.16), 0.58), Role.FIRST, Role.FIRST)
    b.frustum(((-0.46, -0.02), (-0.18, 0.18), 0.4), ((-0.44, -0.04), (-0.16, 0.16), 0.5), Role.FIRST, Role.DARK)
    b.frustum(((0.24, 0.37), (-0.2, 0.2), 0.44), ((0.2, 0.28), (-0.14, 0.14), 0.66), Role.FIRST, Role.GLASS)
    b.box((0.16, 0.2), (-0.5, 0.5), (0.6, 0.64), Role.METAL, 2 * FINE)
    for sign in (-1.0, 1.0):
        leg = (sign * 0.3 - 0.1, sign * 0.3 + 0.1)
        b.frustum(((-0.14, 0.0), leg, 0.14), ((-0.1, 0.12), leg, 0.5), Role.DARK, Role.DARK)
        arm = (sign * 0.42 - 0.07, sign * 0.42 + 0.07)
        b.frustum(((0.08, 0.2), arm, 0.6), ((0.0, 0.1), arm, 0.8), Role.SECOND, Role.SECOND, 2 * FINE)
    b.frustum(((-0.26, -0.04), (-0.3, 0.3), 0.48), ((-0.06, 0.1), (-0.36, 0.36), 0.84), Role.SECOND, Role.SECOND)
    b.frustum(((-0.02, 0.12), (-0.15, 0.15), 0.85), ((0.0, 0.11), (-0.12, 0.12), 1.0), Role.FIRST, Role.FIRST)
    b.front(0.125, (-0.11, 0.11), (0.88, 0.95), Role.GLASS, FINE)
    b.front(0.375, (-0.15, 0.15), (0.46, 0.58), Role.HEADLAMP, 120.0)
    b.rear(-0.465, (-0.15, 0.15), (0.42, 0.5), Role.TAIL, 120.0)
    b.rear(-0.45, (-0.13, 0.13), (0.28, 0.38), Role.PLATE, FINE)
    return b


def pedestrian(stride: float) -> MeshBuilder:
    """Walking with the legs `stride` apart."""
    b = MeshBuilder()
    for sign in (-1.0, 1.0):
        y = (sign * 0.2 - 0.14, sign * 0.2 + 0.14)
        x = sign * stride
        b.frustum(((x - 0.16, x + 0.16), y, 0.04), ((-0.17, 0.17), y, 0.5), Role.SECOND, Role.SECOND)
        b.box((x - 0.16, x + 0.3), y, (0.0, 0.04), Role.HAIR, FINE)
        arm = (sign * 0.44 - 0.08, sign * 0.44 + 0.08)
        b.frustum(((-x - 0.1, -x + 0.1), arm, 0.44), ((-0.12, 0.12), arm, 0.8), Role.FIRST, Role.FIRST, 2 * FINE)
        b.box((-x - 0.1, -x + 0.1), arm, (0.4, 0.44), Role.SKIN, FINE)
    b.frustum(((-0.24, 0.24), (-0.34, 0.34), 0.47), ((-0.22, 0.22), (-0.4, 0.4), 0.84), Role.FIRST, Role.FIRST)
    b.box((-0.1, 0.1), (-0.1, 0.1), (0.83, 0.88), Role.SKIN, FINE)
    b.frustum(((-0.17, 0.17), (-0.16, 0.16), 0.87), ((-0.2, 0.2), (-0.19, 0.19), 0.97), Role.SKIN, Role.SKIN)
    b.frustum(((-0.22, 0.14), (-0.21, 0.21), 0.93), ((-0.18, 0.14), (-0.16, 0.16), 1.0), Role.HAIR, Role.HAIR)
    return b


def far_pedestrian() -> MeshBuilder:
    b = MeshBuilder()
    b.frustum(((-0.17, 0.17), (-0.34, 0.34), 0.0), ((-0.17, 0.17), (-0.34, 0.34), 0.5), Role.SECOND, Role.SECOND)
    b.frustum(((-0.24, 0.24), (-0.5, 0.5), 0.47), ((-0.22, 0.22), (-0.46, 0.46), 0.84), Role.FIRST, Role.FIRST)
    b.box((-0.2, 0.2), (-0.19, 0.19), (0.86, 1.0), Role.SKIN)
    return b

"""Meshes of what stands: houses, trees, poles, street lamps, signal heads, signs."""

from __future__ import annotations

import numpy as np

from me3bev_plugins.simulator.highway.materials import Role
from me3bev_plugins.simulator.highway.mesh_builder import FINE, MeshBuilder, Point

EAVES = 0.62
"""Height of a gabled house's walls as a share of its whole."""
LAMP_HEAD = (0.45, 0.93)
"""x and z of a street lamp's light in the unit box."""


def building() -> MeshBuilder:
    """A flat roof."""
    b = MeshBuilder()
    b.frustum(((-0.5, 0.5), (-0.5, 0.5), 0.0), ((-0.5, 0.5), (-0.5, 0.5), 1.0), Role.WALL, Role.SECOND)
    return b


def house() -> MeshBuilder:
    """A gabled roof whose ridge runs along x."""
    b = MeshBuilder()
    b.frustum(((-0.5, 0.5), (-0.5, 0.5), 0.0), ((-0.5, 0.5), (-0.5, 0.5), EAVES), Role.WALL, Role.SECOND)
    for sign in (-1.0, 1.0):
        gable: list[Point] = [(0.5 * sign, -0.5, EAVES), (0.5 * sign, 0.5, EAVES), (0.5 * sign, 0.0, 1.0)]
        b.face(gable if sign > 0 else gable[::-1], Role.FIRST)
        slope: list[Point] = [(-0.5, 0.5 * sign, EAVES), (0.5, 0.5 * sign, EAVES), (0.5, 0.0, 1.0), (-0.5, 0.0, 1.0)]
        b.face(slope if sign < 0 else slope[::-1], Role.SECOND)
    b.box((0.2, 0.27), (-0.2, -0.1), (0.8, 1.0), Role.FIRST)
    return b


def tree(sides: int = 7) -> MeshBuilder:
    """A round crown."""
    b = MeshBuilder()
    b.lathe([(0.06, 0.0), (0.045, 0.4)], min(5, sides), Role.BARK)
    b.lathe([(0.14, 0.3), (0.43, 0.42), (0.5, 0.62), (0.38, 0.86), (0.12, 1.0)], sides, Role.LEAF)
    return b


def far_tree() -> MeshBuilder:
    b = MeshBuilder()
    b.lathe([(0.05, 0.0), (0.05, 0.34)], 3, Role.BARK)
    b.lathe([(0.2, 0.32), (0.5, 0.58), (0.22, 0.98)], 6, Role.LEAF)
    return b


def conifer(sides: int = 7) -> MeshBuilder:
    b = MeshBuilder()
    b.lathe([(0.06, 0.0), (0.06, 0.2)], min(5, sides), Role.BARK)
    b.lathe([(0.5, 0.14), (0.2, 0.5)], sides, Role.LEAF)
    b.lathe([(0.4, 0.42), (0.14, 0.74)], sides, Role.LEAF)
    b.lathe([(0.28, 0.68), (0.02, 1.0)], sides, Role.LEAF)
    return b


def far_conifer() -> MeshBuilder:
    b = MeshBuilder()
    b.lathe([(0.5, 0.12), (0.03, 1.0)], 6, Role.LEAF)
    return b


def poplar(sides: int = 7) -> MeshBuilder:
    """A tall, narrow crown that begins near the ground."""
    b = MeshBuilder()
    b.lathe([(0.07, 0.0), (0.06, 0.2)], min(5, sides), Role.BARK)
    b.lathe([(0.16, 0.14), (0.32, 0.3), (0.36, 0.52), (0.24, 0.8), (0.05, 1.0)], sides, Role.LEAF)
    return b


def pole() -> MeshBuilder:
    b = MeshBuilder()
    b.lathe([(0.5, 0.0), (0.32, 1.0)], 5, Role.METAL)
    return b


def street_lamp() -> MeshBuilder:
    """A post at the middle whose arm reaches out to +x."""
    b = MeshBuilder()
    b.frustum(((-0.022, 0.022), (-0.25, 0.25), 0.0), ((-0.012, 0.012), (-0.13, 0.13), 0.98), Role.METAL, Role.METAL)
    arm: list[Point] = [(0.0, -0.12, 0.96), (0.4, -0.12, 0.975), (0.4, -0.12, 0.99), (0.0, -0.12, 0.98)]
    b.sheet(arm, Role.METAL)
    x, z = LAMP_HEAD
    b.box((x - 0.09, x + 0.05), (-0.45, 0.45), (z + 0.035, z + 0.055), Role.METAL)
    b.box((x - 0.07, x + 0.04), (-0.38, 0.38), (z + 0.02, z + 0.035), Role.LAMP)
    b.face(
        [
            (x - 0.07, -0.38, z + 0.02),
            (x - 0.07, 0.38, z + 0.02),
            (x + 0.04, 0.38, z + 0.02),
            (x + 0.04, -0.38, z + 0.02),
        ],
        Role.LAMP,
    )
    return b


def signal() -> MeshBuilder:
    """Driven towards +x: the lamps face -x, under visors."""
    b = MeshBuilder()
    b.box((-0.3, 0.3), (-0.34, 0.34), (0.03, 0.97), Role.DARK)
    plate: list[Point] = [(0.0, 0.5, 0.0), (0.0, -0.5, 0.0), (0.0, -0.5, 1.0), (0.0, 0.5, 1.0)]
    b.sheet(plate, Role.DARK)
    for z, role in ((0.82, Role.RED), (0.5, Role.AMBER), (0.18, Role.GREEN)):
        turn = 2 * np.pi * (np.arange(8) + 0.5) / 8
        b.face([(-0.31, -0.3 * float(np.cos(t)), z + 0.145 * float(np.sin(t))) for t in turn], role)
    return b


def sign(sides: int, turn: float, inner: Role) -> MeshBuilder:
    """A plate that faces -x, red with an inner part."""
    b = MeshBuilder()
    angles = 2 * np.pi * np.arange(sides) / sides + turn
    for x, size, role in ((0.0, 0.5, Role.SIGN_WHITE), (-0.02, 0.46, Role.SIGN_RED), (-0.04, 0.27, inner)):
        rim: list[Point] = [(x, -size * float(np.cos(t)), 0.5 + size * float(np.sin(t))) for t in angles]
        b.face(rim, role)
    b.face([(0.01, 0.5 * float(np.cos(t)), 0.5 + 0.5 * float(np.sin(t))) for t in angles + np.pi], Role.METAL)
    return b


def stop_sign() -> MeshBuilder:
    """An octagon with a bar where the word would be."""
    b = sign(8, np.pi / 8, Role.SIGN_RED)
    b.face(
        [(-0.06, 0.36, 0.41), (-0.06, -0.36, 0.41), (-0.06, -0.36, 0.59), (-0.06, 0.36, 0.59)],
        Role.SIGN_WHITE,
        2 * FINE,
    )
    return b


def yield_sign() -> MeshBuilder:
    return sign(3, -np.pi / 2, Role.SIGN_WHITE)


def box() -> MeshBuilder:
    """Closed all round."""
    b = MeshBuilder()
    b.box((-0.5, 0.5), (-0.5, 0.5), (0.0, 1.0), Role.FIRST)
    b.face([(-0.5, 0.5, 0.0), (0.5, 0.5, 0.0), (0.5, -0.5, 0.0), (-0.5, -0.5, 0.0)], Role.FIRST)
    return b

"""Building meshes face by face, in the unit box (x forward, y left, z up)."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from me3bev_plugins.simulator.highway.materials import Role

FAR = 1e9
"""Range of faces that are always drawn."""
FINE = 45.0
"""Range of small parts (plates, wheels, hands), metres at the default focal length."""

Point = tuple[float, float, float]
Span = tuple[float, float]


class MeshBuilder:
    """Collects the faces of one mesh."""

    def __init__(self) -> None:
        self.vertices: dict[Point, int] = {}
        self.faces: list[tuple[list[int], Role, float]] = []

    def face(self, points: list[Point], role: Role, reach: float = FAR) -> None:
        for point in points:
            self.vertices.setdefault(point, len(self.vertices))
        self.faces.append(([self.vertices[point] for point in points], role, reach))

    def sheet(self, points: list[Point], role: Role, reach: float = FAR) -> None:
        """A face seen from both sides."""
        self.face(points, role, reach)
        self.face(points[::-1], role, reach)

    def frustum(
        self, low: tuple[Span, Span, float], high: tuple[Span, Span, float], sides: Role, top: Role, reach: float = FAR
    ) -> None:
        """A block between two rectangles (x span, y span, z), without its underside."""
        (a0, a1), (b0, b1), z0 = low
        (c0, c1), (d0, d1), z1 = high
        p = [(a0, b0, z0), (a1, b0, z0), (a1, b1, z0), (a0, b1, z0)]
        q = [(c0, d0, z1), (c1, d0, z1), (c1, d1, z1), (c0, d1, z1)]
        for i in range(4):
            j = (i + 1) % 4
            self.face([p[i], p[j], q[j], q[i]], sides, reach)
        self.face(q, top, reach)

    def box(self, x: Span, y: Span, z: Span, role: Role, reach: float = FAR) -> None:
        self.frustum((x, y, z[0]), (x, y, z[1]), role, role, reach)

    def lathe(self, rings: list[Span], sides: int, role: Role, reach: float = FAR) -> None:
        """Rings (radius, z) from the bottom up around the axis, closed on top."""
        turn = 2 * np.pi * (np.arange(sides) + 0.5) / sides
        loops = [[(float(r * np.cos(t)), float(r * np.sin(t)), z) for t in turn] for r, z in rings]
        for low, high in pairwise(loops):
            for i in range(sides):
                j = (i + 1) % sides
                self.face([low[i], low[j], high[j], high[i]], role, reach)
        self.face(loops[-1], role, reach)

    def wheel(self, x: float, y: float, radius: tuple[float, float], outward: float, reach: float = FINE) -> None:
        """A tyre with its rim, on the ground, facing +y (outward 1) or -y (outward -1)."""
        turn = 2 * np.pi * (np.arange(8) + 0.5) / 8 * -outward
        points = [(x + radius[0] * float(np.cos(t)), y, radius[1] * (1 + float(np.sin(t)))) for t in turn]
        self.face(points, Role.RUBBER, reach)
        hub = [(x + 0.5 * (px - x), y + 0.002 * outward, radius[1] + 0.5 * (pz - radius[1])) for px, _, pz in points]
        self.face(hub, Role.METAL, 0.7 * reach)

    def front(self, x: float, y: Span, z: Span, role: Role, reach: float = FAR) -> None:
        """A rectangle that faces +x."""
        self.face([(x, y[0], z[0]), (x, y[1], z[0]), (x, y[1], z[1]), (x, y[0], z[1])], role, reach)

    def rear(self, x: float, y: Span, z: Span, role: Role, reach: float = FAR) -> None:
        """A rectangle that faces -x."""
        self.face([(x, y[1], z[0]), (x, y[0], z[0]), (x, y[0], z[1]), (x, y[1], z[1])], role, reach)

    def side(self, y: float, x: Span, z: Span, role: Role, reach: float = FAR) -> None:
        """A rectangle on the left (y > 0) or right side, facing out."""
        points = [(x[0], y, z[0]), (x[1], y, z[0]), (x[1], y, z[1]), (x[0], y, z[1])]
        self.face(points if y < 0 else points[::-1], role, reach)

    def lamps(self, x: float, z: Span, y: Span = (0.27, 0.46)) -> None:
        """Head lamps at +x and tail lamps at -x."""
        for low, high in (y, (-y[1], -y[0])):
            self.front(x, (low, high), z, Role.HEADLAMP, 120.0)
            self.rear(-x, (low, high), (z[0] + 0.02, z[1] + 0.04), Role.TAIL, 120.0)

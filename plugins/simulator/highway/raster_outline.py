"""Polygons in a picture: cut at the near plane, and the columns they span at each row."""

from __future__ import annotations

import numpy as np

from me3bev_plugins.simulator.highway.compiled import kernel
from me3bev_plugins.simulator.highway.raster_buffers import Floats, Ints

NEAR = 0.15
"""Nothing closer to a camera than this is drawn, metres."""


@kernel
def clip(local: Floats, corner: Ints, count: int, pin: Floats, out: Floats) -> int:
    """The pixels of a face cut at the near plane; returns how many corners remain."""
    kept = 0
    p = local[corner[count - 1]]
    for k in range(count):
        q = local[corner[k]]
        if (p[2] >= NEAR) != (q[2] >= NEAR):
            share = (NEAR - p[2]) / (q[2] - p[2])
            out[kept, 0] = pin[0] * (p[0] + share * (q[0] - p[0])) / NEAR + pin[2]
            out[kept, 1] = pin[1] * (p[1] + share * (q[1] - p[1])) / NEAR + pin[3]
            kept += 1
        if q[2] >= NEAR:
            out[kept, 0], out[kept, 1] = q[3], q[4]
            kept += 1
        p = q
    return kept


@kernel
def outline(polygon: Floats, corners: int, spans: Floats, width: int, height: int) -> tuple[int, int]:
    """The columns that a convex polygon of pixels spans at each row's middle; returns the range of rows."""
    low, high, left, right = np.inf, -np.inf, np.inf, -np.inf
    for k in range(corners):
        low, high = min(low, polygon[k, 1]), max(high, polygon[k, 1])
        left, right = min(left, polygon[k, 0]), max(right, polygon[k, 0])
    if right < 0.5 or left > width or high < 0.5 or low > height:
        return 0, 0
    top, bottom = int(max(0.0, np.ceil(low - 0.5))), int(min(float(height), np.ceil(high - 0.5)))
    if top >= bottom or np.ceil(left - 0.5) >= np.ceil(right - 0.5):
        return 0, 0
    for row in range(top, bottom):
        spans[row, 0], spans[row, 1] = np.inf, -np.inf
    j = corners - 1
    for k in range(corners):
        x0, y0, x1, y1 = polygon[j, 0], polygon[j, 1], polygon[k, 0], polygon[k, 1]
        j = k
        if y0 > y1:
            x0, y0, x1, y1 = x1, y1, x0, y0
        first, end = int(max(0.0, np.ceil(y0 - 0.5))), int(min(float(height), np.ceil(y1 - 0.5)))
        if first >= end:
            continue
        slope = (x1 - x0) / (y1 - y0)
        for row in range(first, end):
            x = x0 + slope * (row + 0.5 - y0)
            spans[row, 0], spans[row, 1] = min(spans[row, 0], x), max(spans[row, 1], x)
    return top, bottom

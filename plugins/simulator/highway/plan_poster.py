"""The picture behind `me3bev maps show`: a plan of a town for people, with a legend and one route."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from me3bev_plugins.simulator.highway.route_sampling import random_route
from me3bev_plugins.simulator.highway.routes import Route
from me3bev_plugins.simulator.highway.town import Town

if TYPE_CHECKING:
    from matplotlib.axes import Axes

DPI = 100
LONGEST = 1250
"""Pixels of the longer side of the map."""
PANEL = 330
"""Pixels of the legend's column."""
HEAD, MARGIN, LOWEST = 84, 24, 780
"""Pixels: the title's row, the border, and the least height of the picture."""
BORDER = 16.0
"""Metres around the outermost lanes."""
POINTS = 72 / DPI
"""Typographic points in a pixel."""
MOST, FEWEST = 7.0, 0.05
"""Pixels per metre, for tiny and for endless towns."""


@dataclass(frozen=True)
class Frame:
    """Where the map lies on the picture: its corner in the world, metres, its size in pixels, and its scale."""

    low: tuple[float, float]
    width: int
    height: int
    scale: float
    """Pixels per metre."""

    @property
    def high(self) -> tuple[float, float]:
        """The upper right corner in the world, metres."""
        return self.low[0] + self.width / self.scale, self.low[1] + self.height / self.scale

    def line(self, metres: float, least: float) -> float:
        """Line width in points: to scale, but at least so many pixels."""
        return max(metres * self.scale, least) * POINTS


def poster(town: Town, seed: int) -> NDArray[np.uint8]:
    """A plan of a town: (H, W, 3) r, g, b, about 1,600 pixels wide, north up.

    Args:
        town: to draw.
        seed: of the route that is drawn.
    """
    # Late, for nothing else needs matplotlib.
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    from me3bev_plugins.simulator.highway.plan_poster_ground import draw_ground
    from me3bev_plugins.simulator.highway.plan_poster_legend import draw_legend, draw_scale, draw_title
    from me3bev_plugins.simulator.highway.plan_poster_signs import draw_route, draw_signs

    frame = frame_of(town)
    route = random_route(town, np.random.default_rng(seed))
    width, height = frame.width + PANEL + 3 * MARGIN, max(frame.height + HEAD + 2 * MARGIN, LOWEST)
    figure = Figure(figsize=(width / DPI, height / DPI), dpi=DPI, facecolor="white")
    canvas = FigureCanvasAgg(figure)
    top = height - HEAD - MARGIN - frame.height
    box = (MARGIN / width, top / height, frame.width / width, frame.height / height)
    axes = _map(figure.add_axes(box), frame)
    draw_ground(axes, town, frame)
    draw_signs(axes, town, frame)
    draw_route(axes, route, frame)
    draw_scale(axes, frame)
    draw_title(figure, town, width, height)
    draw_legend(figure, town, _caption(route, seed), width, height)
    canvas.draw()
    return np.ascontiguousarray(np.asarray(canvas.buffer_rgba())[:, :, :3], np.uint8)


def frame_of(town: Town) -> Frame:
    """The map's place for a town of any size."""
    x0, y0, x1, y1 = town.bounds
    extent = np.array([x1 - x0, y1 - y0]) + 2 * BORDER
    scale = float(np.clip(LONGEST / extent.max(), FEWEST, MOST))
    size = np.clip(np.ceil(extent * scale), 320, LONGEST).astype(int)
    # Whatever is wider than the town keeps it in the middle.
    low = np.array([x0 + x1, y0 + y1]) / 2 - size / scale / 2
    return Frame((float(low[0]), float(low[1])), int(size[0]), int(size[1]), scale)


def _map(axes: Axes, frame: Frame) -> Axes:
    axes.set_xlim(frame.low[0], frame.high[0])
    axes.set_ylim(frame.low[1], frame.high[1])
    axes.set_xticks([])
    axes.set_yticks([])
    axes.set_facecolor("#e9efe0")
    for spine in axes.spines.values():
        spine.set_color("#9aa39a")
    return axes


def _caption(route: Route, seed: int) -> str:
    return f"route of seed {seed}, {route.length:.0f} m"

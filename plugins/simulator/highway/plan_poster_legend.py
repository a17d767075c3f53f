"""What stands around a town's plan: title, legend, scale bar, north arrow."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.legend import Legend
from matplotlib.legend_handler import HandlerBase
from matplotlib.lines import Line2D
from matplotlib.patches import Ellipse, Patch, Rectangle
from matplotlib.transforms import Transform

from me3bev_plugins.simulator.highway import plan_poster_ground as ground
from me3bev_plugins.simulator.highway import plan_poster_signs as signs
from me3bev_plugins.simulator.highway.plan_poster import HEAD, MARGIN, PANEL, Frame
from me3bev_plugins.simulator.highway.town import Town

LEGEND_ROW = 25
"""Pixels."""


def draw_title(figure: Figure, town: Town, width: int, height: int) -> None:
    """The town's name and its figures, above the map."""
    y = 1 - (MARGIN + HEAD * 0.36) / height
    figure.text(MARGIN / width, y, town.name, size=30, weight="bold", color=signs.INK, va="center")
    figure.text(MARGIN / width, 1 - (MARGIN + HEAD * 0.82) / height, summary(town), size=12, color="#4b5058")


def summary(town: Town) -> str:
    """One line of figures."""
    x0, y0, x1, y1 = town.bounds
    counted = (
        (len(town.junctions), "junctions"),
        (sum(junction.control == "signal" for junction in town.junctions), "with lights"),
        (sum(sign.kind == "stop" for sign in town.signs), "stop signs"),
        (sum(sign.kind == "yield" for sign in town.signs), "yield signs"),
        (len(town.crosswalks), "crosswalks"),
        (len(town.buildings), "buildings"),
    )
    kilometres = sum(lane.length for lane in town.lanes) / 1000
    parts = [f"{kilometres:.1f} km of lanes", *(f"{count:,} {what}" for count, what in counted if count)]
    return "  ·  ".join([*parts, f"{x1 - x0:.0f} x {y1 - y0:.0f} m"])


def draw_legend(figure: Figure, town: Town, route: str, width: int, height: int) -> None:
    """What colours and symbols mean, right of the map; only what the town has."""
    limits = sorted({round(lane.limit * 3.6) for lane in town.lanes if lane.junction is None})
    roads = [(Patch(color=ground.limit_colour(kmh / 3.6)), f"{kmh} km/h") for kmh in limits]
    things = _symbols(town)
    way = [
        (Line2D([], [], color=signs.ROUTE, lw=4), route),
        (_dot("o", signs.START, "white", 12), "A: its start"),
        (_dot("o", signs.END, "white", 12), "B: its end"),
    ]
    x, y = 1 - (MARGIN + PANEL) / width, 1 - (MARGIN + HEAD) / height
    for title, rows in (("Speed limit", roads), ("On the map", things), ("Route", way)):
        legend = figure.legend(
            [handle for handle, _ in rows],
            [label for _, label in rows],
            loc="upper left",
            bbox_to_anchor=(x, y),
            borderaxespad=0,
            title=title,
            alignment="left",
            frameon=False,
            fontsize=12,
            title_fontproperties={"size": 13, "weight": "bold"},
            labelspacing=0.55,
            handlelength=1.8,
            handler_map={_Light: _LightHandler()},
        )
        legend.get_title().set_color(signs.INK)
        y -= (LEGEND_ROW * (len(rows) + 1) + 22) / height


class _Light(Patch):
    """Stands for a signal head in the legend."""


class _LightHandler(HandlerBase):
    """Draws it."""

    def create_artists(  # type: ignore[override]
        self,
        legend: Legend,
        orig_handle: Artist,
        xdescent: float,
        ydescent: float,
        width: float,
        height: float,
        fontsize: float,
        trans: Transform,
    ) -> list[Artist]:
        """A box with three lamps."""
        x, y, tall = width / 2 - xdescent, height / 2 - ydescent, 1.5 * height
        box = Rectangle((x - 0.2 * tall, y - tall / 2), 0.4 * tall, tall, fc="#15171b", transform=trans)
        lamp = 0.27 * tall
        lamps = [Ellipse((x, y + row * lamp * 1.15), lamp, lamp, fc=c, transform=trans) for c, row in signs.LAMPS]
        return [box, *lamps]


def _dot(marker: str, face: str, edge: str, size: float = 10.0) -> Line2D:
    return Line2D([], [], ls="", marker=marker, mfc=face, mec=edge, ms=size, mew=1.2)


def _symbols(town: Town) -> list[tuple[Line2D | Patch, str]]:
    stops, yields = (sum(sign.kind == kind for sign in town.signs) for kind in ("stop", "yield"))
    unpaved = any(not walk.paved for walk in town.sidewalks)
    rows: list[tuple[Line2D | Patch, str, bool]] = [
        (Patch(color=ground.ASPHALT), "junction, shoulder", bool(town.junctions)),
        (Patch(fc="none", ec=signs.OUTLINE, ls="--"), "outline of a junction", bool(town.junctions)),
        (Line2D([], [], ls="", marker="$\\rightarrow$", color="#555b66", ms=14), "direction of a lane", True),
        (Patch(fc=ground.ASPHALT, ec=ground.DECK_EDGE, lw=3), "upper level", bool(signs.bridges(town))),
        (_Light(), "traffic light", bool(town.signals)),
        (_dot("8", signs.STOP, "white", 12), "stop sign", stops > 0),
        (_dot("v", "white", signs.STOP), "yield sign", yields > 0),
        (Patch(fc="white", ec="#777d86", hatch="||||"), "crosswalk", bool(town.crosswalks)),
        (Patch(color=ground.SIDEWALK), "sidewalk", any(walk.paved for walk in town.sidewalks)),
        (Patch(color=ground.PATH), "roadside to walk on", unpaved),
        (Patch(fc=ground.HOUSE, ec="#8d8274"), "building", bool(town.buildings)),
        (_dot("o", ground.TREE, ground.TREE), "tree", any(prop.kind == "tree" for prop in town.props)),
    ]
    return [(handle, label) for handle, label, wanted in rows if wanted]


def draw_scale(axes: Axes, frame: Frame) -> None:
    """A scale bar and a north arrow in the map's lower corners."""
    metres = nice_length(150 / frame.scale)
    width, x, y = metres * frame.scale / frame.width, 20 / frame.width, 20 / frame.height
    plate: dict[str, Any] = {"transform": axes.transAxes, "zorder": 20}
    axes.add_patch(
        Rectangle((x / 2, y / 2), width + x, 44 / frame.height, fc="white", ec="#9aa39a", alpha=0.85, **plate)
    )
    for share, colour in ((0.0, signs.INK), (0.5, "white")):
        axes.add_patch(
            Rectangle((x + share * width, y), width / 2, 6 / frame.height, fc=colour, ec=signs.INK, lw=1, **plate)
        )
    axes.text(x + width / 2, y + 12 / frame.height, f"{metres:g} m", ha="center", size=11, color=signs.INK, **plate)
    x, y = 1 - 34 / frame.width, 22 / frame.height
    axes.annotate(
        "N",
        (x, y + 46 / frame.height),
        (x, y),
        xycoords="axes fraction",
        textcoords="axes fraction",
        ha="center",
        va="bottom",
        size=13,
        weight="bold",
        color=signs.INK,
        arrowprops={"arrowstyle": "-|>", "color": signs.INK, "lw": 2},
        bbox={"boxstyle": "circle,pad=0.25", "fc": "white", "ec": "none", "alpha": 0.85},
        zorder=20,
    )


def nice_length(most: float) -> float:
    """The largest of 1, 2, 5, 10, 20, 50, ... that does not exceed `most` metres."""
    power = 10.0 ** np.floor(np.log10(most))
    return float(next(step * power for step in (5, 2, 1) if step * power <= most * (1 + 1e-9)))

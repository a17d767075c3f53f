"""The convergence figure: a line per recipe, the spread over its seeds shaded."""

from __future__ import annotations

import io
from collections.abc import Sequence

import numpy as np

from me3bev_cli.training.convergence import Group, reached

COLOURS = ("#1f4e8c", "#c4541a", "#2a7f4f", "#7a3e9d", "#a08100", "#0f8b9d", "#b0285a", "#555555")
FINE = 500
"""Points of a shade's outline."""
STYLES = ("-", "--", "-.", ":")
"""So that lines differ in print and without colour as well."""


def convergence_picture(groups: Sequence[Group], window: int) -> bytes:
    """Reward per step against environment steps, moving averages, as PNG.

    A shade is between the least and the greatest run; thin lines are the runs themselves; a dot is where 90 % of the
    plateau is first reached.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.ticker import FuncFormatter

    figure = Figure(figsize=(7.2, 4.4), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    for number, group in enumerate(groups):
        colour = COLOURS[number % len(COLOURS)]
        style = STYLES[number // len(COLOURS) % len(STYLES)]
        several = len(group.curves) > 1
        for curve in group.curves:
            values = curve.smooth if several else curve.reward
            axes.plot(curve.steps, values, color=colour, linewidth=0.7, alpha=0.35)
        if several:
            # Between two updates too: lines may cross there.
            fine = np.unique(np.concatenate([group.steps, np.linspace(group.steps[0], group.steps[-1], FINE)]))
            runs = np.stack([np.interp(fine, curve.steps, curve.smooth) for curve in group.curves])
            axes.fill_between(fine, runs.min(axis=0), runs.max(axis=0), color=colour, alpha=0.15, linewidth=0)
        seeds = f", {len(group.curves)} seeds" if several else ""
        axes.plot(group.steps, group.mean, style, color=colour, linewidth=2, label=f"{group.label}{seeds}")
        found = reached(group.steps, group.mean)
        if found.step is not None:
            at = int((group.steps >= found.step).argmax())
            axes.plot(found.step, group.mean[at], "o", color=colour, markersize=6, markeredgecolor="white")
    axes.set_xlabel("environment steps")
    axes.set_ylabel("average reward per step")
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,.0f}"))
    axes.grid(alpha=0.3)
    axes.legend(frameon=False)
    spread = "; shaded: least to greatest run" if any(len(group.curves) > 1 for group in groups) else ""
    axes.set_title(f"moving average of {window} updates{spread}; dots: 90 % of the plateau", fontsize=9, loc="left")
    buffer = io.BytesIO()
    figure.savefig(buffer, dpi=130, format="png")
    return buffer.getvalue()

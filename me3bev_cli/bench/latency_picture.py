"""Pictures of the measuring: latency against context with stage shares, and speed against driving score."""

from __future__ import annotations

import io
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal

from me3bev_cli.bench.latency_network import STAGES
from me3bev_cli.bench.latency_rows import Row
from me3bev_cli.bench.latency_scores import Point
from me3bev_cli.bench.latency_tables import context, number, of_people

if TYPE_CHECKING:
    from matplotlib.axes import Axes

COLOURS = ("#2f6fb5", "#d9822b", "#4c9a5b", "#8c5fa8", "#b8434e", "#4aa3a8", "#8a6d4b", "#6b7280")
STAGE_COLOURS = dict(zip(STAGES, ("#b9c4d0", "#2f6fb5", "#d9822b", "#4c9a5b", "#8c5fa8", "#6b7280"), strict=True))
MANY = len(COLOURS)
"""With more networks than this, lines are told apart by their temporal module alone, in a panel per spatial one."""
BEYOND = 2.0
"""A budget above this many times what was found would only squeeze the lines."""
LINES: dict[str, Literal["--", "-"]] = {"window": "--", "stream": "-"}


def latency_picture(rows: Sequence[Row], title: str, budget_ms: float | None = None) -> bytes:
    """PNG: the whole and the temporal stage against context, and what each stage takes of each network."""
    shown = of_people(rows)
    swept = [row for row in rows if row["context"] in LINES]
    many = len({row["name"] for row in swept}) > MANY
    panels = _panels(swept, many)
    bars = 1.0 + 0.27 * len(shown)
    figure = _figure(13, 4.6 * bool(panels) + bars)
    figure.suptitle(title, x=0.01, ha="left", fontsize=12, fontweight="bold")
    lower = figure
    if panels:
        upper, lower = figure.subfigures(2, 1, height_ratios=(4.6, bars))
        _lines(upper, panels, "temporal" if many else "name", budget_ms)
    _shares(lower.subplots(1, 2, width_ratios=(1, 1), sharey=True), shown, budget_ms)
    return _png(figure)


def _figure(width: float, height: float) -> Any:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def _png(figure: Any) -> bytes:
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png")
    return buffer.getvalue()


def _whole(row: Row) -> float:
    return float(row["median_ms"])


def _temporal(row: Row) -> float:
    return float(row["stages"]["temporal"])


Panel = tuple[str, list[Row], Callable[[Row], float]]


def _panels(rows: list[Row], many: bool) -> list[Panel]:
    """Title, rows and figure of each panel with lines; none where no length was compared with another."""
    if len({(row["context"], row["length"]) for row in rows}) < 2:
        return []
    if not many:
        return [("the whole", rows, _whole), ("the temporal stage", rows, _temporal)]
    kinds = list(dict.fromkeys(row["spatial"] for row in rows))
    wholes: list[Panel] = [
        (f"the whole, {kind}, a line per network", [row for row in rows if row["spatial"] == kind], _whole)
        for kind in kinds
    ]
    # That of the spatial module which gives it most to do.
    heaviest = max(wholes, key=lambda panel: max(map(_temporal, panel[1])))
    return [*wholes, (f"the temporal stage, {heaviest[1][0]['spatial']}", heaviest[1], _temporal)]


def _lines(figure: Any, panels: Sequence[Panel], key: str, budget_ms: float | None) -> None:
    from matplotlib.lines import Line2D

    labels = list(dict.fromkeys(row[key] for _, rows, _ in panels for row in rows))
    colours = {label: COLOURS[i % len(COLOURS)] for i, label in enumerate(labels)}
    for axes, (title, rows, figure_of) in zip(figure.subplots(1, len(panels), squeeze=False)[0], panels, strict=True):
        for name, kind in dict.fromkeys((row["name"], row["context"]) for row in rows):
            line = sorted((r for r in rows if (r["name"], r["context"]) == (name, kind)), key=lambda r: r["length"])
            lengths = [row["length"] for row in line]
            style = {"color": colours[line[0][key]], "linestyle": LINES[kind], "linewidth": 1.4}
            axes.plot(lengths, [figure_of(row) for row in line], marker="o", markersize=3, **style)
        _context_axis(axes, rows, title)
        near = budget_ms is not None and budget_ms < BEYOND * max(map(figure_of, rows))
        if budget_ms is not None and near and figure_of is _whole:
            axes.axhline(budget_ms, color="#b8434e", linewidth=1, linestyle=":")
            axes.annotate(
                f"budget {budget_ms:g} ms", (0.02, budget_ms), xycoords=("axes fraction", "data"), fontsize=8,
                color="#b8434e", va="bottom",
            )  # fmt: skip
    handles = [Line2D([], [], color=colour, linewidth=2) for colour in colours.values()]
    names = list(labels)
    for kind, dashes in LINES.items():
        handles.append(Line2D([], [], color="#444444", linestyle=dashes))
        names.append({"window": "window: all frames read again", "stream": "stream: state carried along"}[kind])
    figure.legend(handles, names, loc="outside lower center", ncols=min(len(names), 6), fontsize=8, frameon=False)


def _context_axis(axes: Axes, rows: Sequence[Row], title: str) -> None:
    from matplotlib.ticker import FuncFormatter, NullFormatter

    lengths = sorted({row["length"] for row in rows})
    axes.set_xscale("log", base=2)
    axes.set_yscale("log")
    axes.set_xticks(lengths, [str(length) for length in lengths])
    axes.minorticks_off()
    low, high = axes.get_ylim()
    axes.set_yticks(_ticks(low, high))
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.yaxis.set_minor_formatter(NullFormatter())
    axes.set_title(title, fontsize=10)
    axes.set_xlabel("context, frames", fontsize=9)
    axes.set_ylabel("median, ms", fontsize=9)
    _plain(axes, "both")


def _ticks(low: float, high: float) -> list[float]:
    """Round numbers of a logarithmic axis: the closest set of at most nine."""
    for steps in ((1, 1.5, 2, 3, 4, 5, 7), (1, 2, 5), (1,)):
        found = [m * 10.0**e for e in range(-4, 6) for m in steps if low <= m * 10.0**e <= high]
        if len(found) <= 9:
            break
    return found


def _plain(axes: Any, grid: str) -> None:
    axes.tick_params(labelsize=8)
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(axis=grid, color="#e6e6e6", linewidth=0.8)
    axes.set_axisbelow(True)


def _shares(panels: Any, rows: Sequence[Row], budget_ms: float | None) -> None:
    """Left milliseconds, with the 95th percentile marked; right each stage's share. The first network on top."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    times, shares = panels
    places = range(len(rows))
    sums = [sum(row["stages"].values()) for row in rows]
    for axes, scales in ((times, [1.0] * len(rows)), (shares, [100 / total for total in sums])):
        left = [0.0] * len(rows)
        for stage in STAGES:
            widths = [row["stages"][stage] * scale for row, scale in zip(rows, scales, strict=True)]
            axes.barh(places, widths, 0.72, left=left, color=STAGE_COLOURS[stage])
            left = [a + b for a, b in zip(left, widths, strict=True)]
        _plain(axes, "x")
    longest = max(max(row["p95_ms"], total) for row, total in zip(rows, sums, strict=True))
    for place, (row, total) in enumerate(zip(rows, sums, strict=True)):
        times.plot([row["p95_ms"]] * 2, [place - 0.36, place + 0.36], color="#222222", linewidth=1.2)
        end = max(total, row["p95_ms"]) + 0.012 * longest
        times.text(
            end, place, f"{number(row['median_ms'])} ms, {number(row['floor_ratio'])} x floor", va="center", fontsize=8
        )
        _write_shares(shares, place, [100 * row["stages"][stage] / total for stage in STAGES])
    if budget_ms is not None and budget_ms < 1.3 * longest:
        times.axvline(budget_ms, color="#b8434e", linewidth=1, linestyle=":")
    times.set_xlim(0, 1.3 * longest)
    times.set_ylim(len(rows) - 0.4, -0.6)
    same = len({context(row) for row in rows}) == 1
    times.set_yticks(places, [row["name"] if same else f"{row['name']}, {context(row)}" for row in rows], fontsize=8)
    times.set_title("medians of the stages, ms" + (f"; {context(rows[0])}" if same else ""), fontsize=10)
    shares.set_title("share of each stage, %", fontsize=10)
    shares.set_xlim(0, 100)
    shares.tick_params(axis="y", length=0)
    handles = [*(Patch(color=STAGE_COLOURS[stage]) for stage in STAGES), Line2D([], [], color="#222222")]
    figure = times.figure
    figure.legend(handles, [*STAGES, "95th percentile"], loc="outside lower center", ncols=7, fontsize=8, frameon=False)


def _write_shares(axes: Any, place: int, shares: Sequence[float]) -> None:
    """The share inside its bar where there is room."""
    left = 0.0
    for stage, share in zip(STAGES, shares, strict=True):
        if round(share) >= 4:
            dark = stage != "sensor"
            colour = "white" if dark else "#222222"
            axes.text(left + share / 2, place, f"{share:.0f}", ha="center", va="center", fontsize=7.5, color=colour)
        left += share


def score_picture(points: Sequence[Point], title: str) -> bytes:
    """PNG: median latency against driving score with its interval, a panel per cell; a line joins the front."""
    from matplotlib.lines import Line2D

    cells = list(dict.fromkeys(point.score.cell for point in points))
    names = {point.score.run: point.context for point in points}
    styles = {name: _mark(i) for i, name in enumerate(names)}
    columns = min(len(cells), 2)
    lines = -(-len(cells) // columns)
    figure = _figure(7.2 * columns, 4.4 * lines + 0.8)
    figure.suptitle(title, x=0.01, ha="left", fontsize=12, fontweight="bold")
    panels = list(figure.subplots(lines, columns, squeeze=False).flat)
    for axes, cell in zip(panels, cells, strict=False):
        _front(axes, [point for point in points if point.score.cell == cell], styles)
        axes.set_title(cell, fontsize=10)
    for axes in panels[len(cells) :]:
        axes.set_axis_off()
    handles = [Line2D([], [], linestyle="", markersize=7, **style) for style in styles.values()]
    handles.append(Line2D([], [], linestyle="-", color="#444444", marker="o", markersize=7))
    labels = [*(f"{name}, {context}" for name, context in names.items()), "front (filled): none is faster and better"]
    figure.legend(handles, labels, loc="outside lower center", ncols=min(len(labels), 4), fontsize=8, frameon=False)
    return _png(figure)


def _mark(index: int) -> dict[str, Any]:
    """A colour and a shape that no other run has."""
    return {"color": COLOURS[index % len(COLOURS)], "marker": "osD^vP"[index // len(COLOURS) % 6]}


def _front(axes: Any, points: Sequence[Point], styles: Mapping[str, dict[str, Any]]) -> None:
    front = sorted((p for p in points if p.front), key=lambda p: p.median_ms)
    axes.plot([p.median_ms for p in front], [p.score.mean for p in front], color="#444444", linewidth=1, zorder=1)
    for point in points:
        score, style = point.score, styles[point.score.run]
        if score.low is not None and score.high is not None:
            axes.plot([point.median_ms] * 2, [score.low, score.high], color=style["color"], linewidth=1.2, zorder=2)
        face = style["color"] if point.front else "white"
        axes.plot(point.median_ms, score.mean, markersize=8, markerfacecolor=face, linestyle="", zorder=3, **style)
    axes.set_xlim(0, 1.15 * max(point.median_ms for point in points))
    lowest = min(point.score.mean if point.score.low is None else point.score.low for point in points)
    axes.set_ylim(max(0, 10 * (lowest // 10) - 10), 103)
    axes.set_xlabel("median latency, ms (lower is better)", fontsize=9)
    axes.set_ylabel("driving score (higher is better)", fontsize=9)
    _plain(axes, "both")

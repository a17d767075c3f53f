"""Markdown tables: for each density, metrics x methods x maps."""

from __future__ import annotations

from me3bev_cli.evaluation.definitions import METRICS
from me3bev_cli.evaluation.layout import Cell, heading, lay_out
from me3bev_cli.evaluation.published import NOTE
from me3bev_cli.evaluation.results import Results

ARROWS = {"higher": " ↑", "lower": " ↓", "neither": ""}
MARKS = {"better": " ▲", "worse": " ▼", "other": " *", "": ""}


def markdown_text(results: Results) -> str:
    """Every metric; the best of each column in bold."""
    blocks = []
    for density in dict.fromkeys(row.density for row in results.rows):
        layout = lay_out(results, tuple(METRICS), density)
        lines = [f"### {density.capitalize()} density", ""]
        lines.append("| metric | method | " + " | ".join(escape(heading(map)) for _, map in layout.columns) + " |")
        lines.append("|:--|:--|" + "--:|" * len(layout.columns))
        for metric in layout.metrics:
            title = METRICS[metric].label + ARROWS[METRICS[metric].direction]
            for method in layout.methods:
                line = layout.cells[metric, method]
                if method in layout.published and all(cell.text == "-" for cell in line):
                    continue
                lines.append(f"| {title} | {escape(method)} | " + " | ".join(map(_cell, line)) + " |")
                title = ""
        blocks.append("\n".join(lines))
    text = "\n\n".join(blocks) + "\n\n↑ higher is better, ↓ lower; the best of each column in bold.\n"
    if results.comparisons:
        baseline = escape(results.comparisons[0].baseline)
        text += f"▲ better, ▼ worse than {baseline} on the same seeds (the 95 % interval leaves out 0; each figure by "
        text += "itself).\n"
    return f"{text}{NOTE}\n" if results.published else text


def _cell(cell: Cell) -> str:
    return (f"**{cell.text}**" if cell.best else cell.text) + MARKS[cell.verdict]


def escape(text: str) -> str:
    """Text that does not end a column."""
    return text.replace("|", "\\|")

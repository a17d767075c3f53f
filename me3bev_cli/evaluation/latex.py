"""A LaTeX table as the paper has it: metrics x methods x maps, low and high density side by side, with booktabs."""

from __future__ import annotations

from me3bev_cli.evaluation.definitions import METRICS, PAPER
from me3bev_cli.evaluation.layout import Cell, Layout, heading, lay_out
from me3bev_cli.evaluation.published import NOTE
from me3bev_cli.evaluation.results import Results

ARROWS = {"higher": r"$\uparrow$", "lower": r"$\downarrow$", "neither": ""}
MARKS = {"better": "$^{+}$", "worse": "$^{-}$", "other": r"$^{\ast}$", "": ""}
_SPECIAL = {
    "\\": r"\textbackslash{}", "&": r"\&", "%": r"\%", "$": r"\$", "#": r"\#", "_": r"\_", "{": r"\{", "}": r"\}",
    "~": r"\textasciitilde{}", "^": r"\textasciicircum{}",
}  # fmt: skip


def latex_text(results: Results) -> str:
    """The paper's metrics, best figures in bold. It needs the package booktabs and, being wide, graphicx."""
    layout = lay_out(results, PAPER)
    groups = "".join("r" * count for count in layout.densities.values())
    lines = [
        r"% \usepackage{booktabs} and \usepackage{graphicx}",
        r"\begin{table*}[t]",
        r"\centering",
        rf"\caption{{{_caption(results)}}}",
        r"\resizebox{\textwidth}{!}{%",
        rf"\begin{{tabular}}{{ll{groups}}}",
        r"\toprule",
        *_head(layout),
    ]
    for metric in layout.metrics:
        lines.append(r"\midrule")
        for number, method in enumerate(layout.methods):
            title = f"{escape(METRICS[metric].label.capitalize())} {ARROWS[METRICS[metric].direction]}".strip()
            cells = " & ".join(map(_cell, layout.cells[metric, method]))
            lines.append(rf"{title if number == 0 else ''} & {_method(layout, method)} & {cells} \\")
    lines += [r"\bottomrule", r"\end{tabular}}", r"\end{table*}"]
    return "\n".join(lines) + "\n"


def _head(layout: Layout) -> list[str]:
    """Two lines: the densities over their columns, then the maps."""
    spans, rules, first = [], [], 3
    for density, count in layout.densities.items():
        spans.append(rf"\multicolumn{{{count}}}{{c}}{{{escape(density.capitalize())}-density traffic}}")
        rules.append(rf"\cmidrule(lr){{{first}-{first + count - 1}}}")
        first += count
    maps = " & ".join(escape(heading(map)) for _, map in layout.columns)
    return [rf" & & {' & '.join(spans)} \\", " ".join(rules), rf"Metric & Method & {maps} \\"]


def _method(layout: Layout, method: str) -> str:
    return rf"\textit{{{escape(method)}}}" if method in layout.published else escape(method)


def _cell(cell: Cell) -> str:
    text = "--" if cell.text == "-" else cell.text.replace("-", "$-$")
    return (rf"\textbf{{{text}}}" if cell.best else text) + MARKS[cell.verdict]


def _caption(results: Results) -> str:
    text = "Means over episodes; the average is that of the maps' means. Best in bold."
    if results.comparisons:
        baseline = escape(results.comparisons[0].baseline)
        text += f" $^{{+}}$/$^{{-}}$: better/worse than {baseline} on the same seeds "
        text += "(95\\% bootstrap interval, each figure by itself)."
    return f"{text} In italics: {escape(NOTE)}" if results.published else text


def escape(text: str) -> str:
    """Text that LaTeX sets as it is."""
    return "".join(_SPECIAL.get(letter, letter) for letter in text)

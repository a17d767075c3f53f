"""Tables for papers and pages: the layout, what is best, what is published."""

from __future__ import annotations

import io
import json
import re

import pytest
from episodes import episode

from me3bev_cli.evaluation.definitions import METRICS, PAPER
from me3bev_cli.evaluation.latex import escape, latex_text
from me3bev_cli.evaluation.layout import lay_out
from me3bev_cli.evaluation.markdown import markdown_text
from me3bev_cli.evaluation.outcome import Outcome, work_out
from me3bev_cli.evaluation.published import METHODS, published_rows
from me3bev_cli.evaluation.results import Results
from me3bev_cli.evaluation.summary import AVERAGE
from me3bev_cli.evaluation.tables import side_by_side

MAPS = tuple(f"T{number}" for number in range(1, 8))


@pytest.fixture(scope="module")
def results() -> Results:
    """Two methods on seven maps at both densities: `fast_1` is at 8 m/s and finishes, `slow` at 2 m/s does not."""
    episodes = [
        episode(30, ended, driver=driver, map=map, density=density, speed=speed, route_done=done, traffic_speed=4.0)
        for driver, speed, done, ended in (("fast_1", 8.0, 100.0, "finished"), ("slow", 2.0, 25.0, "timeout"))
        for density in ("low", "high")
        for map in MAPS
        for _ in range(2)
    ]
    return work_out(episodes, paper=True)


def test_the_papers_layout(results: Results) -> None:
    lines = latex_text(results).splitlines()
    assert [line for line in lines if "rule{" not in line and line.startswith(r"\begin")] == [
        r"\begin{table*}[t]",
        r"\begin{tabular}{llrrrrrrrrrrrrrrrr}",
    ]
    assert r" & & \multicolumn{8}{c}{Low-density traffic} & \multicolumn{8}{c}{High-density traffic} \\" in lines, (
        "the densities stand over their columns"
    )
    assert r"\cmidrule(lr){3-10} \cmidrule(lr){11-18}" in lines
    assert r"Metric & Method & " + " & ".join((*MAPS, "Avg.") * 2) + r" \\" in lines
    body = [line for line in lines if line.endswith(r" \\")][2:]
    assert len(body) == len(PAPER) * 6
    assert {line.count("&") for line in body} == {17}
    assert [line.split(" & ")[0].strip() for line in body[::6]] == [
        r"Collision rate $\downarrow$", r"Similarity $\uparrow$", r"Timesteps $\uparrow$",
        r"Waypoint distance $\downarrow$", r"Efficiency $\uparrow$", r"Comfort $\uparrow$",
        r"Driving score $\uparrow$",
    ]  # fmt: skip
    text = "\n".join(lines)
    assert text.count("{") == text.count("}")
    for name in re.findall(r"\\begin\{(.*?)\}", text):
        assert text.count(rf"\begin{{{name}}}") == text.count(rf"\end{{{name}}}")


def test_the_best_is_bold_among_our_own(results: Results) -> None:
    score = [line for line in latex_text(results).splitlines() if line.startswith("Driving score")]
    assert score[0].split(" & ")[1:4] == [r"fast\_1", r"\textbf{100.0}", r"\textbf{100.0}"]
    layout = lay_out(results, ("driving_score", "mean_speed"))
    assert [cell.best for cell in layout.cells["driving_score", "slow"]] == [False] * 16
    # Higher, but from another simulator; and neither direction of a speed is better.
    assert not any(cell.best for method in layout.published for cell in layout.cells["driving_score", method])
    assert not any(cell.best for cell in layout.cells["mean_speed", "fast_1"])
    assert layout.columns[7] == ("low", AVERAGE)


def test_published_figures_are_the_papers() -> None:
    rows = published_rows(MAPS, ("low", "high"))
    found = {(r.method, r.metric, r.density, r.map): r.mean for r in rows}
    assert found["ME3-BEV (CARLA)", "collision_rate", "low", "T2"] == 0.59
    assert found["ME3-BEV (CARLA)", "driving_score", "high", AVERAGE] == 55.2
    assert found["e2e-CLA (CARLA)", "waypoint_distance", "low", AVERAGE] == 7.38
    # The ablation's table has no average: it is worked out.
    assert round(found["without SSA (CARLA)", "collision_rate", "low", AVERAGE], 2) == 0.59
    assert round(found["without TAFM (CARLA)", "driving_score", "high", AVERAGE], 1) == 30.4
    assert {r.metric for r in rows} == set(PAPER)
    assert len(rows) == len(METHODS) * len(PAPER) * 2 * 8
    assert all("(CARLA)" in r.method for r in rows)
    # Without all maps there is no average.
    assert {r.map for r in published_rows(("T3", "Town03"), ("low", "rush"))} == {"T3"}


def test_published_rows_are_kept_apart(results: Results) -> None:
    document = Outcome({}, results).document
    assert {row["method"] for row in document["rows"]} == {"fast_1", "slow"}
    assert "not comparable in absolute terms" in document["published"]["note"].replace("They are ", "")
    assert len(document["published"]["rows"]) == len(results.published)
    json.dumps(document["rows"][0])
    assert set(document["metrics"]) == set(METRICS)


def test_markdown(results: Results) -> None:
    text = markdown_text(results)
    blocks = text.split("### ")[1:]
    assert [block.splitlines()[0] for block in blocks] == ["Low density", "High density"]
    lines = [line for line in blocks[0].splitlines() if line.startswith("|")]
    assert lines[0] == "| metric | method | " + " | ".join((*MAPS, "Avg.")) + " |"
    assert {line.count("|") for line in lines} == {11}
    assert "| driving score ↑ | fast_1 |" + " **100.0** |" * 8 in lines
    # Published methods only stand where they have figures.
    assert sum("ME3-BEV (CARLA)" in line for line in lines) == len(PAPER)
    assert "not comparable in absolute terms" in text


def test_methods_stand_side_by_side(results: Results) -> None:
    from rich.console import Console

    shown = side_by_side(results)
    assert [headline for headline, _ in shown] == [
        "average over the maps, low density",
        "average over the maps, high density",
        "published, CARLA: average over the maps, low density",
        "published, CARLA: average over the maps, high density",
    ]
    for _, table in shown:
        console = Console(file=io.StringIO(), width=100)
        console.print(table)
        text = console.file.getvalue()  # type: ignore[attr-defined]
        assert "…" not in text
        assert "collision rate" in text


def test_what_is_significant_is_marked() -> None:
    episodes = [
        episode(30, driver=driver, speed=speed, route_done=done, seed=seed)
        for driver, speed, done in (("new", 8.0, 50.0), ("old", 2.0, 25.0))
        for seed in range(3)
    ]
    results = work_out(episodes, baseline="old")
    assert r"50.0}$^{+}$" in latex_text(results)
    assert "▲ better, ▼ worse than old" in markdown_text(results)
    assert "| driving score ↑ | new | **50.0** ▲ |" in markdown_text(results)
    document = Outcome({}, results).document
    assert document["baseline"] == "old"
    (score,) = [c for c in document["comparisons"] if c["metric"] == "driving_score"]
    assert (score["method"], score["difference"], score["significant"], score["verdict"]) == ("new", 25, True, "better")
    assert (score["improvement"], score["n"]) == (1.0, 3)


def test_latex_is_escaped() -> None:
    assert escape(r"a_b & 5% $x$ #1 {y} \n ~^") == (
        r"a\_b \& 5\% \$x\$ \#1 \{y\} \textbackslash{}n \textasciitilde{}\textasciicircum{}"
    )

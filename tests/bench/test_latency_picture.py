"""The picture holds what was measured: every network, each context, shares that add up."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import pytest

from me3bev_cli.bench import latency_picture as pictures
from me3bev_cli.bench.latency_network import STAGES
from me3bev_cli.bench.latency_tables import number, of_people


def row(name: str, kind: str = "window", length: int = 4, **more: Any) -> dict[str, Any]:
    stages = dict(zip(STAGES, (1.0, 6.0, 2.0, 0.5, 0.4, 0.1), strict=True))
    found = {
        "name": name, "spatial": "lift", "temporal": "gru", "fusion": "sum", "context": kind, "length": length,
        "own": kind == "window" and length == 4, "median_ms": 10.0, "p95_ms": 12.0,
        "stages": stages, "floor_ratio": 2.0,
    }  # fmt: skip
    return found | more


@pytest.fixture
def figures(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """Every figure that becomes a PNG."""
    seen: list[Any] = []
    real = pictures._png

    def png(figure: Any) -> bytes:
        seen.append(figure)
        return real(figure)

    monkeypatch.setattr(pictures, "_png", png)
    return seen


def axes_of(figure: Any) -> list[Any]:
    return [axes for part in (figure.subfigs or [figure]) for axes in part.axes]


def sweep(names: Sequence[str], **more: Any) -> list[dict[str, Any]]:
    return [row(n, kind, length, **more) for n in names for kind in ("window", "stream") for length in (4, 64)]


def test_a_line_for_each_network_and_kind(figures: list[Any]) -> None:
    assert pictures.latency_picture(sweep(["a", "b"]), "title", 11.0).startswith(b"\x89PNG")
    whole, temporal, times, shares = axes_of(figures[0])
    assert [axes.get_title() for axes in (whole, temporal)] == ["the whole", "the temporal stage"]
    # Four lines and the budget.
    assert len(whole.lines) == 5
    assert [line.get_linestyle() for line in temporal.lines] == ["--", "-", "--", "-"]
    assert list(temporal.lines[0].get_xdata()) == [4, 64]
    assert [label.get_text() for label in times.get_yticklabels()] == ["a", "b"]
    assert times.get_title() == "medians of the stages, ms; window 4"
    widths = [patch.get_width() for patch in shares.patches]
    assert sum(widths) == pytest.approx(200)
    # Control's one per cent is too narrow to be written into.
    assert [text.get_text() for text in shares.texts[:5]] == ["10", "60", "20", "5", "4"]


def test_a_budget_far_away_is_not_drawn(figures: list[Any]) -> None:
    pictures.latency_picture(sweep(["a"]), "title", 1000.0)
    assert len(axes_of(figures[0])[0].lines) == 2


def test_many_networks_have_a_panel_per_spatial_plugin(figures: list[Any]) -> None:
    light = sweep([f"l-{i}" for i in range(5)], spatial="light")
    heavy = sweep([f"h-{i}" for i in range(5)], spatial="heavy", temporal="lstm")
    for found in heavy:
        found["stages"] = found["stages"] | {"temporal": 7.0}
    pictures.latency_picture(light + heavy, "title")
    titles = [axes.get_title() for axes in axes_of(figures[0])[:3]]
    assert titles == [
        "the whole, light, a line per network",
        "the whole, heavy, a line per network",
        "the temporal stage, heavy",
    ]


def test_one_context_has_no_lines(figures: list[Any]) -> None:
    pictures.latency_picture([row("a"), row("b", "none", 1, own=True)], "title")
    pictures.latency_picture([row("b", "none", 1, own=True)], "title")
    assert [len(axes_of(figure)) for figure in figures] == [2, 2]
    labels = [label.get_text() for label in axes_of(figures[0])[0].get_yticklabels()]
    assert labels == ["a, window 4", "b, none"]


def test_people_see_a_networks_own_context() -> None:
    found = [
        row("a", own=False), row("a", length=8, own=True), row("a", "stream", own=False),
        row("s", own=False), row("s", "stream", 4, own=True), row("s", "stream", 64, own=True),
        row("x", length=9, own=False), row("x", length=99, own=False),
    ]  # fmt: skip
    assert [(r["name"], r["context"], r["length"]) for r in of_people(found)] == [
        ("a", "window", 8),
        ("s", "stream", 64),
        ("x", "window", 9),
    ]


@pytest.mark.parametrize(
    ("value", "text"), [(0.0, "0.00"), (1.234, "1.23"), (12.34, "12.3"), (123.4, "123"), (12345.6, "12346")]
)
def test_three_figures(value: float, text: str) -> None:
    assert number(value) == text

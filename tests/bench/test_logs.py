"""The benchmark of logs measures what it says, on the line world."""

from __future__ import annotations

from pathlib import Path

import pytest

from me3bev_cli.api import ObservationConfig
from me3bev_cli.bench.logs import ROWS, SAMPLES, TARGETS, measure, report


def test_the_figures_are_there_and_printed(line_plugins: None, tmp_path: Path) -> None:
    figures = measure("line", "F1", "low", 2, tmp_path, ObservationConfig(height=16, width=32))
    assert {key for _, key, _ in ROWS} <= set(figures)
    assert all(figures[key] > 0 for _, key, _ in ROWS)
    assert set(TARGETS) <= set(figures)
    assert figures["setup"]["rounds"] == 2
    assert SAMPLES > 12
    logs = sorted(tmp_path.glob("*.mcap"))
    assert figures["bytes_per_step"] == pytest.approx(sum(path.stat().st_size for path in logs) / 24)
    text = report(figures)
    assert "wanted at least 0.8" in text
    assert "wanted at most 15" in text

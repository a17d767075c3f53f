"""The benchmark of logs measures what it says, on the line world."""

from __future__ import annotations

from pathlib import Path

import pytest

from me3bev_cli.api import ObservationConfig
from me3bev_cli.bench.logs import ROWS, SAMPLES, TARGETS, main, measure, report
from me3bev_cli.evaluation.drivers import DriverSpec
from me3bev_cli.evaluation.runner import World
from me3bev_cli.recipe import PluginChoice
from me3bev_cli.recording.collect import Recorder


def test_the_figures_are_there_and_printed(line_plugins: None, tmp_path: Path) -> None:
    world = World(PluginChoice(name="line"), ObservationConfig(height=16, width=32))
    figures = measure(Recorder(world, DriverSpec("autopilot", "autopilot"), 0, tmp_path), "F1", "low", 2)
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


def test_mistakes_are_told(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--here", "--map", "T99"]) == 2
    assert "unknown map 'T99'" in capsys.readouterr().err

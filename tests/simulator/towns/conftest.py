"""A library of maps of its own for each test."""

from __future__ import annotations

from pathlib import Path

import pytest
from simulator.opendrive_text import stadium

from me3bev_plugins.simulator.highway import Highway, HighwayConfig


@pytest.fixture
def data(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The user's data folder, which does not exist yet."""
    monkeypatch.setenv("ME3BEV_DATA", str(tmp_path / "data"))
    return tmp_path / "data"


@pytest.fixture
def world(data: Path) -> Highway:
    return Highway(HighwayConfig())


@pytest.fixture
def ring(tmp_path: Path) -> Path:
    path = tmp_path / "Ring.xodr"
    path.write_bytes(stadium())
    return path

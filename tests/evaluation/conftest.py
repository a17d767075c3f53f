"""Fixtures of the evaluation's tests."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from me3bev_cli import registry

# Worker processes inherit the path, so they find these modules too.
sys.path.insert(0, str(Path(__file__).parent / "support"))


@pytest.fixture
def scripted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """The simulators of `scripted_world.py`, installed as a distribution would be, for every process."""
    site = tmp_path / "site"
    info = site / "scripted_world-1.0.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: scripted-world\nVersion: 1.0\n")
    entries = "[me3bev.simulator]\nscripted = scripted_world:Scripted\nwrong = scripted_world:Wrong\n"
    (info / "entry_points.txt").write_text(entries)
    monkeypatch.syspath_prepend(str(site))
    monkeypatch.setenv("ME3BEV_RUNS", str(tmp_path / "runs"))
    registry.clear()
    yield
    registry.clear()

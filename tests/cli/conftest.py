"""Fixtures of the command line's tests."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from importlib.metadata import EntryPoint
from pathlib import Path

import plugin_fakes
import pytest

from me3bev_cli import registry

Install = Callable[..., None]


@pytest.fixture
def install(monkeypatch: pytest.MonkeyPatch) -> Iterator[Install]:
    """Replaces what is installed by the entry points that it is called with."""
    monkeypatch.setitem(sys.modules, plugin_fakes.MODULE, plugin_fakes.module())

    def install(*points: EntryPoint) -> None:
        def entry_points(group: str) -> list[EntryPoint]:
            return [point for point in points if point.group == group]

        monkeypatch.setattr(registry, "entry_points", entry_points)
        registry.clear()

    yield install
    monkeypatch.undo()
    registry.clear()


@pytest.fixture
def fakes(install: Install) -> None:
    """The plugins of `plugin_fakes`, and no others, are installed."""
    install(*plugin_fakes.every())


@pytest.fixture
def recipe(fakes: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., str]:
    """Writes a recipe file into the current folder and gives its name; by default a sound one."""
    monkeypatch.chdir(tmp_path)

    def write(text: str = plugin_fakes.RECIPE, name: str = "mine.yaml") -> str:
        Path(name).write_text(text)
        return name

    return write

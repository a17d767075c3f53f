"""Fixtures that more than one folder of tests uses."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

os.environ.setdefault("SDL_VIDEODRIVER", "dummy")
for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(name, "1")

# A shell starts background jobs with Ctrl-C ignored, and their children inherit that: what is tested here needs it.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN and threading.current_thread() is threading.main_thread():
    signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Tests marked `cuda` are for those who have a GPU."""
    if item.get_closest_marker("cuda") is not None:
        import torch

        if not torch.cuda.is_available():
            pytest.skip("there is no GPU")


@pytest.fixture(scope="session", autouse=True)
def _no_imported_maps(tmp_path_factory: pytest.TempPathFactory) -> None:
    """The maps that whoever runs the tests has imported are not theirs."""
    os.environ["ME3BEV_DATA"] = str(tmp_path_factory.mktemp("data"))


@pytest.fixture
def line_plugins(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """The fake plugins of `fakes.py`, installed."""
    from fakes import installed

    with installed(monkeypatch):
        yield


@pytest.fixture
def line_recipe(line_plugins: None, tmp_path: Path) -> Path:
    """A recipe file over the fake plugins."""
    from fakes import RECIPE

    path = tmp_path / "line.yaml"
    path.write_text(RECIPE)
    return path

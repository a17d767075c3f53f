"""Compiled kernels are kept until a source changes."""

from __future__ import annotations

import os
from pathlib import Path

from me3bev_plugins.simulator.highway.compiled import discard_stale, kernel


def test_a_kernel_computes_what_its_source_says() -> None:
    @kernel
    def third(x: float) -> float:
        return x / 3.0

    assert third(1.5) == 0.5


def test_compiled_code_goes_when_any_source_changes(tmp_path: Path) -> None:
    source, index = tmp_path / "a.py", tmp_path / "__pycache__" / "b.nbi"
    source.write_text("x = 1\n")
    assert discard_stale(tmp_path)
    index.write_text("compiled")
    assert not discard_stale(tmp_path)
    assert index.exists()
    source.write_text("x = 2\n")
    os.utime(source, ns=(1, 1))
    assert discard_stale(tmp_path)
    assert not index.exists()

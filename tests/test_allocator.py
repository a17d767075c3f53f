"""Training keeps its freed memory where the C library can."""

from __future__ import annotations

import ctypes
import platform

import pytest

from me3bev_cli.allocator import keep_freed_memory


def test_it_says_whether_the_library_can(monkeypatch: pytest.MonkeyPatch) -> None:
    called: list[tuple[int, int]] = []

    class Library:
        def mallopt(self, name: int, value: int) -> int:
            called.append((name, value))
            return 1

    monkeypatch.setattr(ctypes, "CDLL", lambda _: Library())
    assert keep_freed_memory()
    assert {name for name, _ in called} == {-1, -2, -3}


def test_without_it_nothing_happens(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ctypes, "CDLL", lambda _: object())
    assert not keep_freed_memory()


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="asks glibc itself")
def test_glibc_takes_the_settings() -> None:
    assert keep_freed_memory()

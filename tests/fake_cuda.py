"""The parts of torch.cuda that timing rests on, over CPU tensors: a clock by hand, and graphs that replay what was
recorded on the memory it was recorded with, as the device does."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from typing import Any

import pytest
import torch
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_flatten


class FakeCuda:
    """Installed by `fake_cuda`; `now` is the device's clock, `log` what was asked of it."""

    def __init__(self) -> None:
        self.now = 0.0
        self.log: list[str] = []
        self.mode: str | int = 0
        self.recorded = 0


class Recorder(TorchDispatchMode):
    """Notes every operation with the tensors that it read and made."""

    def __init__(self) -> None:
        super().__init__()
        self.calls: list[tuple[Any, Any, Any, list[Any]]] = []

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        result = func(*args, **(kwargs or {}))
        self.calls.append((func, args, kwargs or {}, tree_flatten(result)[0]))
        return result


class Graph:
    """What was recorded, done again into the same places."""

    def __init__(self) -> None:
        self.calls: list[tuple[Any, Any, Any, list[Any]]] = []

    @torch.inference_mode()
    def replay(self) -> None:
        for func, args, kwargs, made in self.calls:
            for old, new in zip(made, tree_flatten(func(*args, **kwargs))[0], strict=True):
                if isinstance(old, torch.Tensor) and old.data_ptr() != new.data_ptr():
                    old.copy_(new)


def install(monkeypatch: pytest.MonkeyPatch) -> FakeCuda:
    """Put the fakes in torch.cuda's place."""
    fake = FakeCuda()

    class Event:
        def __init__(self, enable_timing: bool = False) -> None:
            assert enable_timing

        def record(self, stream: Any = None) -> None:
            self.at = fake.now
            fake.log.append("record")

        def synchronize(self) -> None:
            fake.log.append("wait for event")

        def elapsed_time(self, other: Event) -> float:
            return other.at - self.at

    class Stream:
        def wait_stream(self, other: Any) -> None:
            fake.log.append("wait for stream")

    @contextmanager
    def graph(target: Graph) -> Iterator[None]:
        assert fake.mode == 0, "recording while synchronisation is an error"
        with Recorder() as recorder:
            yield
        target.calls = recorder.calls
        fake.recorded += 1

    def set_mode(mode: str | int) -> None:
        fake.mode = mode

    for name, value in {
        "Event": Event,
        "Stream": Stream,
        "CUDAGraph": Graph,
        "graph": graph,
        "stream": lambda _: nullcontext(),
        "current_stream": lambda *_: Stream(),
        "synchronize": lambda *_: fake.log.append("synchronise"),
        "get_sync_debug_mode": lambda: fake.mode,
        "set_sync_debug_mode": set_mode,
    }.items():
        monkeypatch.setattr(torch.cuda, name, value)
    return fake

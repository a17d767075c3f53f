"""How stages are run and timed on a device: host clock and plain calls, or CUDA events and graphs."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any, Protocol

import torch

from me3bev_cli.pipeline.tree import map_tree

Function = Callable[..., Any]


class Clock(Protocol):
    """Marks moments; what lies between them is known once the last one has been reached."""

    def begin(self) -> Any:
        """The first mark: nothing that was asked for before is still under way."""
        ...

    def mark(self) -> Any:
        """Everything asked for so far is done at this mark."""
        ...

    def intervals(self, marks: Sequence[Any]) -> list[float]:
        """Milliseconds between neighbours."""
        ...


class HostClock:
    """For the CPU, where a call returns when it is done."""

    def begin(self) -> float:
        return time.perf_counter()

    def mark(self) -> float:
        return time.perf_counter()

    def intervals(self, marks: Sequence[float]) -> list[float]:
        return [1000 * (after - before) for before, after in pairwise(marks)]


class EventClock:
    """For CUDA: events in the stream of the work, so that timing adds no synchronisation between stages.

    The device is idle at `begin`, so its event is reached at once and what the host takes to prepare the first
    kernel is counted.
    """

    def __init__(self, device: torch.device) -> None:
        self.device = device

    def begin(self) -> Any:
        torch.cuda.synchronize(self.device)
        return self.mark()

    def mark(self) -> Any:
        event = torch.cuda.Event(enable_timing=True)  # type: ignore[no-untyped-call]
        event.record(torch.cuda.current_stream(self.device))
        return event

    def intervals(self, marks: Sequence[Any]) -> list[float]:
        marks[-1].synchronize()
        return [float(before.elapsed_time(after)) for before, after in pairwise(marks)]


def clock_for(device: torch.device) -> Clock:
    """The device's clock."""
    return EventClock(device) if device.type == "cuda" else HostClock()


class Graphed:
    """A stage as a CUDA graph: inputs are copied to fixed places, the recorded kernels are replayed.

    Results lie in fixed places too and last until the next call.
    """

    WARMUP = 3

    def __init__(self, function: Function, example: Sequence[Any]) -> None:
        self.inputs = tuple(map_tree(torch.clone, tree) for tree in example)
        side = torch.cuda.Stream()  # type: ignore[no-untyped-call]
        side.wait_stream(torch.cuda.current_stream())
        # Libraries choose algorithms and make workspaces in their first calls, which must not be recorded.
        with torch.cuda.stream(side):
            for _ in range(self.WARMUP):
                function(*self.inputs)
        torch.cuda.current_stream().wait_stream(side)
        self.graph = torch.cuda.CUDAGraph()
        with torch.cuda.graph(self.graph):
            self.result = function(*self.inputs)

    def __call__(self, *inputs: Any) -> Any:
        for fixed, given in zip(self.inputs, inputs, strict=True):
            map_tree(_fill, fixed, given)
        self.graph.replay()
        return self.result


def _fill(fixed: torch.Tensor, given: torch.Tensor) -> None:
    if fixed is not given:
        fixed.copy_(given)


def graphed(function: Function, example: Sequence[Any]) -> Function:
    """The function as a graph, or as it is where it waits for the device or cannot be recorded."""
    function(*example)
    mode = torch.cuda.get_sync_debug_mode()
    try:
        # A failed recording leaves the stream in a bad state, so what would fail is found out before.
        torch.cuda.set_sync_debug_mode("error")
        function(*example)
        torch.cuda.set_sync_debug_mode(mode)
        return Graphed(function, example)
    except RuntimeError:
        return function
    finally:
        torch.cuda.set_sync_debug_mode(mode)

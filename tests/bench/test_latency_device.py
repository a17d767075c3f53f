"""CUDA's clock and graphs, with the device faked where it must be: what is recorded is really replayed."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import fake_cuda
import numpy as np
import pytest
import torch

from me3bev_cli.bench.latency_device import EventClock, Graphed, HostClock, clock_for, graphed
from me3bev_cli.bench.latency_network import Bench, Conditions
from me3bev_cli.bench.latency_subjects import Subject
from me3bev_cli.recipe_loading import resolve_recipe

Trees = dict[str, Any]


@pytest.fixture
def cuda(monkeypatch: pytest.MonkeyPatch) -> fake_cuda.FakeCuda:
    return fake_cuda.install(monkeypatch)


def test_the_clock_follows_the_device() -> None:
    assert isinstance(clock_for(torch.device("cpu")), HostClock)
    assert isinstance(clock_for(torch.device("cuda", 1)), EventClock)


def test_the_host_clock_counts_milliseconds() -> None:
    assert HostClock().intervals([1.0, 1.5, 3.5]) == [500, 2000]
    clock = HostClock()
    assert clock.intervals([clock.begin(), clock.mark()])[0] >= 0


def test_events_lie_in_the_stream_and_are_waited_for_once(cuda: fake_cuda.FakeCuda) -> None:
    """The device is idle at the first mark; nothing is waited for until the last one."""
    clock = EventClock(torch.device("cuda"))
    marks = [clock.begin()]
    for now in (3.0, 10.0):
        cuda.now = now
        marks.append(clock.mark())
    assert clock.intervals(marks) == [3, 7]
    assert cuda.log == ["synchronise", "record", "record", "record", "wait for event"]


def test_a_graph_reads_new_inputs_and_writes_where_it_did(cuda: fake_cuda.FakeCuda) -> None:
    def stage(x: torch.Tensor, state: Trees) -> tuple[torch.Tensor, Trees]:
        total = state["sum"] + x
        return total * 2, {"sum": total, "none": None}

    first = torch.ones(3), {"sum": torch.zeros(3), "none": None}
    with torch.inference_mode():
        run = graphed(stage, first)
        assert isinstance(run, Graphed)
        y, state = run(*first)
        assert y.tolist() == [2, 2, 2]
        place = y.data_ptr()
        y, state = run(torch.full((3,), 4.0), state)
        assert y.data_ptr() == place
        assert (y.tolist(), state["sum"].tolist()) == ([10, 10, 10], [5, 5, 5])
        y, state = run(torch.full((3,), 1.0), state)
        assert y.tolist() == [12, 12, 12]
    assert first[1]["sum"].tolist() == [0, 0, 0]


def test_what_waits_for_the_device_is_not_recorded(cuda: fake_cuda.FakeCuda) -> None:
    def waits(x: torch.Tensor) -> torch.Tensor:
        if cuda.mode == "error":
            raise RuntimeError("called a synchronizing CUDA operation")
        return x * int(x.max())

    assert graphed(waits, [torch.ones(2)]) is waits
    assert (cuda.recorded, cuda.mode) == (0, 0)


def test_what_cannot_be_recorded_runs_as_it_is(cuda: fake_cuda.FakeCuda, monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(*_: Any) -> Any:
        raise RuntimeError("operation not permitted when stream is capturing")

    monkeypatch.setattr(torch.cuda, "graph", refused)
    assert graphed(torch.neg, [torch.ones(2)]) is torch.neg
    assert cuda.mode == 0


def test_a_defect_of_a_stage_is_not_hidden(cuda: fake_cuda.FakeCuda) -> None:
    def broken(x: torch.Tensor) -> torch.Tensor:
        return x @ torch.ones(7)

    with pytest.raises(RuntimeError, match="size"):
        graphed(broken, [torch.ones(2)])


@pytest.mark.parametrize("temporal", ["gru", "lstm"])
def test_replayed_stages_give_the_actions_of_plain_ones(
    line_recipe: Path, cuda: fake_cuda.FakeCuda, monkeypatch: pytest.MonkeyPatch, temporal: str
) -> None:
    """Frame by frame, in both contexts: the state goes around through the graphs' fixed places."""
    recipe = resolve_recipe(line_recipe, [f"temporal={{name: {temporal}}}"])
    conditions = Conditions(torch.device("cpu"))
    torch.manual_seed(0)
    plain = Bench(Subject("plain", recipe), conditions, [4])
    monkeypatch.setattr(Conditions, "_records", True)
    torch.manual_seed(0)
    replayed = Bench(Subject("replayed", recipe), conditions, [4])
    # Sensor and encoders once; memory, fusion and policy in each of two contexts.
    assert cuda.recorded == 2 + 2 * 3
    generator = np.random.default_rng(1)
    for _ in range(4):
        for key, value in plain.observation.items():
            value[:] = (
                generator.integers(0, 256, value.shape) if value.dtype == np.uint8 else generator.random(value.shape)
            )
            replayed.observation[key][:] = value
        for bench in (plain, replayed):
            bench.turn(bench.variants)
        for mine, other in zip(plain.variants, replayed.variants, strict=True):
            assert mine.action is not None
            np.testing.assert_allclose(mine.action, other.action, atol=1e-6)
    assert np.ptp([v.action for v in plain.variants]) > 0

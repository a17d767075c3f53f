"""The benchmark of the temporal modules: its ratios by hand, and that it measures and prints what it says."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import pytest
import torch

from me3bev_cli.bench import temporal
from me3bev_cli.bench.temporal_contestants import MambapyStream, Stream, backends, steps
from me3bev_cli.bench.temporal_contestants import temporal as plugin


def test_ratios_are_medians_of_turns_by_hand() -> None:
    """Turn by turn 6 / 1, 8 / 2 and 9 / 1, so 6; the quotient of the medians would be 8."""
    times: dict[str, Any] = {
        "step": {"mambapy": [6.0, 8.0, 9.0], "native": [1.0, 2.0, 1.0]},
        "train": {"mambapy": [4.0], "torch": [2.0]},
        "context": {"step_short": [2.0, 4.0], "step_long": [1.0, 2.0], "transformer_window": [75.0]},
    }
    assert temporal.ratios(times) == {
        "step_native_ratio": 6.0,
        "train_torch_ratio": 2.0,
        "window_ratio": 50.0,
        "context_ratio": 0.5,
    }


def test_each_begins_in_turn() -> None:
    order: list[str] = []
    contestants = {name: (lambda name=name: order.append(name)) for name in "abc"}
    times: temporal.Times = {}
    for _ in range(3):
        temporal.take_turns(contestants, times, 2)
    assert "".join(order) == "aaabbbccc" + "bbbcccaaa" + "cccaaabbb", "one call more than is timed"
    assert [len(values) for values in times.values()] == [3, 3, 3]


def test_a_measurement_without_the_peer(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "mambapy", None)
    monkeypatch.setitem(sys.modules, "mambapy.mamba", None)
    monkeypatch.setattr(temporal, "STEPS_PER_TURN", 1)
    monkeypatch.setattr(temporal, "LONG", 32)
    monkeypatch.setattr(temporal, "_in_process", temporal.measure)
    threads = torch.get_num_threads()
    try:
        path = tmp_path / "figures.json"
        assert temporal.main(["--width", "16", "--rounds", "1", "--json", str(path)]) == 0
    finally:
        torch.set_num_threads(threads)
    found = json.loads(path.read_text())
    assert set(found["median_ms"]["step"]) == {*backends(), "products"}
    assert set(found["ratios"]) == {
        "window_ratio",
        "context_ratio",
        *(["products_ratio"] if "native" in backends() else []),
    }
    assert found["setup"]["threads"] == 1
    printed = capsys.readouterr().out
    assert "mambapy is not installed: pip install 'me3bev[bench]'" in printed
    assert "wanted 100" in printed


def test_the_peer_computes_the_same_step() -> None:
    """Both sides do the same work: mambapy's block with our weights gives our output."""
    pytest.importorskip("mambapy")
    from me3bev_cli.bench.temporal_contestants import mambapy_blocks

    (block,) = mambapy_blocks(32, 1)
    ours = plugin("mamba", 32)
    weights = {name.removeprefix("mixer."): value for name, value in block.state_dict().items()}
    ours.load_state_dict(weights)
    peer, stream = MambapyStream([block], 32), Stream([ours], 32, 0)
    stream.x = peer.x[None]
    with torch.no_grad():
        for _ in range(5):
            y, stream.states[0] = ours(stream.x, stream.states[0], stream.none)
            expected, peer.caches[0] = block.step(peer.x, peer.caches[0])
            torch.testing.assert_close(y[0], expected, rtol=1e-4, atol=1e-5)


def test_steps_are_of_three_modalities() -> None:
    contestants = steps(16)
    for name in backends():
        stream = contestants[name]
        assert isinstance(stream, Stream)
        assert len(stream.modules) == 3

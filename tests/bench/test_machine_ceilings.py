"""The floor under a stage, from rates set by hand, and the rates from work that takes a known time."""

from __future__ import annotations

import pytest
import torch

from me3bev_cli.bench.machine_ceilings import TRIES, Ceilings


def ceilings() -> Ceilings:
    return Ceilings(torch.device("cpu"), torch.float32, side=16, read=4096)


def test_the_floor_is_the_larger_of_two_times() -> None:
    found = ceilings()
    found.multiply, found.read = [1e9, 2e9, 9e9], [1e8, 5e8, 6e8]
    assert found.floor_ms(flops=4_000_000, read=0) == 2
    assert found.floor_ms(flops=4_000_000, read=5_000_000) == 10
    report = found.report()
    assert (report["multiply_flops_per_s"], report["read_bytes_per_s"], report["samples"]) == (2e9, 5e8, 3)
    assert report["spread"]["multiply_flops_per_s"] == [1.5e9, 5.5e9]


def test_a_sample_is_the_fastest_of_a_few_tries(monkeypatch: pytest.MonkeyPatch) -> None:
    """A clock that goes on by 4, 3, 2 s in a try of the first, and by 8, 7, 6 s in one of the second."""
    ticks = [tick for took in (4, 3, 2, 8, 7, 6) for tick in (0.0, float(took))]
    assert len(ticks) == 4 * TRIES
    monkeypatch.setattr("me3bev_cli.bench.machine_ceilings.time.perf_counter", lambda: ticks.pop(0))
    found = ceilings()
    found.sample()
    assert found.multiply == [2 * 16**3 / 2]
    assert found.read == [4096 / 6]


@pytest.mark.parametrize("dtype", [torch.float32, torch.bfloat16])
def test_rates_are_measured_in_the_type_that_is_used(dtype: torch.dtype) -> None:
    found = Ceilings(torch.device("cpu"), dtype, side=16, read=4096)
    found.sample()
    assert found.flops_per_s > 0
    assert found.bytes_per_s > 0

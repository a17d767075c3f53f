"""mamba-ssm's kernel: when it is chosen, and that what surrounds it is exact; with a stand-in, and on a real device."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from types import ModuleType
from typing import Any

import pytest
import torch
from torch import Tensor

from me3bev_plugins.temporal import cuda_scan
from me3bev_plugins.temporal.mamba import Mamba
from me3bev_plugins.temporal.scan import selective_scan

MODULE = "mamba_ssm.ops.selective_scan_interface"


def stand_in(u: Tensor, delta: Tensor, A: Tensor, B: Tensor, C: Tensor) -> Tensor:
    """The published kernel's interface: u and delta (B, E, T), A (E, N), B and C (B, N, T) -> (B, E, T)."""
    assert u.shape == delta.shape
    assert A.shape == (u.shape[1], B.shape[1])
    h, ys = u.new_zeros(*u.shape[:2], A.shape[1]), []
    for t in range(u.shape[2]):
        h = torch.exp(delta[:, :, t, None] * A) * h + (delta[:, :, t] * u[:, :, t])[:, :, None] * B[:, None, :, t]
        ys.append((h * C[:, None, :, t]).sum(-1))
    return torch.stack(ys, -1)


@pytest.fixture
def calls(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[tuple[int, ...]]]:
    """Shapes that the stand-in was called with; it is installed, and this machine's tensors count as a GPU's."""
    seen: list[tuple[int, ...]] = []
    interface: Any = ModuleType(MODULE)

    def selective_scan_fn(u: Tensor, *others: Tensor) -> Tensor:
        seen.append(tuple(u.shape))
        return stand_in(u, *others)

    interface.selective_scan_fn = selective_scan_fn
    for name in ("mamba_ssm", "mamba_ssm.ops"):
        monkeypatch.setitem(sys.modules, name, ModuleType(name))
    monkeypatch.setitem(sys.modules, MODULE, interface)
    monkeypatch.setattr(cuda_scan, "on_cuda", lambda x: True)
    cuda_scan.kernel.cache_clear()
    yield seen
    cuda_scan.kernel.cache_clear()


def inputs(frames: int, dtype: torch.dtype = torch.float32, device: str = "cpu") -> list[Tensor]:
    """x, delta, A, B, C and a state, of 2 rows, 6 channels and 3 states."""
    torch.manual_seed(frames)
    x, delta = torch.randn(2, frames, 6), torch.rand(2, frames, 6) * 2
    B, C = torch.randn(2, 2, frames, 3)
    parts = [x, delta, -torch.rand(3, 6) * 4, B, C, torch.randn(2, 3, 6)]
    return [part.to(device, dtype).requires_grad_() for part in parts]


def results(parts: list[Tensor], starts: Tensor) -> list[Tensor]:
    y, last = selective_scan(*parts, starts)  # type: ignore[misc]
    torch.manual_seed(0)
    loss = (y * torch.randn(y.shape).to(y)).sum() + (last * torch.randn(last.shape).to(last)).sum()
    return [y, last, *torch.autograd.grad(loss, parts)]


def compare(parts: list[Tensor], starts: Tensor) -> None:
    """The kernel's way in float32 against our own in float64."""
    exact = [part.detach().cpu().double().requires_grad_() for part in parts]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(cuda_scan, "on_cuda", lambda x: False)
        expected = results(exact, starts.cpu())
    for given, right in zip(results(parts, starts), expected, strict=True):
        torch.testing.assert_close(given.cpu().double(), right, rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("frames", [2, 7, 40])
def test_the_state_before_and_after_are_made_good(frames: int, calls: list[tuple[int, ...]]) -> None:
    starts = torch.zeros(2, frames, dtype=torch.bool)
    starts[1, 0] = True
    compare(inputs(frames), starts)
    assert calls == [(2, 6, frames + 3)]


def test_an_empty_state_costs_nothing_more(calls: list[tuple[int, ...]], monkeypatch: pytest.MonkeyPatch) -> None:
    *parts, state = inputs(5)
    monkeypatch.setattr(Tensor, "cumsum", None)
    y, _ = selective_scan(*parts, torch.zeros_like(state), torch.zeros(2, 5, dtype=torch.bool))  # type: ignore[misc]
    assert y.shape == (2, 5, 6)
    assert len(calls) == 1


def test_starts_inside_and_other_numbers_go_the_other_way(calls: list[tuple[int, ...]]) -> None:
    starts = torch.zeros(2, 5, dtype=torch.bool)
    starts[0, 3] = True
    compare(inputs(5), starts)
    results(inputs(5, torch.float64), torch.zeros_like(starts))
    results(inputs(1), torch.zeros_like(starts[:, :1]))
    assert calls == []


def test_a_kernel_that_does_not_load_is_not_missed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "mamba_ssm", None)
    monkeypatch.setattr(cuda_scan, "on_cuda", lambda x: True)
    cuda_scan.kernel.cache_clear()
    try:
        assert len(results(inputs(4), torch.zeros(2, 4, dtype=torch.bool))) == 8
    finally:
        cuda_scan.kernel.cache_clear()


@pytest.mark.cuda
@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device")
def test_the_real_kernel_equals_ours() -> None:
    pytest.importorskip("mamba_ssm")
    for frames in (2, 64, 256):
        parts = inputs(frames, device="cuda")
        starts = torch.zeros(2, frames, dtype=torch.bool, device="cuda")
        assert cuda_scan.suits(parts[0], starts)
        compare(parts, starts)


@pytest.mark.cuda
@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device")
def test_a_block_on_a_device_equals_that_on_the_cpu() -> None:
    torch.manual_seed(0)
    module = Mamba(Mamba.Config(backend="torch"), 16)
    x, starts = torch.randn(3, 12, 16), torch.rand(3, 12) < 0.2
    expected, last = module(x, module.initial_state(3), starts)
    module.cuda()
    y, after = module(x.cuda(), module.initial_state(3), starts.cuda())
    torch.testing.assert_close(y.cpu(), expected, rtol=1e-4, atol=1e-5)
    torch.testing.assert_close(after["ssm"].cpu(), last["ssm"], rtol=1e-4, atol=1e-5)

"""Copies to a device: through pinned memory and without waiting on CUDA, without a copy on the CPU."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch

from me3bev_cli.pipeline.transfer import gather, to_device, to_tensors

CPU, CUDA = torch.device("cpu"), torch.device("cuda")


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """What a GPU that is not there is asked for; its tensors stay on the CPU."""
    log: list[Any] = []
    to, empty = torch.Tensor.to, torch.empty

    def fake_to(tensor: torch.Tensor, device: Any, *args: Any, **kwargs: Any) -> torch.Tensor:
        if isinstance(device, torch.device) and device.type == "cuda":
            log.append(("copy", kwargs))
            return tensor
        return to(tensor, device, *args, **kwargs)

    def fake_empty(*args: Any, pin_memory: bool = False, **kwargs: Any) -> torch.Tensor:
        log.append(("empty", pin_memory))
        return empty(*args, **kwargs)

    def fake_pin(tensor: torch.Tensor) -> torch.Tensor:
        log.append("pin")
        return tensor.clone()

    monkeypatch.setattr(torch.Tensor, "to", fake_to)
    monkeypatch.setattr(torch.Tensor, "pin_memory", fake_pin)
    monkeypatch.setattr(torch, "empty", fake_empty)
    return log


def test_on_the_cpu_memory_is_shared() -> None:
    array = np.arange(6, dtype=np.uint8)
    tensor = to_device(array, CPU)
    array[0] = 7
    assert tensor.dtype == torch.uint8
    assert tensor[0] == 7


def test_gather_takes_rows() -> None:
    array = np.arange(24, dtype=np.uint8).reshape(6, 2, 2)
    rows = np.array([5, 0, 0])
    assert np.array_equal(gather(array, rows, CPU).numpy(), array[rows])


def test_cuda_copies_are_pinned_and_do_not_wait(asked: list[Any]) -> None:
    to_tensors({"road": np.ones((2, 9), np.float32)}, CUDA)
    assert asked == ["pin", ("copy", {"non_blocking": True})]
    asked.clear()
    array = np.arange(24, dtype=np.uint8).reshape(6, 4)
    got = gather(array, np.array([3, 1]), CUDA)
    assert asked == [("empty", True), ("copy", {"non_blocking": True})]
    assert np.array_equal(got.numpy(), array[[3, 1]])


@pytest.mark.cuda
def test_what_arrives_on_a_gpu_is_what_was_sent() -> None:
    array = np.random.default_rng(0).integers(0, 256, (64, 3, 32, 32), np.uint8)
    rows = np.random.default_rng(1).permutation(64)
    for _ in range(20):
        # Pinned memory is used again and again while copies are under way.
        assert np.array_equal(gather(array, rows, CUDA).cpu().numpy(), array[rows])
        assert np.array_equal(to_device(array, CUDA).cpu().numpy(), array)

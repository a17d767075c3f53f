"""Mamba against the recurrence written out in float64, frame by frame."""

from __future__ import annotations

from typing import Any

import pytest
import torch
import torch.nn.functional as F
from naive_mamba import recurrence
from torch import Tensor

from me3bev_plugins.temporal import scan
from me3bev_plugins.temporal.mamba import Mamba


def reference(module: Mamba, x: Tensor, state: dict[str, Tensor], starts: Tensor) -> tuple[Tensor, Tensor]:
    """y (B, T, D) and the last h (B, N, E)."""
    y, after = recurrence(module, x, state, starts)
    return y, after["ssm"]


def make(width: int = 8, seed: int = 0, **keys: Any) -> Mamba:
    torch.manual_seed(seed)
    return Mamba(Mamba.Config(**keys), width).double()


def memory(module: Mamba, batch: int) -> dict[str, Tensor]:
    return {name: torch.randn_like(leaf) for name, leaf in module.initial_state(batch).items()}


def compare(module: Mamba, x: Tensor, state: dict[str, Tensor], starts: Tensor) -> None:
    """Outputs to 1e-6, gradients of everything to 1e-5, relative."""
    x = x.requires_grad_()
    state = {name: leaf.requires_grad_() for name, leaf in state.items()}
    wanted = {"x": x, **state, **dict(module.named_parameters())}
    results = []
    for y, last in (reference(module, x, state, starts), _ours(module, x, state, starts)):
        torch.manual_seed(5)
        loss = sum((out * torch.randn(out.shape, dtype=out.dtype)).sum() for out in (y, last))
        results.append((y, last, torch.autograd.grad(loss, list(wanted.values()))))
    expected, given = results
    torch.testing.assert_close(given[0], expected[0], rtol=1e-6, atol=1e-9)
    torch.testing.assert_close(given[1], expected[1], rtol=1e-6, atol=1e-9)
    for name, ours, theirs in zip(wanted, given[2], expected[2], strict=True):
        torch.testing.assert_close(ours, theirs, rtol=1e-5, atol=1e-9, msg=lambda text, name=name: f"{name}: {text}")


def _ours(module: Mamba, x: Tensor, state: dict[str, Tensor], starts: Tensor) -> tuple[Tensor, Tensor]:
    y, after = module(x, state, starts)
    return y, after["ssm"]


@pytest.mark.parametrize("frames", [1, 2, 3, 4, 7, 16, 64, 256])
def test_outputs_and_gradients_equal_the_recurrence(frames: int) -> None:
    module = make()
    starts = torch.rand(3, frames) < 0.2
    compare(module, torch.randn(3, frames, 8, dtype=torch.float64), memory(module, 3), starts)


@pytest.mark.parametrize("shift", [-30.0, 12.0])
def test_extreme_step_sizes(shift: float) -> None:
    """A step of 1e-13 forgets nothing, one of 12 everything; neither may lose its gradient."""
    module = make(seed=1)
    with torch.no_grad():
        module.dt_proj.bias += shift
    compare(module, torch.randn(2, 9, 8, dtype=torch.float64), memory(module, 2), torch.zeros(2, 9, dtype=torch.bool))


def test_other_sizes() -> None:
    module = make(width=6, expand=3, d_state=5, d_conv=2, dt_rank=4)
    compare(module, torch.randn(2, 8, 6, dtype=torch.float64), memory(module, 2), torch.rand(2, 8) < 0.3)


def test_rows_that_pass_in_several_chunks(monkeypatch: pytest.MonkeyPatch) -> None:
    """Seven rows, three at a time, the last chunk smaller."""
    module = make()
    monkeypatch.setattr(scan, "_CHUNK_ELEMENTS", 3 * 5 * 16 * 16)
    compare(module, torch.randn(7, 5, 8, dtype=torch.float64), memory(module, 7), torch.rand(7, 5) < 0.3)


def test_float32_is_near_float64() -> None:
    module = make(width=32)
    x, starts = torch.randn(4, 64, 32, dtype=torch.float64), torch.rand(4, 64) < 0.05
    exact, _ = module(x, module.initial_state(4), starts)
    single = module.float()
    y, _ = single(x.float(), single.initial_state(4), starts)
    torch.testing.assert_close(y.double(), exact, rtol=1e-5, atol=1e-5)


def test_windows_equal_each_window_alone() -> None:
    module = make()
    x = torch.randn(1, 10, 8, dtype=torch.float64)
    windows = x.unfold(1, 4, 1)[0].transpose(1, 2)
    none = torch.zeros(len(windows), 4, dtype=torch.bool)
    together, _ = module(windows, module.initial_state(len(windows)), none)
    for index, window in enumerate(windows):
        alone, _ = reference(module, window[None], module.initial_state(1), none[:1])
        torch.testing.assert_close(together[index], alone[0], rtol=1e-6, atol=1e-9)


def test_a_lost_memory_does_not_outlive_a_start() -> None:
    """An infinite state is cleared too, where a multiplication with zero would leave NaN."""
    module = make()
    state = {name: torch.full_like(leaf, torch.inf) for name, leaf in module.initial_state(2).items()}
    x, first = torch.randn(2, 1, 8, dtype=torch.float64), torch.ones(2, 1, dtype=torch.bool)
    expected, _ = module(x, module.initial_state(2), first)
    for grads in (True, False):
        with torch.set_grad_enabled(grads):
            y, _ = module(x, state, first)
        torch.testing.assert_close(y, expected)


def test_the_first_parameters_are_those_of_the_method() -> None:
    """A = -1..-N in every channel, D = 1, step sizes between dt_min and dt_max."""
    module = Mamba(Mamba.Config(), 64)
    expected = -torch.arange(1.0, 17.0).expand(128, 16)
    torch.testing.assert_close(-module.A_log.exp(), expected)
    torch.testing.assert_close(module.D, torch.ones(128))
    steps = F.softplus(module.dt_proj.bias)
    assert steps.min() >= 0.00099
    assert steps.max() <= 0.101


def test_parameters_have_the_usual_names_and_shapes() -> None:
    module = Mamba(Mamba.Config(), 64)
    shapes = {name: tuple(value.shape) for name, value in module.state_dict().items()}
    assert shapes == {
        "norm.weight": (64,),
        "in_proj.weight": (256, 64),
        "conv1d.weight": (128, 1, 4),
        "conv1d.bias": (128,),
        "x_proj.weight": (36, 128),
        "dt_proj.weight": (128, 4),
        "dt_proj.bias": (128,),
        "A_log": (128, 16),
        "D": (128,),
        "out_proj.weight": (64, 128),
    }


def test_weights_in_the_layout_of_mamba_ssm_load_and_come_back() -> None:
    """That package's block keeps its convolution in torch's Conv1d and A_log as (E, N); its norm is not part of it."""
    inner, rank, states = 32, 1, 16
    convolution = torch.nn.Conv1d(inner, inner, 4, groups=inner).state_dict()
    theirs = {f"conv1d.{name}": value for name, value in convolution.items()}
    theirs |= {
        "A_log": torch.rand(inner, states),
        "D": torch.rand(inner),
        "in_proj.weight": torch.randn(2 * inner, 16),
        "x_proj.weight": torch.randn(rank + 2 * states, inner),
        "dt_proj.weight": torch.randn(inner, rank),
        "dt_proj.bias": torch.randn(inner),
        "out_proj.weight": torch.randn(16, inner),
    }
    module = Mamba(Mamba.Config(norm=False, residual=False), 16)
    module.load_state_dict(theirs)
    ours = module.state_dict()
    assert ours.keys() == theirs.keys()
    assert all(torch.equal(ours[name], value) for name, value in theirs.items())
    assert Mamba(Mamba.Config(), 16).load_state_dict(theirs, strict=False).missing_keys == ["norm.weight"]


def test_an_empty_range_of_steps_is_refused() -> None:
    with pytest.raises(ValueError, match=r"dt_min 0.2 exceeds dt_max 0.1"):
        Mamba.check(Mamba.Config(dt_min=0.2), 8)

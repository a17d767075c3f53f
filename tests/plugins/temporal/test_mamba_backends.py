"""Torch and native kernels in float32 against the recurrence in float64, and which of them runs."""

from __future__ import annotations

import copy
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import pytest
import torch
from naive_mamba import recurrence
from torch import Tensor
from torch.utils.flop_counter import FlopCounterMode

from me3bev_cli.errors import UserError
from me3bev_plugins.temporal import native
from me3bev_plugins.temporal.mamba import Mamba

Tree = dict[str, Tensor]
BACKENDS = pytest.mark.parametrize("backend", ["torch", "native"])


def make(backend: str = "native", width: int = 16, seed: int = 0, **keys: Any) -> Mamba:
    torch.manual_seed(seed)
    return Mamba(Mamba.Config(backend=backend, **keys), width)


def draw(module: Mamba, rows: int, frames: int, share: float = 0.2) -> tuple[Tensor, Tree, Tensor]:
    """Input, a state that is not empty, and starts."""
    state = {name: torch.randn_like(leaf) for name, leaf in module.initial_state(rows).items()}
    return torch.randn(rows, frames, module.width), state, torch.rand(rows, frames) < share


def gap(ours: Tensor, exact: Tensor) -> float:
    """The error's norm over that of what is exact."""
    return float((ours - exact).detach().norm() / exact.detach().norm().clamp(min=1e-12))


def outputs_and_gradients(call: Any, x: Tensor, state: Tree, wanted: dict[str, Tensor]) -> dict[str, Tensor]:
    x = x.clone().requires_grad_()
    state = {name: leaf.clone().requires_grad_() for name, leaf in state.items()}
    y, after = call(x, state)
    results = {"y": y, **{f"after {name}": leaf for name, leaf in after.items()}}
    generator = torch.Generator().manual_seed(7)
    loss = sum((out * torch.randn(out.shape, generator=generator).to(out.dtype)).sum() for out in results.values())
    wanted = {"x": x, **state, **wanted}
    grads = torch.autograd.grad(loss, list(wanted.values()), allow_unused=True, materialize_grads=True)  # type: ignore[arg-type]
    results |= {f"gradient of {name}": grad for name, grad in zip(wanted, grads, strict=True)}
    return {name: value.detach() for name, value in results.items()}


def compare(module: Mamba, x: Tensor, state: Tree, starts: Tensor) -> None:
    """Outputs to 1e-6 and gradients to 1e-5 of the recurrence in float64."""
    exact = copy.deepcopy(module).double()
    doubles = {name: leaf.double() for name, leaf in state.items()}
    expected = outputs_and_gradients(
        lambda x, state: recurrence(exact, x, state, starts), x.double(), doubles, dict(exact.named_parameters())
    )
    given = outputs_and_gradients(lambda x, state: module(x, state, starts), x, state, dict(module.named_parameters()))
    for name, value in given.items():
        assert gap(value.double(), expected[name]) < (1e-5 if name.startswith("gradient") else 1e-6), name


@pytest.fixture
def calls(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The names of the native functions as they are called."""
    seen: list[str] = []
    for name in ("step", "sequence"):
        function = getattr(native, name)

        def noted(*args: Any, name: str = name, function: Any = function) -> Any:
            seen.append(name)
            return function(*args)

        monkeypatch.setattr(native, name, noted)
    return seen


@BACKENDS
@pytest.mark.parametrize("frames", [1, 2, 3, 5, 16, 64, 256])
def test_outputs_and_gradients_equal_the_recurrence(backend: str, frames: int) -> None:
    module = make(backend)
    compare(module, *draw(module, 2, frames))


@BACKENDS
def test_starts_at_every_frame_and_at_none(backend: str) -> None:
    module = make(backend)
    for share in (0.0, 1.0):
        compare(module, *draw(module, 3, 6, share))


@BACKENDS
@pytest.mark.parametrize(
    "keys",
    [
        {"width": 6, "expand": 3, "d_state": 5, "d_conv": 2, "dt_rank": 4},
        {"width": 8, "d_conv": 1, "d_state": 1},
        {"width": 80, "d_state": 3, "d_conv": 7},
    ],
)
def test_other_sizes(backend: str, keys: dict[str, int]) -> None:
    module = make(backend, **keys)
    compare(module, *draw(module, 2, 9))


@BACKENDS
@pytest.mark.parametrize("frames", [1, 33])
def test_extreme_step_sizes(backend: str, frames: int) -> None:
    """Step sizes from 1e-6 to 50 side by side: one forgets nothing in 1e5 frames, the other everything in one."""
    module = make(backend, width=32)
    with torch.no_grad():
        step = torch.logspace(-6, 1.69897, module.inner, dtype=torch.float64)
        module.dt_proj.bias.copy_(step + torch.log(-torch.expm1(-step)))
        module.dt_proj.weight.mul_(1e-3)
    x, state, starts = draw(module, 2, frames, 0.05)
    compare(module, x, state, starts)
    with torch.no_grad():
        module.dt_proj.bias.fill_(1e4)
        y, after = module(1e3 * x, state, starts)
        assert all(bool(value.isfinite().all()) for value in (y, *after.values()))
        module.dt_proj.bias.fill_(-1e4)
        y, after = module(x, state, starts)
        assert all(bool(value.isfinite().all()) for value in (y, *after.values()))


@BACKENDS
@pytest.mark.parametrize("lost", [float("nan"), float("inf")])
def test_a_lost_memory_does_not_outlive_a_start(backend: str, lost: float) -> None:
    module = make(backend)
    x, _, starts = draw(module, 2, 4, 0.0)
    starts[:, 0] = True
    empty = module.initial_state(2)
    broken = {name: torch.full_like(leaf, lost) for name, leaf in empty.items()}
    parameters = dict(module.named_parameters())
    expected = outputs_and_gradients(lambda x, s: module(x, s, starts), x, empty, parameters)
    given = outputs_and_gradients(lambda x, s: module(x, s, starts), x, broken, parameters)
    assert all(torch.equal(given[name], expected[name]) for name in expected)
    with torch.no_grad():
        y, after = module(x[:, :1], broken, starts[:, :1])
    assert all(bool(value.isfinite().all()) for value in (y, *after.values()))


@pytest.mark.parametrize("rows", [1, 3, 70, 128, 129])
@pytest.mark.parametrize("keys", [{}, {"norm": False, "residual": False}])
def test_steps_without_gradients_equal_the_torch_sequence(rows: int, keys: dict[str, bool], calls: list[str]) -> None:
    ours, torchs = make(**keys), make("torch", **keys)
    x, state, starts = draw(ours, rows, 20)
    with torch.no_grad():
        expected, last = torchs(x, state, starts)
    for guard in (torch.no_grad, torch.inference_mode):
        carried, ys = state, []
        for t in range(20):
            with guard():
                y, carried = ours(x[:, t : t + 1], carried, starts[:, t : t + 1])
            ys.append(y)
        assert gap(torch.cat(ys, 1), expected) < 1e-6
        assert all(gap(carried[name], last[name]) < 1e-6 for name in last)
    assert set(calls) == {"step" if rows * 16 <= native.STEP_NUMBERS else "sequence"}


def test_windows_equal_each_window_alone() -> None:
    module = make()
    windows = torch.randn(1, 10, 16).unfold(1, 4, 1)[0].transpose(1, 2)
    none = torch.zeros(len(windows), 4, dtype=torch.bool)
    with torch.no_grad():
        together, _ = module(windows, module.initial_state(len(windows)), none)
        for index, window in enumerate(windows):
            alone, _ = module(window[None], module.initial_state(1), none[:1])
            assert gap(together[index], alone[0]) < 1e-6


def test_sizes_that_do_not_fit_are_refused() -> None:
    """Before a kernel could read beyond a tensor's end."""
    module = make()
    x, state, starts = draw(module, 3, 1)
    wrong: list[tuple[Tensor, Tree, Tensor]] = [
        (x[..., :8], state, starts),
        (x, {**state, "ssm": state["ssm"][:2]}, starts),
        (x, {**state, "conv": state["conv"][:, :2]}, starts),
        (x, state, starts[:2]),
        (x, state, starts.long()),
    ]
    for case in wrong:
        with torch.no_grad(), pytest.raises((ValueError, RuntimeError)):
            module(*case)


@BACKENDS
def test_changed_weights_are_seen_however_they_changed(backend: str) -> None:
    """In place past autograd's sight, loaded, replaced, moved away and back, and in a copy."""
    module = make(backend)
    x, state, none = draw(module, 1, 1, 0.0)

    def right(module: Mamba) -> bool:
        with torch.no_grad():
            y, _ = module(x, state, none)
            expected, _ = module._sequence(module.norm(x), state, none)
        return gap(y, x + expected) < 1e-6

    assert right(module)
    module.A_log.data.add_(0.5)
    assert right(module)
    other = make(seed=3)
    module.load_state_dict(other.state_dict())
    assert right(module)
    module.load_state_dict({n: v.clone() for n, v in make(seed=4).state_dict().items()}, assign=True)
    assert right(module)
    with torch.inference_mode():
        module(x, state, none)
    twin = copy.deepcopy(module)
    twin.in_proj.weight.data.mul_(2)
    assert right(twin)
    assert right(module)
    module.double()
    with torch.no_grad():
        module(x, {name: leaf.double() for name, leaf in state.items()}, none)
    module.float()
    assert right(module)
    module.in_proj.weight = torch.nn.Parameter(torch.randn(16, 64).t())
    assert right(module)


def test_threads_that_share_a_module_do_not_mix() -> None:
    module = make(width=64)
    cases = [draw(module, 1, 200, 0.1) for _ in range(4)]

    def drive(case: tuple[Tensor, Tree, Tensor]) -> Tensor:
        x, state, starts = case
        ys = []
        with torch.no_grad():
            for t in range(x.shape[1]):
                y, state = module(x[:, t : t + 1], state, starts[:, t : t + 1])
                ys.append(y)
        return torch.cat(ys, 1)

    expected = [drive(case) for case in cases]
    with ThreadPoolExecutor(4) as pool:
        assert all(torch.equal(a, b) for a, b in zip(pool.map(drive, cases), expected, strict=True))


def test_the_same_input_gives_the_same_bytes() -> None:
    module = make(width=48)
    x, state, starts = draw(module, 5, 12)
    first, second = (
        outputs_and_gradients(lambda x, s: module(x, s, starts), x, state, dict(module.named_parameters()))
        for _ in range(2)
    )
    assert all(torch.equal(first[name], second[name]) for name in first)


def test_what_the_kernels_cannot_take_goes_to_torch(calls: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    module = make("auto")
    x, state, starts = draw(module, 2, 3)
    module(x, state, starts)
    assert calls == ["sequence"]
    double = copy.deepcopy(module).double()
    double(x.double(), {name: leaf.double() for name, leaf in state.items()}, starts)
    copy.deepcopy(module).to("meta")(x.to("meta"), double.to("meta").float().initial_state(2), starts.to("meta"))
    with torch.autocast("cpu", torch.bfloat16):
        y, _ = module(x, state, starts)
    assert bool(y.isfinite().all())
    with FlopCounterMode(display=False) as counter:
        module(x, state, starts)
    assert counter.get_total_flops() > 0
    make("torch")(x, state, starts)
    assert calls == ["sequence"]


@pytest.mark.parametrize("backend", ["auto", "native"])
def test_without_numba_torch_does_the_same(backend: str, monkeypatch: pytest.MonkeyPatch) -> None:
    module = make(backend)
    x, state, starts = draw(module, 2, 5)
    expected, _ = module(x, state, starts)
    for name in [name for name in sys.modules if name.startswith("me3bev_plugins.temporal.native_")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "numba", None)
    native.kernels.cache_clear()
    try:
        if backend == "native":
            with pytest.raises(UserError, match="backend 'native' needs numba, which does not load here"):
                make(backend)
        else:
            assert native.kernels() is None
            y, _ = make(backend)(x, state, starts)
            assert gap(y, expected) < 1e-6
    finally:
        native.kernels.cache_clear()


def test_numba_is_not_imported_before_it_is_needed() -> None:
    code = "import sys, me3bev_plugins.temporal.mamba as m; m.Mamba(m.Mamba.Config(), 8); print('numba' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=True)
    assert done.stdout.strip() == "False"

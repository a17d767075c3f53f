"""Checks of the plugins that are torch modules: what holds for all of them, temporal and fusion."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import torch
from torch import Tensor, nn

from me3bev_cli.api import PluginConfig
from me3bev_cli.testing import broken, require

TOLERANCE = 1e-5
"""Largest difference between two ways to the same number, relative to the largest number (at least 1)."""

Outputs = dict[str, Tensor]


def seeded(seed: int, function: Callable[[], Any]) -> Any:
    """Call with a fixed seed and leave the caller's generator as it was."""
    with torch.random.fork_rng():
        torch.manual_seed(seed)
        return function()


def noise(like: Tensor, seed: int) -> Tensor:
    """Normal numbers in the shape of `like`."""
    generator = torch.Generator().manual_seed(seed)
    return torch.randn(like.shape, generator=generator, dtype=like.dtype).to(like.device)


def leaves(tree: Any, name: str = "state") -> Outputs:
    """The tensors of a plain tree, by path."""
    if isinstance(tree, Tensor):
        return {name: tree}
    if isinstance(tree, Mapping):
        parts = [(f"{name}[{key!r}]", value) for key, value in tree.items()]
    elif isinstance(tree, tuple | list):
        parts = [(f"{name}[{index}]", value) for index, value in enumerate(tree)]
    else:
        raise TypeError(f"{name} is a {type(tree).__name__}, neither a tensor nor a dict, tuple or list")
    return {path: leaf for label, value in parts for path, leaf in leaves(value, label).items()}


def require_equal(cls: type, promise: str, ours: Outputs, theirs: Outputs, tolerance: float = TOLERANCE) -> None:
    """Tensor by tensor within the tolerance."""
    require(cls, ours.keys() == theirs.keys(), promise, f"{sorted(ours)} against {sorted(theirs)}")
    for name in ours:
        a, b = ours[name].detach(), theirs[name].detach()
        require(cls, a.shape == b.shape, promise, f"{name}: shapes {tuple(a.shape)} and {tuple(b.shape)}")
        if not a.numel():
            continue
        if not a.is_floating_point():
            require(cls, torch.equal(a, b), promise, f"{name} differs")
            continue
        gap = float((a - b).abs().max()) / max(1.0, float(b.abs().max()))
        require(cls, gap <= tolerance, promise, f"{name} differs by {gap:.1e}, relative to its size")


def check_module(
    cls: type, build: Callable[[], nn.Module], run: Callable[[nn.Module], Outputs], seed: int
) -> nn.Module:
    """What holds for every module: dtypes, gradients, seeds, no hidden state, saving and loading."""
    module: nn.Module = seeded(seed, build)
    require(cls, isinstance(module, nn.Module), "it is a torch.nn.Module", type(module).__mro__)
    module.train()
    before = {name: value.clone() for name, value in module.state_dict().items()}
    outputs = run(module)
    for name, value in outputs.items():
        if value.is_floating_point():
            require(cls, value.dtype == torch.float32, "float32 in, float32 out", f"{name} is {value.dtype}")
            require(cls, bool(value.isfinite().all()), "outputs are finite", name)
    require_equal(cls, "a forward pass leaves the module's state_dict as it is", module.state_dict(), before, 0.0)
    require_equal(cls, "the same input gives the same output", run(module), outputs, 0.0)
    require_equal(cls, "the same seed gives the same module", run(seeded(seed, build).train()), outputs, 0.0)
    require_equal(cls, "training and evaluation mode compute the same", run(module.eval()), outputs)
    _check_gradients(cls, module.train(), run)
    other: nn.Module = seeded(seed + 1, build)
    other.load_state_dict(before)
    require_equal(cls, "a module with a loaded state_dict computes the same", run(other), outputs, 0.0)
    return module


def _check_gradients(cls: type, module: nn.Module, run: Callable[[nn.Module], Outputs]) -> None:
    module.zero_grad()
    total = torch.zeros(())
    for name, value in run(module).items():
        if value.is_floating_point() and value.requires_grad:
            total = total + (value * noise(value, len(name))).sum()
    if total.requires_grad:
        torch.autograd.backward(total)
    for name, parameter in module.named_parameters():
        if parameter.requires_grad:
            require(cls, parameter.grad is not None, "gradients flow to every parameter", f"none to {name}")
            finite = parameter.grad is not None and bool(parameter.grad.isfinite().all())
            require(cls, finite, "gradients are finite", f"not those of {name}")
    module.zero_grad()


def check_fusion(cls: Any, config: PluginConfig, widths: Mapping[str, int], seed: int) -> None:
    """One vector of the promised width, from all modalities by name."""
    width = cls.output_width(config, widths)
    features = seeded(seed, lambda: {name: torch.randn(5, size, requires_grad=True) for name, size in widths.items()})
    module = check_module(cls, lambda: cls(config, widths), lambda m: {"u": m(features)}, seed)
    result = module(features)
    require(cls, tuple(result.shape) == (5, width), f"the result's shape is {(5, width)}", tuple(result.shape))
    backwards = {name: features[name] for name in reversed(features)}
    require_equal(cls, "modalities are taken by name", {"u": module(backwards)}, {"u": result}, 0.0)
    grads = torch.autograd.grad(result.square().sum(), list(features.values()), allow_unused=True)
    for name, grad in zip(features, grads, strict=True):
        require(cls, grad is not None, "every modality reaches the result", f"no gradient to {name}")
    single = {"u": module({name: value[2:3] for name, value in features.items()})}
    require_equal(cls, "samples are independent of each other", single, {"u": result[2:3]})


def check_temporal(cls: Any, config: PluginConfig, width: int, seed: int) -> None:
    """Shapes, the state's form, and everything in `testing_temporal`."""
    from me3bev_cli.testing_temporal import check_memory, check_state
    from me3bev_cli.testing_temporal_state import check_double

    try:
        cls.check(config, width)
    except ValueError as error:
        raise broken(cls, f"`check` accepts a width of {width}", str(error)) from error
    check_state(cls, cls(config, width))
    x, starts = seeded(seed, lambda: (torch.randn(3, 6, width), torch.rand(3, 6) < 0.3))

    def run(module: Any) -> Outputs:
        y, state = module(x, module.initial_state(3), starts)
        return {"y": y, **leaves(state)}

    module = check_module(cls, lambda: cls(config, width), run, seed)
    shape = tuple(run(module)["y"].shape)
    require(cls, shape == (3, 6, width), f"y has the shape of x, {(3, 6, width)}", shape)
    check_memory(cls, module, width, seed)
    check_double(cls, lambda: cls(config, width), module, x, starts)

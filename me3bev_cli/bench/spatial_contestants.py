"""What takes turns in `bench.spatial`: splats, steps of the policy, and encoders. Plugins come from the registry."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor, nn

from me3bev_cli.bench.cumulative_sum import cumulative_sum_splat
from me3bev_cli.bench.flops import cost
from me3bev_cli.bench.latency_network import random_observation
from me3bev_cli.bench.precision import bf16_error
from me3bev_cli.errors import UserError
from me3bev_cli.pipeline.assemble import build_network, configured, recipe_rig
from me3bev_cli.pipeline.network import Network
from me3bev_cli.pipeline.transfer import to_tensors

if TYPE_CHECKING:
    from me3bev_cli.recipe import Recipe

CPU = torch.device("cpu")

Contestants = dict[str, Callable[[], Any]]


def splatting(network: Network) -> Any:
    """The network's spatial module, which must have a splat that can be called and replaced.

    That is a method `pool(probability, context, calibration=None)` beside `point_cells()`, as the plugin
    `lift_splat` has them.

    Raises:
        UserError: it has none.
    """
    module = network.spatial
    if not all(callable(getattr(module, name, None)) for name in ("pool", "point_cells")):
        raise UserError(
            f"{type(module).__name__} has no splat to time", hint="Name a recipe whose spatial plugin is lift_splat"
        )
    return module


def published(module: Any, sorted_before: bool = False) -> Callable[..., Tensor]:
    """The cumulative sum in the place of a module's `pool`; with its points' order found once if asked for."""
    cells = module.point_cells()
    count = module.grid.rows * module.grid.columns
    order = None
    if sorted_before:
        order = cells.flatten().argsort()
        order = order[cells.flatten()[order] >= 0]

    def pool(probability: Tensor, context: Tensor, calibration: Any = None) -> Tensor:
        return cumulative_sum_splat(probability, context, cells, count, order)

    return pool


def pooled_inputs(module: Any, images: Tensor) -> tuple[Tensor, Tensor]:
    """Depth and context as the module itself hands them to its splat, in their order in memory."""
    seen: list[tuple[Tensor, Tensor]] = []
    real = module.pool

    def noting(probability: Tensor, context: Tensor, *rest: Any) -> Tensor:
        seen.append((probability, context))
        pooled: Tensor = real(probability, context, *rest)
        return pooled

    module.pool = noting
    try:
        with torch.no_grad():
            module(images)
    finally:
        del module.pool
    return seen[0]


class Splats:
    """Depth and context to grid: ours, the cumulative sum, and the latter with its points sorted before."""

    def __init__(self, recipe: Recipe) -> None:
        network = _built(recipe)
        self.module = splatting(network)
        frames = to_tensors(random_observation(recipe, 1), CPU)
        probability, context = pooled_inputs(self.module, network.sensor.images(frames))
        # Copies that can have gradients, in the same order in memory.
        self.inputs = [
            part.clone(memory_format=torch.preserve_format).requires_grad_() for part in (probability, context)
        ]
        self.gradient = torch.randn_like(self.module.pool(*self.inputs))
        ways = {
            "splat": self.module.pool,
            "splat_cumulative_sum": published(self.module),
            "splat_cumulative_sum_sorted": published(self.module, sorted_before=True),
        }
        self.forward: Contestants = {name: partial(self._forward, way) for name, way in ways.items()}
        self.backward: Contestants = {
            f"{name}_backward": partial(self._backward, ways[name]) for name in ("splat", "splat_cumulative_sum")
        }

    @torch.inference_mode()
    def _forward(self, pool: Callable[..., Tensor]) -> Tensor:
        return pool(*self.inputs)

    def _backward(self, pool: Callable[..., Tensor]) -> Any:
        return torch.autograd.grad(pool(*self.inputs), self.inputs, self.gradient)


class Steps:
    """From uint8 images to a decision: frames encoded once, or the window's anew with the cumulative sum."""

    def __init__(self, recipe: Recipe, resnet: Recipe) -> None:
        network, slow = _built(recipe), _built(recipe)
        module = splatting(slow)
        module.pool = published(module)
        self.length = int(slow.memory.prefix) + 1
        if self.length < 2:
            raise UserError("no frame is encoded anew in a stream", hint="Name a recipe with context.kind: window")
        other = _built(resnet)
        self.contestants: Contestants = {
            "step": _step(network, recipe),
            "step_encoding_anew": _anew(slow, recipe, self.length),
            "step_encoding_anew_singly": _anew_singly(slow, recipe, self.length),
            "step_resnet": _step(other, resnet),
        }
        self.flops = {
            "step": _flops(network, recipe),
            "step_resnet": _flops(other, resnet),
        }


class Encoders:
    """Images to tokens: fp32, bf16, and fp32 in the plain order, with the same weights."""

    def __init__(self, recipes: dict[str, Recipe]) -> None:
        self.recipes = recipes
        self.contestants: Contestants = {}
        self.modules: dict[str, nn.Module] = {}
        self.images: dict[str, Tensor] = {}
        for name, recipe in recipes.items():
            network = _built(recipe)
            images = network.sensor.images(to_tensors(random_observation(recipe, 1), CPU))
            self.modules[name], self.images[name] = splatting(network), images
            cls, config = configured("spatial", _spatial(recipe))
            for label, change in (
                ("", {}),
                ("_bf16", {"precision": "bf16"}),
                ("_plain_order", {"channels_last": False}),
            ):
                module = cls(config.model_copy(update=change), recipe_rig(recipe)).eval()
                module.load_state_dict(self.modules[name].state_dict())
                self.contestants[f"encode_{name}{label}"] = partial(_encode, module, images)

    def parts(self) -> dict[str, dict[str, int]]:
        """Floating-point operations of each direct part of the encoders, by recipe."""
        found: dict[str, dict[str, int]] = {}
        for name, module in self.modules.items():
            children = dict(module.named_children())
            given = _given(children, partial(module, self.images[name]))
            found[name] = {label: cost(children[label], inputs, [])[1].flops for label, inputs in given.items()}
        return found

    def errors(self) -> dict[str, dict[str, float]]:
        """The outputs' error in bf16, by recipe."""
        return {
            name: bf16_error(
                *configured("spatial", _spatial(recipe)),
                recipe_rig(recipe),
                self.images[name],
                self.modules[name].state_dict(),
            )
            for name, recipe in self.recipes.items()
        }


def _given(children: dict[str, nn.Module], run: Callable[[], Any]) -> dict[str, tuple[Any, ...]]:
    """What each of the modules is given in a run."""
    inputs: dict[str, tuple[Any, ...]] = {}

    def note(label: str, part: nn.Module, given: tuple[Any, ...]) -> None:
        inputs[label] = given

    hooks = [part.register_forward_pre_hook(partial(note, label)) for label, part in children.items()]
    with torch.no_grad():
        run()
    for hook in hooks:
        hook.remove()
    return inputs


def _spatial(recipe: Recipe) -> Any:
    if recipe.spatial is None:
        raise UserError(f"the recipe '{recipe.name}' has no spatial plugin")
    return recipe.spatial


def _built(recipe: Recipe) -> Network:
    _spatial(recipe)
    return build_network(recipe, recipe.seed).eval()


@torch.inference_mode()
def _encode(module: nn.Module, images: Tensor) -> Any:
    return module(images)


def _step(network: Network, recipe: Recipe) -> Callable[[], Any]:
    """One frame; the memory holds those before it."""
    frames = to_tensors(random_observation(recipe, 1), CPU)
    state, clear = network.initial_state(1), torch.zeros(1, dtype=torch.bool)

    @torch.inference_mode()
    def step() -> Any:
        decision, _ = network.step(frames, state, clear)
        return decision.actions.mode()

    return step


def _anew(network: Network, recipe: Recipe, length: int) -> Callable[[], Any]:
    """All frames of the window in one batch, as where observations are stacked."""
    frames = to_tensors(random_observation(recipe, length), CPU)
    clear = torch.zeros(1, length, dtype=torch.bool)

    @torch.inference_mode()
    def step() -> Any:
        return network.evaluate(frames, None, clear).actions.mode()

    return step


def _anew_singly(network: Network, recipe: Recipe, length: int) -> Callable[[], Any]:
    """As `_anew`, frame by frame: smaller tensors can stay in caches, so that this can be the faster way."""
    frames = to_tensors(random_observation(recipe, length), CPU)
    clear = torch.zeros(1, length, dtype=torch.bool)

    @torch.inference_mode()
    def step() -> Any:
        parts = [network.encode({key: part[n : n + 1] for key, part in frames.items()}) for n in range(length)]
        window = {name: torch.stack([part[name] for part in parts], dim=1) for name in parts[0]}
        latents = network.memory.sequence(window, None, clear)
        return network.decide({name: y.flatten(0, 1) for name, y in latents.items()}).actions.mode()

    return step


def _flops(network: Network, recipe: Recipe) -> int:
    frames = to_tensors(random_observation(recipe, 1), CPU)
    state, clear = network.initial_state(1), torch.zeros(1, dtype=torch.bool)
    return cost(network.step, [frames, state, clear], [network])[1].flops

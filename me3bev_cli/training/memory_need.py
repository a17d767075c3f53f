"""What a recipe's stages need in memory, computed before it is taken; a stage that cannot fit is refused.

What is stored is counted exactly, untouched pages too: a rollout fills all of them. What the backward pass keeps is
counted for one frame, which collection has to pass anyway, and multiplied. Kernels' own scratch memory is not known.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import torch
from torch import Tensor

from me3bev_cli.api import NAVIGATION_WIDTH, ROAD_WIDTH, VEHICLE_WIDTH
from me3bev_cli.errors import MemoryShortError
from me3bev_cli.pipeline.network import Network, embedding_key
from me3bev_cli.pipeline.policy import PARTS, computing, settled_embeddings
from me3bev_cli.pipeline.sensor import SOURCES
from me3bev_cli.pipeline.tree import map_tree
from me3bev_cli.recipe import Recipe
from me3bev_cli.recipe_stages import ImitationStage, PerceptionStage, PpoStage, Stage
from me3bev_cli.training.memory_limits import available_on
from me3bev_cli.workers import cores

WORKER = 300_000_000
"""Bytes of a worker process with its environment."""
ADVICE = 2 * 4
"""Bytes of the autopilot's action."""
BEV_MAP = 200 * 200
"""Bytes of a map that is learned from."""
GRADIENTS = 1.25
"""The backward pass holds gradients of a few activations beside those that it keeps."""
PER_STEP = 8 * 4 + 2
"""Bytes of a step beside its observation: two actions and six numbers that SB3 keeps, and flags."""


@dataclass
class Need:
    """Bytes by purpose: of the system, and of the device that computes (the same where that is a CPU)."""

    host: dict[str, float] = field(default_factory=dict)
    device: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Kept:
    """Bytes that the backward pass keeps."""

    image: float
    """Of one frame in the spatial encoder; 0 where it does not learn."""
    rest: float
    """Of one sample in everything after it."""


def check_memory(
    network: Network,
    recipe: Recipe,
    device: torch.device,
    available: Callable[[torch.device], int | None] = available_on,
) -> None:
    """Compare what each stage needs with what there is.

    Raises:
        MemoryShortError: a stage cannot fit; with the numbers, and what to change.
    """
    for index, stage in enumerate(recipe.stages):
        kept = measure_kept(network, recipe, stage)
        need = stage_need(network, recipe, stage, device, kept)
        for parts, place, free in _places(need, device, available):
            total = sum(parts.values())
            if free is not None and total > free:
                what = ", ".join(f"{_size(size)} for {name}" for name, size in _largest(parts))
                raise MemoryShortError(
                    f"this stage needs {_size(total)} of {place} and {_size(free)} are free: {what}",
                    where=f"recipe '{recipe.name}', stages.{index}",
                    hint=_advice(network, recipe, stage, device, kept, place, free),
                )


def _places(
    need: Need, device: torch.device, available: Callable[[torch.device], int | None]
) -> Iterator[tuple[dict[str, float], str, int | None]]:
    """Parts, the memory that they are in, and what is free of it."""
    if device.type == "cuda":
        yield need.host, "memory", available(torch.device("cpu"))
        yield need.device, "GPU memory", available(device)
    else:
        yield need.host | need.device, "memory", available(device)


def stage_need(network: Network, recipe: Recipe, stage: Stage, device: torch.device, kept: Kept) -> Need:
    """Bytes that a stage needs at its peak, the update."""
    frame = frame_bytes(network, recipe, stage)
    frames = _frames_of_a_minibatch(network, stage)
    at_once = min(frames, _microbatch(stage) or frames)
    workers = min(stage.envs, stage.workers or cores())
    need = Need()
    need.host[_stored_label(stage)] = _stored_frames(network, stage) * (frame + PER_STEP)
    if workers > 1:
        need.host[f"{workers} worker processes"] = workers * WORKER
    parameters = sum(p.numel() * p.element_size() for p in network.parameters())
    # A weight, its gradient and Adam's two moments.
    need.device["weights and optimiser"] = 4 * parameters
    need.device["a minibatch"] = frames * frame
    need.device[f"activations of {at_once} frames in the spatial encoder"] = GRADIENTS * at_once * kept.image
    need.device["activations after it"] = GRADIENTS * stage.minibatch * kept.rest
    if isinstance(stage, PpoStage) and network.prefix == 0:
        segments = stage.envs * stage.rollout // stage.segment
        need.device["states of the memory"] = segments * _tree_bytes(network.initial_state(1))
    return need


def _microbatch(stage: Stage) -> int | None:
    """Of the kinds of stages that know it."""
    size: int | None = getattr(stage, "microbatch", None)
    return size


def _stored_label(stage: Stage) -> str:
    if isinstance(stage, PpoStage):
        return f"a rollout of {stage.rollout} steps of {stage.envs} environments"
    return f"a pool of {stage.pool} frames"


def _stored_frames(network: Network, stage: Stage) -> int:
    if isinstance(stage, PpoStage):
        return (network.prefix + stage.rollout) * stage.envs
    if isinstance(stage, ImitationStage):
        return max(min(stage.pool, stage.steps), stage.rollout * stage.envs)
    return stage.pool + stage.held_out


def _frames_of_a_minibatch(network: Network, stage: Stage) -> int:
    """With those that come before a segment."""
    if isinstance(stage, PerceptionStage):
        return stage.minibatch
    before = stage.burn_in if isinstance(stage, ImitationStage) and network.prefix == 0 else network.prefix
    return stage.minibatch // stage.segment * (before + stage.segment)


def frame_bytes(network: Network, recipe: Recipe, stage: Stage) -> int:
    """Bytes of one frame as it is stored."""
    look = recipe.observation
    pixels = len(look.cameras) * look.height * look.width if network.spatial is not None else 0
    if isinstance(stage, PerceptionStage):
        return 3 * pixels + BEV_MAP
    sizes = {
        "images": 3 * pixels, "vehicle": 4 * VEHICLE_WIDTH, "road": 4 * ROAD_WIDTH, "navigation": 4 * NAVIGATION_WIDTH,
    }  # fmt: skip
    settled = settled_embeddings(network, stage.freeze)
    replaced = {source for name in settled for source in SOURCES[name]}
    kept = sum(size for key, size in sizes.items() if key not in replaced)
    if isinstance(stage, PpoStage) and stage.guidance is not None:
        kept += ADVICE
    return kept + sum(4 * tokens * width for tokens, width in settled.values())


def measure_kept(network: Network, recipe: Recipe, stage: Stage) -> Kept:
    """Pass one frame, without a backward pass, and count what one would need."""
    frozen = [getattr(network, module) for part in stage.freeze for module in PARTS[part]]
    network.freeze(module for module in frozen if module is not None)
    length = network.prefix + 1
    devices = [network.device] if network.device.type == "cuda" else []
    try:
        with torch.random.fork_rng(devices), torch.enable_grad(), computing(network.device, stage.autocast):
            with _counted(network) as image:
                tokens = _see(network, recipe)
            observation = {key: _zeros(network, length, width) for key, width in _VECTORS.items()}
            if tokens is not None:
                repeated = tokens.detach().expand(length, -1, -1).contiguous()
                observation[embedding_key("bev")] = repeated.requires_grad_(tokens.requires_grad)
                del tokens
            starts = torch.zeros(1, length, dtype=torch.bool, device=network.device)
            with _counted(network) as rest:
                network.evaluate(observation, network.initial_state(1), starts)
    finally:
        network.freeze([])
    return Kept(image[0], rest[0])


_VECTORS = {"vehicle": VEHICLE_WIDTH, "road": ROAD_WIDTH, "navigation": NAVIGATION_WIDTH}


def _zeros(network: Network, rows: int, width: int) -> Tensor:
    like = next(network.parameters())
    return torch.zeros(rows, width, dtype=like.dtype, device=like.device)


def _see(network: Network, recipe: Recipe) -> Tensor | None:
    """The tokens of one black frame."""
    if network.spatial is None:
        return None
    look = recipe.observation
    shape = (1, len(look.cameras), 3, look.height, look.width)
    images = torch.zeros(shape, dtype=torch.uint8, device=network.device)
    tokens: Tensor = network.spatial(network.sensor.images({"images": images})).tokens
    return tokens


@contextmanager
def _counted(network: Network) -> Iterator[list[float]]:
    """Counts the bytes that are kept for a backward pass, parameters aside, into the list that is given."""
    own = {tensor.untyped_storage().data_ptr() for tensor in (*network.parameters(), *network.buffers())}
    seen: dict[int, Any] = {}
    total = [0.0]

    def keep(tensor: Tensor) -> Tensor:
        storage = tensor.untyped_storage()
        if storage.data_ptr() not in own and storage.data_ptr() not in seen:
            # Held until all are counted: an address that is free is used again.
            seen[storage.data_ptr()] = storage
            total[0] += storage.nbytes()
        return tensor

    with torch.autograd.graph.saved_tensors_hooks(keep, lambda tensor: tensor):
        yield total


def _tree_bytes(tree: Any) -> int:
    sizes: list[int] = []
    map_tree(lambda leaf: sizes.append(leaf.numel() * leaf.element_size()), tree)
    return sum(sizes)


def _advice(
    network: Network, recipe: Recipe, stage: Stage, device: torch.device, kept: Kept, place: str, free: int
) -> str:
    """The least change of one key with which the stage fits, or which keys matter."""

    def fits(**changes: Any) -> bool:
        need = stage_need(network, recipe, stage.model_copy(update=changes), device, kept)
        parts = next(p for p, name, _ in _places(need, device, lambda _: None) if name == place)
        return sum(parts.values()) <= free

    if kept.image and "microbatch" in type(stage).model_fields:
        for size in (64, 32, 16, 8, 4, 2, 1):
            if size < (_microbatch(stage) or 1 << 30) and fits(microbatch=size):
                return f"`microbatch: {size}` would fit"
    if isinstance(stage, PpoStage):
        for envs in range(stage.envs - 1, 0, -1):
            if fits(envs=envs, microbatch=1):
                small = "" if fits(envs=envs) else " with `microbatch: 1`"
                return f"`envs: {envs}`{small} would fit, or a shorter rollout"
        return "Smaller: microbatch, envs, rollout, minibatch, or the images"
    pool = next((stage.pool // n for n in (2, 4, 8, 16, 32) if fits(pool=stage.pool // n)), None)
    return f"`pool: {pool}` would fit" if pool else "Smaller: microbatch, minibatch, pool, or the images"


def _largest(parts: dict[str, float]) -> list[tuple[str, float]]:
    rows = sorted(parts.items(), key=lambda row: -row[1])
    return [row for row in rows if row[1] >= 0.01 * sum(parts.values())]


def _size(size: float) -> str:
    return f"{size / 1e9:.1f} GB" if size >= 1e8 else f"{size / 1e6:.1f} MB"

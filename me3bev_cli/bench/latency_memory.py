"""The contexts that a network is timed with, and its memory as it stands after so many frames."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, cast

import torch
from torch import Tensor, nn

from me3bev_cli.pipeline.assemble import configured
from me3bev_cli.pipeline.memory import Memory, StreamMemory, WindowMemory
from me3bev_cli.pipeline.network import Network
from me3bev_cli.pipeline.tree import map_tree, split_batch

if TYPE_CHECKING:
    from me3bev_cli.recipe import PluginChoice, Recipe

LENGTHS = (4, 16, 64, 256, 1024)
"""Frames of context that are compared unless others are asked for."""
CONTEXT = "context"
"""A temporal plugin's key for how many frames it looks back at, where it has one; it follows the length."""
CHUNK = 64
"""Frames of history that are read at once."""


@dataclass(frozen=True)
class Context:
    """How a network remembers."""

    kind: str
    """`window`, `stream`, or `none` for a network without memory."""
    length: int
    """Frames in the window, or frames of the episode so far."""
    own: bool
    """Whether the recipe has it so; a recipe that streams has every length."""


def contexts(recipe: Recipe, lengths: Sequence[int] | None) -> list[Context]:
    """Both kinds at each length; the recipe's own too where no lengths are asked for."""
    if recipe.temporal is None:
        return [Context("none", 1, True)]
    own = recipe.context
    known = list(LENGTHS if lengths is None else dict.fromkeys(lengths))
    windows = set(known)
    if lengths is None and own.kind == "window":
        windows.add(own.length)
    found = [Context("window", n, own.kind == "window" and own.length == n) for n in sorted(windows)]
    return found + [Context("stream", n, own.kind == "stream") for n in sorted(known)]


def memory_for(network: Network, recipe: Recipe, context: Context) -> Memory:
    """The network's temporal modules, with their weights, in another context."""
    if recipe.temporal is None:
        return network.memory
    modules = _modules(network, recipe.temporal, context.length)
    memory = StreamMemory(modules) if context.kind == "stream" else WindowMemory(modules, context.length)
    return memory.to(network.device).eval()


def _modules(network: Network, choice: PluginChoice, length: int) -> Mapping[str, nn.Module]:
    trained = dict(cast(nn.ModuleDict, network.memory.temporal).items())
    cls, config = configured("temporal", choice)
    looks_back = getattr(config, CONTEXT, None)
    if not isinstance(looks_back, int) or looks_back == length:
        return trained
    longer = cls.Config(**choice.settings | {CONTEXT: length})
    modules = {name: cls(longer, network.embedding_shapes[name][1]) for name in trained}
    for name, module in modules.items():
        module.load_state_dict(trained[name].state_dict())
    return modules


@torch.inference_mode()
def state_after(memory: Memory, network: Network, context: Context, batch: int) -> Any:
    """The memory of `batch` environments when frame number `length` of their episode is about to be read."""
    shapes, like = network.embedding_shapes, next(network.parameters())
    state = memory.initial(batch, shapes, like)
    if isinstance(memory, WindowMemory):
        # Past embeddings; starts stay false, as inside an episode.
        return map_tree(lambda leaf: torch.randn_like(leaf) if leaf.is_floating_point() else leaf, state)
    if not isinstance(memory, StreamMemory):
        return state
    for name, module in memory.temporal.items():
        tokens, width = shapes[name]
        state[name] = split_batch(_history(module, batch * tokens, width, context.length - 1, like), tokens)
    return state


def _history(module: nn.Module, batch: int, width: int, frames: int, like: Tensor) -> Any:
    """A module's state after so many frames of noise."""
    state: Any = module.initial_state(batch)  # type: ignore[operator]
    for first in range(0, frames, CHUNK):
        part = min(CHUNK, frames - first)
        starts = torch.zeros(batch, part, dtype=torch.bool, device=like.device)
        x = torch.randn(batch, part, width, dtype=like.dtype, device=like.device)
        _, state = module(x, state, starts)
    return state

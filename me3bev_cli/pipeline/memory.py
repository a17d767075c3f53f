"""The two contexts: a window over the last T frames, or one state carried along the episode.

Both offer `step` (one frame, for driving and collecting) and `sequence` (a segment, for learning), which give the
same numbers. Embeddings of a modality have the shape (B, T, K, D): K tokens are K sequences of their own.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor, nn

from me3bev_cli.pipeline.tree import fold, join_batch, split_batch, unfold

Embeddings = dict[str, Tensor]


def _starts_per_token(starts: Tensor, tokens: int) -> Tensor:
    """(B, T) -> (B K, T)."""
    return starts.repeat_interleave(tokens, dim=0)


def _initial(module: nn.Module, batch: int) -> Any:
    return module.initial_state(batch)  # type: ignore[operator]


class NoMemory(nn.Module):
    """`temporal: null`: each frame for itself (the ablation without TAFM)."""

    prefix = 0

    def initial(self, batch: int, embeddings: Mapping[str, tuple[int, int]], like: Tensor) -> Any:
        """No state."""
        return {}

    def step(self, embeddings: Embeddings, state: Any, starts: Tensor) -> tuple[Embeddings, Any]:
        """Each (B, K, D), unchanged."""
        return embeddings, state

    def sequence(self, embeddings: Embeddings, state: Any, starts: Tensor) -> Embeddings:
        """Each (B, T, K, D), unchanged."""
        return embeddings


class StreamMemory(nn.Module):
    """`context: stream`: the state h_m is carried over the whole episode (eqs. 5-7)."""

    prefix = 0

    def __init__(self, modules: Mapping[str, nn.Module]) -> None:
        super().__init__()
        self.temporal = nn.ModuleDict(modules)

    def initial(self, batch: int, embeddings: Mapping[str, tuple[int, int]], like: Tensor) -> Any:
        """The empty state: per modality a tree of tensors (B, K, ...)."""
        return {
            name: split_batch(_initial(module, batch * embeddings[name][0]), embeddings[name][0])
            for name, module in self.temporal.items()
        }

    def _run(self, embeddings: Embeddings, state: Any, starts: Tensor) -> tuple[Embeddings, Any]:
        latents, after = {}, {}
        for name, module in self.temporal.items():
            tokens = embeddings[name].shape[2]
            y, new = module(fold(embeddings[name]), join_batch(state[name]), _starts_per_token(starts, tokens))
            latents[name], after[name] = unfold(y, tokens), split_batch(new, tokens)
        return latents, after

    def step(self, embeddings: Embeddings, state: Any, starts: Tensor) -> tuple[Embeddings, Any]:
        """One frame: each (B, K, D), starts (B,) -> latents (B, K, D) and the next state."""
        frames = {name: e[:, None] for name, e in embeddings.items()}
        latents, state = self._run(frames, state, starts[:, None])
        return {name: y[:, 0] for name, y in latents.items()}, state

    def sequence(self, embeddings: Embeddings, state: Any, starts: Tensor) -> Embeddings:
        """A segment from its stored state: each (B, T, K, D) -> (B, T, K, D)."""
        return self._run(embeddings, state, starts)[0]


class WindowMemory(nn.Module):
    """`context: window`: the temporal module reads the last T frames afresh at each step (the paper's T = 4).

    Windows are formed on embeddings, so a frame is encoded once. A segment needs T - 1 frames of `prefix` before it.
    """

    def __init__(self, modules: Mapping[str, nn.Module], length: int) -> None:
        super().__init__()
        self.temporal = nn.ModuleDict(modules)
        self.length = length
        self.prefix = length - 1

    def initial(self, batch: int, embeddings: Mapping[str, tuple[int, int]], like: Tensor) -> Any:
        """The last T - 1 embeddings of each modality and the episode starts among them; empty at first."""
        frames = {
            name: like.new_zeros(batch, self.prefix, tokens, width) for name, (tokens, width) in embeddings.items()
        }
        return {"frames": frames, "starts": torch.zeros(batch, self.prefix, dtype=torch.bool, device=like.device)}

    def _last(self, name: str, windows: Tensor, starts: Tensor) -> Tensor:
        """Windows (B, T, K, D), starts (B, T) -> the latent of each window's last frame (B, K, D)."""
        module, tokens = self.temporal[name], windows.shape[2]
        x = fold(windows)
        y, _ = module(x, _initial(module, x.shape[0]), _starts_per_token(starts, tokens))
        return unfold(y[:, -1:], tokens)[:, 0]

    def step(self, embeddings: Embeddings, state: Any, starts: Tensor) -> tuple[Embeddings, Any]:
        """One frame: each (B, K, D), starts (B,) -> latents (B, K, D) and the next state."""
        frames = {name: torch.cat([state["frames"][name], e[:, None]], 1) for name, e in embeddings.items()}
        flags = torch.cat([state["starts"], starts[:, None]], 1)
        latents = {name: self._last(name, x, flags) for name, x in frames.items()}
        return latents, {"frames": {name: x[:, 1:] for name, x in frames.items()}, "starts": flags[:, 1:]}

    def sequence(self, embeddings: Embeddings, state: Any, starts: Tensor) -> Embeddings:
        """Each (B, T - 1 + L, K, D), the prefix first -> latents (B, L, K, D)."""
        flags = starts.unfold(1, self.length, 1)
        b, count, length = flags.shape
        latents = {}
        for name, x in embeddings.items():
            k, d = x.shape[2:]
            windows = x.unfold(1, length, 1).permute(0, 1, 4, 2, 3).reshape(b * count, length, k, d)
            latents[name] = self._last(name, windows, flags.reshape(b * count, length)).reshape(b, count, k, d)
        return latents


Memory = NoMemory | StreamMemory | WindowMemory

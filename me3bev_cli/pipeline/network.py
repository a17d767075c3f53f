"""The policy network: encode each frame once, remember over time, fuse, decide. Data flows one way.

Letters: N frames, B environments, T time, C cameras, K tokens, D width.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn
from torch.utils.checkpoint import checkpoint

from me3bev_cli.api import TokenSpec
from me3bev_cli.pipeline.heads import Actions, Actor, Critic
from me3bev_cli.pipeline.memory import Embeddings, Memory
from me3bev_cli.pipeline.sensor import Sensor


def embedding_key(modality: str) -> str:
    """Where an observation holds a modality's embedding (N, K, D) in place of what it is made from."""
    return f"embedding.{modality}"


class Parts(NamedTuple):
    """What `assemble` builds and `Network` joins."""

    sensor: Sensor
    spatial: nn.Module | None
    tokens: TokenSpec | None
    encoders: dict[str, nn.Module]
    memory: Memory
    projection: nn.Module | None
    fusion: nn.Module
    actor: Actor
    critic: Critic


class Decision(NamedTuple):
    """A distribution over actions and the value of the state, for each of B frames."""

    actions: Actions
    values: Tensor


class Network(nn.Module):
    """Six images, R, V and N in; a distribution over (steering, longitudinal) and a value out (Section 3.2)."""

    def __init__(self, parts: Parts) -> None:
        super().__init__()
        self.sensor = parts.sensor
        self.spatial = parts.spatial
        self.tokens = parts.tokens
        self.encoders = nn.ModuleDict(parts.encoders)
        self.memory = parts.memory
        self.projection = parts.projection
        self.fusion = parts.fusion
        self.actor = parts.actor
        self.critic = parts.critic
        self.microbatch: int | None = None
        """Frames whose images are encoded at a time, when there are more; None: all at once."""
        self._fixed = {name for name, p in self.named_parameters() if not p.requires_grad}

    def freeze(self, modules: Iterable[nn.Module]) -> None:
        """Let everything learn but `modules` and what a plugin itself has fixed.

        Gradients that a stage before left are dropped: those of frozen parts would count whenever any are clipped.
        """
        self.zero_grad()
        for name, parameter in self.named_parameters():
            parameter.requires_grad_(name not in self._fixed)
        for module in modules:
            module.requires_grad_(False)

    @property
    def prefix(self) -> int:
        """How many frames before a segment `evaluate` needs to see."""
        return int(self.memory.prefix)

    @property
    def device(self) -> torch.device:
        """Where the parameters are."""
        return next(self.parameters()).device

    @property
    def embedding_shapes(self) -> dict[str, tuple[int, int]]:
        """(K, D) of each modality's embedding."""
        shapes = {}
        if self.tokens is not None:
            shapes["bev"] = (self.tokens.total, self.tokens.width)
        for name, encoder in self.encoders.items():
            shapes[name] = (1, [m.out_features for m in encoder.modules() if isinstance(m, nn.Linear)][-1])
        return shapes

    def encode(self, observation: Mapping[str, Tensor]) -> Embeddings:
        """Frames (N, ...) -> embeddings h of each modality (N, K, D) (eqs. 2-4).

        A modality whose embedding is in the observation, as `embedding_key` names it, is not encoded again.
        """
        vectors = self.sensor.vectors(observation)
        embeddings = {}
        for name in self.embedding_shapes:
            if embedding_key(name) in observation:
                embeddings[name] = observation[embedding_key(name)]
            elif name == "bev":
                embeddings[name] = self._tokens(observation["images"])
            else:
                embeddings[name] = self.encoders[name](vectors[name])[:, None]
        return embeddings

    def embed(self, images: Tensor | None, vectors: Mapping[str, Tensor]) -> Embeddings:
        """As `encode`, from what the sensor gives: images are needed where there is a spatial encoder."""
        seen = {} if self.spatial is None else {"bev": self.spatial(images).tokens}
        return seen | {name: encoder(vectors[name])[:, None] for name, encoder in self.encoders.items()}

    def _tokens(self, images: Tensor) -> Tensor:
        """Images (N, C, 3, H, W) uint8 -> tokens (N, K, D), `microbatch` frames at a time.

        The backward pass then computes the activations of as many frames anew: the gradients are the same, and memory
        does not grow with N.
        """
        if self.microbatch is None or len(images) <= self.microbatch:
            return self._see(images)
        learns = torch.is_grad_enabled() and any(p.requires_grad for p in self.spatial.parameters())  # type: ignore[union-attr]
        parts = torch.split(images, self.microbatch)
        return torch.cat([checkpoint(self._see, p, use_reentrant=False) if learns else self._see(p) for p in parts])

    def _see(self, images: Tensor) -> Tensor:
        tokens: Tensor = self.spatial(self.sensor.images({"images": images})).tokens  # type: ignore[misc]
        return tokens

    def initial_state(self, batch: int) -> Any:
        """The empty memory of `batch` environments, batch first."""
        return self.memory.initial(batch, self.embedding_shapes, next(self.parameters()))

    def fuse(self, latents: Embeddings) -> Tensor:
        """Latents u of each modality (N, K, D) -> the fused u (N, F) (eq. 8)."""
        vectors = {name: latent.flatten(1) for name, latent in latents.items()}
        if self.projection is not None:
            vectors["bev"] = self.projection(vectors["bev"])
        return self.fusion(vectors)

    def decide(self, latents: Embeddings) -> Decision:
        """Latents (N, K, D) -> actions and values of N frames."""
        u = self.fuse(latents)
        return Decision(self.actor(u), self.critic(u))

    def step(self, observation: Mapping[str, Tensor], state: Any, starts: Tensor) -> tuple[Decision, Any]:
        """One frame of B environments; `starts` (B,) bool clears the memory where an episode begins."""
        return self.advance(self.encode(observation), state, starts)

    def advance(self, embeddings: Embeddings, state: Any, starts: Tensor) -> tuple[Decision, Any]:
        """As `step`, from the frame's embeddings."""
        latents, state = self.memory.step(embeddings, state, starts)
        return self.decide(latents), state

    def latents(self, observation: Mapping[str, Tensor], state: Any, starts: Tensor) -> tuple[Embeddings, Any]:
        """As `step`, but the latents u themselves: what the decoder reads."""
        return self.memory.step(self.encode(observation), state, starts)

    def evaluate(
        self, observation: Mapping[str, Tensor], state: Any, starts: Tensor, rows: Tensor | None = None
    ) -> Decision:
        """B segments: observations (N, ...), starts (B, P + L) -> decisions of B L frames.

        P = `prefix` frames come before the L that are judged. Each frame is encoded once (design: encode once,
        window many); gradients equal those of stacked observations.

        Args:
            rows: (B, P + L), which of the N frames stands where; None: N = B (P + L) frames in order.
        """
        embeddings = self.encode(observation)
        if rows is not None:
            embeddings = {name: e.index_select(0, rows.flatten()) for name, e in embeddings.items()}
        shaped = {name: e.reshape(*starts.shape, *e.shape[1:]) for name, e in embeddings.items()}
        latents = self.memory.sequence(shaped, state, starts)
        return self.decide({name: y.flatten(0, 1) for name, y in latents.items()})

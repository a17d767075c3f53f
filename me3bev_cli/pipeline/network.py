"""The policy network: encode each frame once, remember over time, fuse, decide. Data flows one way.

Letters: N frames, B environments, T time, C cameras, K tokens, D width.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn

from me3bev_cli.api import TokenSpec
from me3bev_cli.pipeline.heads import Actions, Actor, Critic
from me3bev_cli.pipeline.memory import Embeddings, Memory
from me3bev_cli.pipeline.sensor import Sensor


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
        self._fixed = {name for name, p in self.named_parameters() if not p.requires_grad}

    def freeze(self, modules: Iterable[nn.Module]) -> None:
        """Let everything learn but `modules` and what a plugin itself has fixed."""
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
        """Frames (N, ...) -> embeddings h of each modality (N, K, D) (eqs. 2-4)."""
        images = self.sensor.images(observation) if self.spatial is not None else None
        return self.embed(images, self.sensor.vectors(observation))

    def embed(self, images: Tensor | None, vectors: Mapping[str, Tensor]) -> Embeddings:
        """As `encode`, from what the sensor gives: images are needed where there is a spatial encoder."""
        embeddings = {}
        if self.spatial is not None:
            embeddings["bev"] = self.spatial(images).tokens
        for name, encoder in self.encoders.items():
            embeddings[name] = encoder(vectors[name])[:, None]
        return embeddings

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
        latents, state = self.memory.step(self.encode(observation), state, starts)
        return self.decide(latents), state

    def latents(self, observation: Mapping[str, Tensor], state: Any, starts: Tensor) -> tuple[Embeddings, Any]:
        """As `step`, but the latents u themselves: what the decoder reads."""
        return self.memory.step(self.encode(observation), state, starts)

    def evaluate(self, observation: Mapping[str, Tensor], state: Any, starts: Tensor) -> Decision:
        """B segments, flattened: observations (B (P + L), ...), starts (B, P + L) -> decisions of B L frames.

        P = `prefix` frames come before the L that are judged. Each frame is encoded once (design: encode once,
        window many); gradients equal those of stacked observations.
        """
        return self.decide(self.segment_latents(observation, state, starts))

    def segment_latents(self, observation: Mapping[str, Tensor], state: Any, starts: Tensor) -> Embeddings:
        """As `evaluate`, but the latents u of each modality (B L, K, D), before they are fused."""
        embeddings = self.encode(observation)
        shaped = {name: e.reshape(*starts.shape, *e.shape[1:]) for name, e in embeddings.items()}
        latents = self.memory.sequence(shaped, state, starts)
        return {name: y.flatten(0, 1) for name, y in latents.items()}

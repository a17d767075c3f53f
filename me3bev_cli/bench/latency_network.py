"""One network, ready to be called frame by frame in several contexts, and the times of its stages."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from me3bev_cli.api import NAVIGATION_WIDTH, ROAD_WIDTH, VEHICLE_WIDTH
from me3bev_cli.bench.flops import Cost, cost, nbytes
from me3bev_cli.bench.latency_device import clock_for, graphed
from me3bev_cli.bench.latency_memory import Context, contexts, memory_for, state_after
from me3bev_cli.bench.latency_subjects import Subject
from me3bev_cli.pipeline.assemble import build_network
from me3bev_cli.pipeline.transfer import to_tensors
from me3bev_cli.training.checkpoint import load_network

if TYPE_CHECKING:
    from me3bev_cli.recipe import Recipe

STAGES = ("sensor", "spatial", "temporal", "fusion", "policy", "control")
"""In flow order. `sensor`: to the device, cast and scaled; `spatial`: with the two vector encoders; `policy`: actor
and critic, as when driving; `control`: back to host memory."""
SWEEP_BYTES = 32 << 20
"""What is read between two contexts: more than the caches next to a core hold."""


@dataclass(frozen=True)
class Conditions:
    """Under which everything is timed."""

    device: torch.device
    dtype: torch.dtype = torch.float32
    """bfloat16: by autocast, the weights stay float32."""
    batch: int = 1
    graphs: bool = True
    """On CUDA: record the stages that can be."""

    def autocast(self) -> AbstractContextManager[Any]:
        """What a frame is computed in; entered anew for each, as a driver does."""
        if self.dtype == torch.float32:
            return nullcontext()
        # A graph must not record reads of casts that are thrown away when this context is left.
        return torch.autocast(self.device.type, self.dtype, cache_enabled=not self._records)

    @property
    def _records(self) -> bool:
        return self.device.type == "cuda" and self.graphs

    def prepare(self, function: Callable[..., Any], example: Sequence[Any]) -> Callable[..., Any]:
        """The function as it is called when timed."""
        return graphed(function, example) if self._records else function


class Bench:
    """A network that reads the same observation again and again.

    A turn encodes the frame once and then finishes it in each context that is due, so their differences do not
    drown in the encoder's noise. Between two contexts other memory is read, as the encoder would have done.

    Args:
        lengths: of the contexts; None: the usual ones and the recipe's own.
        known: costs of temporal stages, which networks of the same widths share; what is new is added.
    """

    def __init__(
        self,
        subject: Subject,
        conditions: Conditions,
        lengths: Sequence[int] | None = None,
        known: dict[Any, Cost] | None = None,
    ) -> None:
        self.subject, self.conditions = subject, conditions
        self.known = {} if known is None else known
        if subject.checkpoint is not None:
            self.network = load_network(subject.checkpoint, conditions.device)[0].eval()
        else:
            self.network = build_network(subject.recipe, subject.recipe.seed).to(conditions.device).eval()
        self.clock = clock_for(conditions.device)
        self.observation = random_observation(subject.recipe, conditions.batch)
        self._other = torch.ones(SWEEP_BYTES // 4, device=conditions.device)
        self.costs: dict[str, Cost] = {}
        self._sense, self._embed, embeddings = self._prepare()
        self.variants = [Variant(self, context, embeddings) for context in contexts(subject.recipe, lengths)]
        self.turns = 0

    def _prepare(self) -> tuple[Callable[..., Any], Callable[..., Any], Any]:
        """The stages before the memory as they are called, and what they give; notes their costs."""
        network, conditions = self.network, self.conditions
        spatial = network.spatial is not None

        def sense(frames: dict[str, Tensor]) -> Any:
            return network.sensor.images(frames) if spatial else None, network.sensor.vectors(frames)

        frames = to_tensors(self.observation, conditions.device)
        with conditions.autocast():
            seen, self.costs["sensor"] = cost(sense, [frames], [])
            embeddings, self.costs["spatial"] = cost(network.embed, seen, [network.spatial, network.encoders])
        with torch.inference_mode(), conditions.autocast():
            return conditions.prepare(sense, [frames]), conditions.prepare(network.embed, seen), embeddings

    @torch.inference_mode()
    def turn(self, due: Sequence[Variant], keep: bool = True) -> dict[Variant, float]:
        """One frame in each of the contexts that are due; the times are kept unless it is a warm-up.

        Returns:
            Seconds that each context has taken after the encoder.
        """
        with self.conditions.autocast():
            marks = [self.clock.begin()]
            seen = self._sense(to_tensors(self.observation, self.conditions.device))
            marks.append(self.clock.mark())
            embeddings = self._embed(*seen)
            marks.append(self.clock.mark())
        shared, spent = self.clock.intervals(marks), {}
        # Another context comes first each time.
        first = self.turns % max(len(due), 1)
        for number, variant in enumerate([*due[first:], *due[:first]]):
            if number:
                self._other.sum()
            times = variant.finish(embeddings)
            spent[variant] = sum(times) / 1000
            if keep:
                variant.samples.append([*shared, *times])
        self.turns += 1
        return spent


class Variant:
    """A network with one context: its memory, and the times of its calls."""

    def __init__(self, bench: Bench, context: Context, embeddings: dict[str, Tensor]) -> None:
        self.bench, self.context = bench, context
        self.samples: list[list[float]] = []
        """Milliseconds by call and stage."""
        network, conditions = bench.network, bench.conditions
        self.memory = memory_for(network, bench.subject.recipe, context)
        self.state = state_after(self.memory, network, context, conditions.batch)
        self.starts = torch.zeros(conditions.batch, dtype=torch.bool, device=conditions.device)
        self.action: NDArray[np.float32] | None = None
        self._remember, self._fuse, self._decide = self._prepare(embeddings)

    def _prepare(self, embeddings: dict[str, Tensor]) -> list[Callable[..., Any]]:
        """The stages after the encoders as they are called; notes their costs."""
        network, conditions = self.bench.network, self.bench.conditions
        self.costs = dict(self.bench.costs)

        def decide(u: Tensor) -> tuple[Tensor, Tensor]:
            return network.actor(u).mode().clamp(-1.0, 1.0), network.critic(u)

        given = [embeddings, self.state, self.starts]
        with conditions.autocast():
            latents, self.costs["temporal"] = self._remembered(given)
            u, self.costs["fusion"] = cost(network.fuse, [latents], [network.projection, network.fusion])
            decision, self.costs["policy"] = cost(decide, [u], [network.actor, network.critic])
            self.costs["control"] = cost(_to_host, [decision[0]], [])[1]
        with torch.inference_mode(), conditions.autocast():
            return [
                conditions.prepare(self.memory.step, given),
                conditions.prepare(network.fuse, [latents]),
                conditions.prepare(decide, [u]),
            ]

    def _remembered(self, given: Sequence[Any]) -> tuple[Any, Cost]:
        """Latents of one frame, and what it costs."""
        bench = self.bench
        key = (repr(bench.subject.recipe.temporal), repr(bench.network.embedding_shapes), self.context)
        if key in bench.known:
            with torch.inference_mode():
                return self.memory.step(*given)[0], bench.known[key]
        (latents, _), bench.known[key] = cost(self.memory.step, given, [self.memory])
        return latents, bench.known[key]

    @torch.inference_mode()
    def finish(self, embeddings: dict[str, Tensor]) -> list[float]:
        """From embeddings to an action in host memory; milliseconds of each stage."""
        clock = self.bench.clock
        with self.bench.conditions.autocast():
            marks = [clock.begin()]
            latents, self.state = self._remember(embeddings, self.state, self.starts)
            marks.append(clock.mark())
            u = self._fuse(latents)
            marks.append(clock.mark())
            action, _ = self._decide(u)
            marks.append(clock.mark())
            self.action = _to_host(action)
            marks.append(clock.mark())
        return clock.intervals(marks)

    def parameters(self) -> int:
        """Of the whole network."""
        return sum(p.numel() for p in self.bench.network.parameters())

    def peak_bytes(self) -> int:
        """Weights, tables and memory, and the most that a stage holds beside them."""
        network = self.bench.network
        state = nbytes(self.state)
        held = nbytes([*network.parameters(), *network.buffers()]) + state
        passing = [c.peak_bytes + c.input_bytes - (state if s == "temporal" else 0) for s, c in self.costs.items()]
        return held + max(passing)


def _to_host(action: Tensor) -> NDArray[np.float32]:
    return action.cpu().numpy()


def random_observation(recipe: Recipe, batch: int) -> dict[str, NDArray[Any]]:
    """Noise of the recipe's shapes and types, with a leading batch axis."""
    generator = np.random.default_rng(0)
    cameras, height, width = len(recipe.observation.cameras), recipe.observation.height, recipe.observation.width
    observation: dict[str, NDArray[Any]] = {
        "road": generator.random((batch, ROAD_WIDTH), np.float32),
        "vehicle": generator.random((batch, VEHICLE_WIDTH), np.float32),
        "navigation": generator.random((batch, NAVIGATION_WIDTH), np.float32),
    }
    if "bev" in recipe.modalities:
        observation["images"] = generator.integers(0, 256, (batch, cameras, 3, height, width), np.uint8)
    return observation

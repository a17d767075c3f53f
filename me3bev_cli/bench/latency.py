"""Latency from raw observation to action, whole and by stage.

Timed: from uint8 images and float32 features in host memory to a clipped action in host memory, the policy's memory
included. Not timed: the simulator, building the network, and the first calls (warm-up). The recipes that are compared
take turns, call by call, so that a change of the machine's speed touches all of them.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from numpy.typing import NDArray

from me3bev_cli.api import NAVIGATION_WIDTH, ROAD_WIDTH, VEHICLE_WIDTH
from me3bev_cli.pipeline.assemble import build_network
from me3bev_cli.pipeline.control import to_tensors

if TYPE_CHECKING:
    from me3bev_cli.recipe import Recipe

STAGES = ("sensor", "encode", "temporal", "fusion_policy", "control")
"""In flow order. `encode` is the spatial plugin and the two vector encoders."""


@dataclass
class Timing:
    """Times of one recipe, milliseconds."""

    name: str
    parameters: int
    whole: list[float] = field(default_factory=list)
    stages: dict[str, list[float]] = field(default_factory=lambda: {stage: [] for stage in STAGES})

    def row(self) -> dict[str, Any]:
        """Median, 95th and 99th percentile of the whole, and medians of the stages."""
        median, p95, p99 = np.percentile(self.whole, [50, 95, 99])
        return {
            "name": self.name,
            "parameters": self.parameters,
            "median_ms": float(median),
            "p95_ms": float(p95),
            "p99_ms": float(p99),
            "frames_per_s": float(1000 / median),
            "stages": {stage: float(np.median(times)) for stage, times in self.stages.items()},
        }


class Bench:
    """One recipe's network, ready to be called on random observations."""

    def __init__(self, recipe: Recipe, device: torch.device, batch: int) -> None:
        self.device, self.batch = device, batch
        self.network = build_network(recipe, recipe.seed).to(device).eval()
        self.timing = Timing(recipe.name, sum(p.numel() for p in self.network.parameters()))
        self.observation = random_observation(recipe, batch)
        self.state = self.network.initial_state(batch)
        self.starts = torch.ones(batch, dtype=torch.bool, device=device)
        self.clear = torch.zeros_like(self.starts)

    def _mark(self) -> float:
        if self.device.type == "cuda":
            torch.cuda.synchronize(self.device)
        return time.perf_counter()

    @torch.inference_mode()
    def call(self, keep: bool) -> None:
        """One frame; its times are kept unless it is a warm-up."""
        network = self.network
        marks = [self._mark()]
        frames = to_tensors(self.observation, self.device)
        images = network.sensor.images(frames) if network.spatial is not None else None
        vectors = network.sensor.vectors(frames)
        marks.append(self._mark())
        embeddings = network.embed(images, vectors)
        marks.append(self._mark())
        latents, self.state = network.memory.step(embeddings, self.state, self.starts)
        self.starts = self.clear
        marks.append(self._mark())
        decision = network.decide(latents)
        marks.append(self._mark())
        decision.actions.mode().clamp(-1.0, 1.0).cpu().numpy()
        marks.append(self._mark())
        if keep:
            for stage, before, after in zip(STAGES, marks, marks[1:], strict=False):
                self.timing.stages[stage].append(1000 * (after - before))
            self.timing.whole.append(1000 * (marks[-1] - marks[0]))


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


def measure(
    recipes: list[Recipe],
    device: torch.device,
    *,
    batch: int = 1,
    warmup: int = 5,
    repeats: int = 50,
    progress: Callable[[int, int], None] | None = None,
) -> list[dict[str, Any]]:
    """Time the recipes in turn; a row for each, as `Timing.row`."""
    benches = [Bench(recipe, device, batch) for recipe in recipes]
    for number in range(warmup + repeats):
        for bench in benches:
            bench.call(keep=number >= warmup)
        if progress is not None:
            progress(number + 1, warmup + repeats)
    return [bench.timing.row() for bench in benches]

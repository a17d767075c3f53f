"""Pairs of (latent u_BEV, semantic truth) of a frozen policy, from live episodes or from logs."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from numpy.typing import NDArray

from me3bev_cli.errors import LogError
from me3bev_cli.pipeline.assemble import configured
from me3bev_cli.pipeline.network import Network
from me3bev_cli.pipeline.transfer import to_tensors
from me3bev_cli.seeding import derive_seed

if TYPE_CHECKING:
    from me3bev_cli.recipe import Recipe

Frame = tuple[dict[str, NDArray[Any]], NDArray[np.uint8]]
"""An observation and the BEV truth (200, 200) of the same moment."""


@dataclass(eq=False)
class Pairs:
    """N frames: latents (N, K, D) float32 and truth (N, 200, 200) uint8; images of some for pictures."""

    latents: NDArray[np.float32]
    truth: NDArray[np.uint8]
    images: NDArray[np.uint8]
    """(N, C, 3, H, W)"""


def live_episodes(
    recipe: Recipe, maps: list[str], density: str, weather: Sequence[str] | None, episodes: int, seed: int
) -> Iterator[Iterator[Frame]]:
    """Episodes driven by the simulator's autopilot, maps taking turns; each an iterator of frames."""
    cls, config = configured("simulator", recipe.simulator)
    simulator = cls(config)
    envs = {
        place: simulator.make_env(recipe.observation, map=place, density=density, weather=weather) for place in maps
    }

    def frames(index: int) -> Iterator[Frame]:
        place = maps[index % len(maps)]
        env = envs[place]
        observation, _ = env.reset(seed=derive_seed(seed, "decode", place, density, index))
        done = False
        while not done:
            yield observation, env.unwrapped.bev_semantics()
            observation, _, terminated, truncated, _ = env.step(env.unwrapped.autopilot())
            done = terminated or truncated

    for index in range(episodes):
        yield frames(index)


def logged_episodes(recipe: Recipe, files: Iterable[Path]) -> Iterator[Iterator[Frame]]:
    """Recorded episodes, each an iterator of frames.

    Raises:
        LogError: a log holds other cameras or another image size than the policy sees.
    """
    from me3bev_cli.recording.reader import read_steps

    wanted = (len(recipe.observation.cameras), 3, recipe.observation.height, recipe.observation.width)

    def frames(path: Path) -> Iterator[Frame]:
        for step in read_steps(path):
            found = step.observation["images"].shape
            if found != wanted:
                raise LogError(
                    f"{path} holds images {found}, the policy '{recipe.name}' sees {wanted}",
                    hint=f"Record with its recipe: `me3bev collect --recipe {recipe.name}`",
                )
            yield step.observation, step.bev

    for path in files:
        yield frames(path)


@torch.inference_mode()
def gather(
    network: Network,
    episodes: Iterable[Iterable[Frame]],
    every: int,
    shown: Callable[[int], None] | None = None,
) -> Pairs:
    """Run the frozen policy's memory over whole episodes and keep every `every`-th frame."""
    latents, truth, images = [], [], []
    for number, frames in enumerate(episodes):
        state = network.initial_state(1)
        starts = torch.ones(1, dtype=torch.bool, device=network.device)
        for index, (observation, bev) in enumerate(frames):
            batch = to_tensors({key: value[None] for key, value in observation.items()}, network.device)
            u, state = network.latents(batch, state, starts)
            starts = torch.zeros_like(starts)
            if index % every == 0:
                latents.append(u["bev"][0].float().cpu().numpy())
                truth.append(bev)
                images.append(observation["images"])
        if shown is not None:
            shown(number + 1)
    return Pairs(np.stack(latents), np.stack(truth), np.stack(images))

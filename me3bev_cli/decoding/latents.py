"""A frozen policy reads an episode: its latent u_BEV and its bird's-eye grid at the moments that are kept."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from me3bev_cli.decoding.decoder import LatentSpec
from me3bev_cli.decoding.moments import Look, Moment
from me3bev_cli.decoding.plan import GRID, U_BEV
from me3bev_cli.errors import UserError
from me3bev_cli.perception.grid import grid_of
from me3bev_cli.pipeline.assemble import configured, recipe_rig
from me3bev_cli.pipeline.network import Network
from me3bev_cli.pipeline.transfer import to_device

if TYPE_CHECKING:
    from me3bev_cli.recipe import Recipe

TOGETHER = 16
"""Frames that are encoded at a time."""
HALF = float(np.finfo(np.float16).max)


def latent_spec(network: Network, recipe: Recipe, source: str) -> LatentSpec:
    """What a source gives.

    Raises:
        UserError: the policy has no spatial encoder, or its encoder has no grid.
    """
    if network.tokens is None or recipe.spatial is None:
        raise UserError(
            f"the policy '{recipe.name}' has no bird's-eye latent: bev is not among its modalities",
            hint="Decode a run whose recipe has a spatial plugin",
        )
    if source == U_BEV:
        tokens = network.tokens
        return LatentSpec(tokens.width, tokens.rows, tokens.columns, tokens.focus)
    cls, config = configured("spatial", recipe.spatial)
    try:
        grid = grid_of(cls, recipe.spatial.name, config, recipe_rig(recipe))
    except UserError as error:
        raise UserError(error.what, where="--source", hint="Decode u_bev") from None
    return LatentSpec(grid.channels, grid.rows, grid.columns)


def described(spec: LatentSpec, recipe: Recipe) -> str | None:
    """What must be said of a latent that is no grid."""
    if spec.rows * spec.columns > 1 or recipe.spatial is None:
        return None
    return (
        f"'{recipe.spatial.name}' has no bird's-eye grid: the map is decoded from one vector of {spec.channels} "
        "numbers, which does not say where things are"
    )


@dataclass(frozen=True)
class Probe:
    """What is read from which network.

    Args:
        name: as the results have it.
        source: `U_BEV` or `GRID`.
    """

    name: str
    network: Network
    source: str


class Read(dict[str, NDArray[np.float16]]):
    """Latents of one moment by probe, (channels, rows, columns) each."""


class Reader:
    """Runs the networks of probes along an episode. Memories are cleared where an episode begins.

    Each modality has a memory of its own, so that u_BEV does not depend on road, vehicle and navigation features; they
    are given as zeros.

    Args:
        probes: of networks that see the same images.
    """

    def __init__(self, probes: Sequence[Probe]) -> None:
        self.probes = list(probes)
        self.networks = list({id(probe.network): probe.network for probe in probes}.values())
        for network in self.networks:
            network.eval()
        self._remembering = {id(probe.network) for probe in probes if probe.source == U_BEV}

    def read(self, looks: Iterable[Look], every: int) -> Iterator[tuple[int, Moment, Read]]:
        """(step, moment, latents) of every `every`-th moment."""
        states: dict[int, Any] = {id(network): network.initial_state(1) for network in self.networks}
        waiting: list[tuple[int, Moment]] = []
        for step, look in enumerate(looks):
            if not self._remembering and step % every:
                continue
            waiting.append((step, look()))
            if len(waiting) == TOGETHER:
                yield from self._read(waiting, states, every)
                waiting = []
        if waiting:
            yield from self._read(waiting, states, every)

    def _read(
        self, waiting: list[tuple[int, Moment]], states: dict[int, Any], every: int
    ) -> Iterator[tuple[int, Moment, Read]]:
        kept = [i for i, (step, _) in enumerate(waiting) if step % every == 0]
        images = np.stack([moment.images for _, moment in waiting])
        found = {
            id(network): self._latents(network, images, waiting[0][0] == 0, states, kept) for network in self.networks
        }
        for place, i in enumerate(kept):
            latents = Read({p.name: found[id(p.network)][p.source][place] for p in self.probes})
            yield (*waiting[i], latents)

    @torch.inference_mode()
    def _latents(
        self, network: Network, images: NDArray[np.uint8], begins: bool, states: dict[int, Any], kept: list[int]
    ) -> dict[str, NDArray[np.float16]]:
        """Both sources of the kept frames (M, channels, rows, columns)."""
        key = id(network)
        assert network.spatial is not None
        assert network.tokens is not None
        out = network.spatial(network.sensor.images({"images": to_device(images, network.device)}))
        found = {}
        if out.grid is not None and any(p.source == GRID and p.network is network for p in self.probes):
            found[GRID] = _half(out.grid[kept])
        if key not in self._remembering:
            return found
        remembered = []
        starts = torch.full((1,), begins, dtype=torch.bool, device=network.device)
        for number in range(len(images)):
            embeddings = {
                name: out.tokens[number : number + 1] if name == "bev" else out.tokens.new_zeros(1, *shape)
                for name, shape in network.embedding_shapes.items()
            }
            latents, states[key] = network.memory.step(embeddings, states[key], starts)
            starts = torch.zeros_like(starts)
            if number in kept:
                remembered.append(latents["bev"][0])
        if remembered:
            tokens = network.tokens
            grid = torch.stack(remembered).transpose(1, 2).reshape(len(remembered), -1, tokens.rows, tokens.columns)
            found[U_BEV] = _half(grid)
        return found


def _half(values: Tensor) -> NDArray[np.float16]:
    """In half precision, as they are kept; what is too large for it becomes its largest number."""
    array: NDArray[np.float16] = values.float().clamp(-HALF, HALF).to(torch.float16).cpu().numpy()
    return array

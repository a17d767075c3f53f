"""A policy's spatial part with a segmentation head on it: what is learned, scored and kept."""

from __future__ import annotations

import inspect
import json
from contextlib import nullcontext
from pathlib import Path
from typing import Any, NamedTuple

import torch
from numpy.typing import NDArray
from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import Tensor, nn

from me3bev_cli.api import GridSpec, Rig
from me3bev_cli.errors import CheckpointError
from me3bev_cli.files import atomic_write_bytes
from me3bev_cli.perception.grid import REACH
from me3bev_cli.perception.head import SegmentationHead
from me3bev_cli.perception.losses import likeliest
from me3bev_cli.perception.truth import DepthBins
from me3bev_cli.pipeline.network import Network

HEAD = "perception_head.safetensors"
"""The heads' file in a run folder: their weights, and their sizes as metadata."""


class Seen(NamedTuple):
    """What is made of images."""

    scores: Tensor
    """(N, 8, 200, 200), before the softmax."""
    depth_logits: Tensor | None
    """(N, C, bins, h, w)"""
    token_scores: Tensor | None = None
    """As `scores`, made of the tokens alone."""


class PerceptionModel(nn.Module):
    """Images (N, C, 3, H, W) uint8 -> class scores and depth.

    One head reads the grid, another the tokens: these are what a driver is given, and must say what is where too.

    Args:
        network: whose spatial part is used; its grid must be known to be there, see `grid_of`.
        grid: of the spatial part.
        width: of the heads.
        seed: of the heads' weights.
    """

    def __init__(self, network: Network, grid: GridSpec, width: int, seed: int) -> None:
        super().__init__()
        assert network.spatial is not None
        assert network.tokens is not None
        tokens = network.tokens
        self.sensor, self.spatial = network.sensor, network.spatial
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            self.head = SegmentationHead(grid.channels, (grid.rows, grid.columns), width).to(network.device)
            size = (tokens.rows, tokens.columns)
            self.token_head = SegmentationHead(tokens.width, size, width, tokens).to(network.device)
        self.token_size = (tokens.rows, tokens.columns)
        self.sizes = {"channels": grid.channels, "rows": grid.rows, "columns": grid.columns, "width": width}

    @property
    def stretches(self) -> bool:
        """Whether the plugin can make its grid of a stretched one."""
        return "stretch" in inspect.signature(self.spatial.forward).parameters

    def forward(self, images: Tensor, tokens: bool = False, stretch: Tensor | None = None) -> Seen:
        """See the class; the head on the tokens is asked only where `tokens` says so.

        Args:
            stretch: as `SpatialPlugin` has it.
        """
        pictures = self.sensor.images({"images": images})
        out = self.spatial(pictures) if stretch is None else self.spatial(pictures, stretch=stretch)
        token_scores = None
        if tokens:
            token_scores = self.token_head(out.tokens.transpose(1, 2).unflatten(2, self.token_size))
        return Seen(self.head(out.grid), out.depth_logits, token_scores)

    @torch.inference_mode()
    def classes(self, images: Tensor, autocast: torch.dtype | None = None, tokens: bool = False) -> NDArray[Any]:
        """The likeliest class of each cell, (N, 200, 200) uint8, by the grid or by the tokens."""
        with nullcontext() if autocast is None else torch.autocast(images.device.type, autocast):
            seen = self(images, tokens)
        scores = seen.scores if seen.token_scores is None else seen.token_scores
        found = likeliest(scores.float(), self.head.class_weights)
        array: NDArray[Any] = found.to(torch.uint8).cpu().numpy()
        return array

    def weigh(self, class_weights: Tensor) -> None:
        """Say by which weights of the classes (8,) the heads are learned."""
        for head in (self.head, self.token_head):
            head.class_weights.copy_(class_weights)

    def heads(self) -> nn.ModuleDict:
        """Both heads by name: what is not the policy's."""
        return nn.ModuleDict({"head": self.head, "token_head": self.token_head})

    def keep_head(self, run: Path) -> None:
        """Write the heads to their file in a run folder, whole or not at all."""
        weights = {key: value.detach().cpu().contiguous() for key, value in self.heads().state_dict().items()}
        atomic_write_bytes(run / HEAD, save(weights, {"sizes": json.dumps(self.sizes)}))


def load_model(network: Network, run: Path) -> PerceptionModel:
    """The network's spatial part with the head that a run's perception stage has trained.

    Raises:
        CheckpointError: the run has no head, or it is damaged or made for another grid.
    """
    path = run / HEAD
    if not path.exists():
        raise CheckpointError(
            f"{run} has no {HEAD}: no perception stage was trained in it", hint="Give the recipe one, and train"
        )
    try:
        with safe_open(path, framework="pt") as file:
            sizes = json.loads((file.metadata() or {})["sizes"])
            weights = {key: file.get_tensor(key) for key in file.keys()}  # noqa: SIM118
        spec = GridSpec(sizes["channels"], sizes["rows"], sizes["columns"], (-REACH, REACH), (-REACH, REACH))
        model = PerceptionModel(network, spec, sizes["width"], 0)
        model.heads().load_state_dict(weights)
    except (SafetensorError, OSError, KeyError, ValueError, TypeError, RuntimeError) as error:
        raise CheckpointError(f"{path} is damaged or of another make ({type(error).__name__})") from error
    return model


def depth_bins_of(spatial: nn.Module, rig: Rig) -> DepthBins | None:
    """The bins in which a spatial module predicts depth, found with a look at nothing; None if it does not."""
    edges = getattr(spatial, "depth_edges", None)
    if not isinstance(edges, Tensor):
        return None
    like = next(spatial.parameters())
    with torch.inference_mode():
        logits = spatial(like.new_zeros(1, len(rig.cameras), 3, *rig.image_size)).depth_logits
    if logits is None:
        return None
    h, w = logits.shape[-2:]
    return DepthBins(tuple(edges.tolist()), (int(h), int(w)), rig.image_size)

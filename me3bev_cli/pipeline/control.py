"""From the policy's distribution to a clipped action: one environment, one frame at a time."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from numpy.typing import NDArray

from me3bev_cli.pipeline.assemble import build_network, pick_device
from me3bev_cli.pipeline.network import Network
from me3bev_cli.pipeline.transfer import to_tensors

if TYPE_CHECKING:
    from me3bev_cli.recipe import Recipe


class Controller:
    """Drives one environment with a policy: its memory lives here and is cleared by `begin`."""

    def __init__(self, network: Network, recipe: Recipe) -> None:
        self.network = network.eval()
        self.recipe = recipe
        self.begin()

    @classmethod
    def load(cls, run: Path, checkpoint: str = "last", device: str = "cpu") -> Controller:
        """The policy of a run folder or of a checkpoint folder.

        Raises:
            CheckpointError: it is missing, truncated or of another architecture.
        """
        from me3bev_cli.training.checkpoint import find_checkpoint, load_network

        network, recipe = load_network(find_checkpoint(run, checkpoint), pick_device(device))
        return cls(network, recipe)

    @classmethod
    def untrained(cls, recipe: Recipe, device: str = "cpu") -> Controller:
        """The policy as its recipe's seed initialises it."""
        return cls(build_network(recipe, recipe.seed).to(pick_device(device)), recipe)

    def begin(self) -> None:
        """Forget everything: a new episode starts."""
        self.state = self.network.initial_state(1)
        self.starts = torch.ones(1, dtype=torch.bool, device=self.network.device)

    @torch.inference_mode()
    def act(self, observation: Mapping[str, NDArray[Any]]) -> NDArray[np.float32]:
        """The policy's mean action (2,) in [-1, 1] for one observation without a batch axis."""
        batch = to_tensors({key: value[None] for key, value in observation.items()}, self.network.device)
        decision, self.state = self.network.step(batch, self.state, self.starts)
        self.starts = torch.zeros_like(self.starts)
        return decision.actions.mode()[0].clamp(-1.0, 1.0).cpu().numpy()

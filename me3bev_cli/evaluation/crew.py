"""Who drives several environments at once: a policy sees for all of them in one forward pass.

An episode has the same numbers in any company: with any number of workers, and whichever of its neighbours are finished
already. Frames are encoded in batches that always have `ROWS` rows; an episode's index says which row it is driven in,
and what a row computes depends on the number of rows but not on what is in the others. That holds of encoders, not of
memories: a recurrent kernel packs its batch by where episodes start in it, and attention reads as far back as the
oldest row asks for. So each row has a memory of its own and goes through it alone, a small part of the work.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from me3bev_cli.evaluation.drivers import Action, Driver, DriverSpec, Policy

if TYPE_CHECKING:
    from torch import Tensor

    from me3bev_cli.pipeline.memory import Embeddings
    from me3bev_cli.pipeline.network import Network

ROWS = 4
"""Environments that are driven at once. Figures depend on it in their last digits."""

Observation = Mapping[str, NDArray[Any]]


def row_of(index: int) -> int:
    """The row that an episode is driven in."""
    return index % ROWS


class Crew(Protocol):
    """Drives up to `ROWS` environments."""

    def begin(self, row: int, env: Any, seed: int) -> None:
        """An episode with this seed has just begun in a row's environment."""
        ...

    def act(self, seen: Mapping[int, Observation], envs: Mapping[int, Any]) -> dict[int, Action]:
        """The action (2,) of each row that has seen something."""
        ...


class Individuals:
    """A driver for each row."""

    def __init__(self, spec: DriverSpec) -> None:
        self.drivers: list[Driver] = [spec.make() for _ in range(ROWS)]

    def begin(self, row: int, env: Any, seed: int) -> None:
        self.drivers[row].begin(env, seed)

    def act(self, seen: Mapping[int, Observation], envs: Mapping[int, Any]) -> dict[int, Action]:
        return {row: self.drivers[row].act(observation, envs[row]) for row, observation in seen.items()}


class Together:
    """A policy's mean actions for all rows, their frames encoded in one forward pass."""

    def __init__(self, network: Network) -> None:
        import torch

        self.network = network.eval()
        self.states = [network.initial_state(1) for _ in range(ROWS)]
        self.starts = torch.ones(ROWS, dtype=torch.bool, device=network.device)
        self.batch: dict[str, NDArray[Any]] = {}
        """What each row has seen last, (ROWS, ...)."""

    def begin(self, row: int, env: Any, seed: int) -> None:
        self.starts[row] = True

    def act(self, seen: Mapping[int, Observation], envs: Mapping[int, Any]) -> dict[int, Action]:
        import torch

        from me3bev_cli.pipeline.transfer import to_tensors

        if not self.batch:
            any_row = next(iter(seen.values()))
            self.batch = {key: np.zeros((ROWS, *value.shape), value.dtype) for key, value in any_row.items()}
        for row, observation in seen.items():
            for key, value in observation.items():
                self.batch[key][row] = value
        with torch.inference_mode():
            embeddings = self.network.encode(to_tensors(self.batch, self.network.device))
            chosen = torch.cat([self._decide(row, embeddings) for row in seen])
            actions = chosen.clamp(-1.0, 1.0).float().cpu().numpy()
        self.starts = torch.zeros_like(self.starts)
        return dict(zip(seen, actions, strict=True))

    def _decide(self, row: int, embeddings: Embeddings) -> Tensor:
        """The mean action (1, 2) of a row, whose memory goes on."""
        mine = {name: embedding[row : row + 1] for name, embedding in embeddings.items()}
        decision, self.states[row] = self.network.advance(mine, self.states[row], self.starts[row : row + 1])
        return decision.actions.mode()


def make_crew(spec: DriverSpec) -> Crew:
    """The crew that a driver is.

    Raises:
        CheckpointError: the policy cannot be loaded.
    """
    if spec.recipe is None:
        return Individuals(spec)
    driver = spec.make()
    assert isinstance(driver, Policy)
    return Together(driver.controller.network)

"""Who drives several environments at once: a policy decides for all of them in one forward pass.

A batch always has `ROWS` rows, and an episode's index says which row it is driven in. What a row computes depends on
the number of rows but not on what is in the others, so an episode has the same numbers in any company: with any number
of workers, and whichever of its neighbours are finished already.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from me3bev_cli.evaluation.drivers import Action, Driver, DriverSpec, Policy

if TYPE_CHECKING:
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
    """A policy's mean actions for all rows, from one forward pass."""

    def __init__(self, network: Network) -> None:
        import torch

        self.network = network.eval()
        self.state = network.initial_state(ROWS)
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
            tensors = to_tensors(self.batch, self.network.device)
            decision, self.state = self.network.step(tensors, self.state, self.starts)
            actions = decision.actions.mode().clamp(-1.0, 1.0).float().cpu().numpy()
        self.starts = torch.zeros_like(self.starts)
        return {row: actions[row] for row in seen}


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

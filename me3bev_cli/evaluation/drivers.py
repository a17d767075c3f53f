"""Who drives: the policy of a run, and the reference drivers that belong beside it in every table."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from me3bev_cli.errors import UserError, unknown_name
from me3bev_cli.seeding import derive_seed

if TYPE_CHECKING:
    from me3bev_cli.pipeline.control import Controller
    from me3bev_cli.recipe import Recipe

Action = NDArray[np.float32]


class Driver(Protocol):
    """Drives one environment at a time."""

    def begin(self, env: Any, seed: int) -> None:
        """An episode with this seed has just begun in `env`."""
        ...

    def act(self, observation: Mapping[str, NDArray[Any]], env: Any) -> Action:
        """The action (2,) for one observation without a batch axis."""
        ...


class Autopilot:
    """The simulator's rule-based driver, which knows the world."""

    def begin(self, env: Any, seed: int) -> None:
        """Nothing to remember."""

    def act(self, observation: Mapping[str, NDArray[Any]], env: Any) -> Action:
        return np.asarray(env.unwrapped.autopilot(), np.float32)


class Idle:
    """Steers straight and touches no pedal: after a standing start, a parked car."""

    def begin(self, env: Any, seed: int) -> None:
        """Nothing to remember."""

    def act(self, observation: Mapping[str, NDArray[Any]], env: Any) -> Action:
        return np.zeros(2, np.float32)


class Random:
    """A uniformly random action at every step."""

    def begin(self, env: Any, seed: int) -> None:
        self.rng = np.random.default_rng(derive_seed("random driver", seed))

    def act(self, observation: Mapping[str, NDArray[Any]], env: Any) -> Action:
        return self.rng.uniform(-1.0, 1.0, 2).astype(np.float32)


class Policy:
    """A policy's mean action."""

    def __init__(self, controller: Controller) -> None:
        self.controller = controller

    def begin(self, env: Any, seed: int) -> None:
        self.controller.begin()

    def act(self, observation: Mapping[str, NDArray[Any]], env: Any) -> Action:
        return self.controller.act(observation)


REFERENCES = ("autopilot", "idle", "random", "untrained")
"""Drivers by name."""


@dataclass(frozen=True)
class DriverSpec:
    """What a driver is made from, in any process.

    Args:
        name: `policy`, or one of `REFERENCES`.
        label: the row's name in tables.
        run: run or checkpoint folder of a policy.
        checkpoint: which of the run's checkpoints.
        recipe: of a policy, untrained or not; other drivers have none.
        device: where a policy computes.

    Raises:
        UserError: an unknown name, or what the driver is made from is missing.
    """

    name: str
    label: str
    run: Path | None = None
    checkpoint: str = "last"
    recipe: Recipe | None = None
    device: str = "cpu"

    def __post_init__(self) -> None:
        if self.name not in ("policy", *REFERENCES):
            raise unknown_name("driver", self.name, REFERENCES, where="--driver")
        if not re.fullmatch(r"auto|cpu|cuda(:\d+)?", self.device):
            raise unknown_name("device", self.device, ("auto", "cpu", "cuda"), where="--device")
        if self.name == "policy" and (self.run is None or self.recipe is None):
            raise UserError("a policy needs the run that it comes from", hint="Give --run RUN")
        if self.name == "untrained" and self.recipe is None:
            raise UserError("an untrained policy needs a recipe", hint="Give --recipe RECIPE or --run RUN")

    @property
    def looks(self) -> bool:
        """Whether the driver needs the cameras' images."""
        return self.recipe is not None and "bev" in self.recipe.modalities

    def make(self) -> Driver:
        """The driver itself.

        Raises:
            CheckpointError: the policy cannot be loaded.
        """
        if self.name == "autopilot":
            return Autopilot()
        if self.name == "idle":
            return Idle()
        if self.name == "random":
            return Random()
        from me3bev_cli.pipeline.control import Controller

        if self.run is None:
            assert self.recipe is not None
            return Policy(Controller.untrained(self.recipe, self.device))
        return Policy(Controller.load(self.run, self.checkpoint, self.device))

"""A world without physics whose environments may fail, for tests of environments in worker processes. No torch."""

from __future__ import annotations

import os
import signal
from dataclasses import dataclass
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces

from me3bev_cli.errors import MapError
from me3bev_cli.training.episodes import SeededEpisodes


class Noise(gymnasium.Env[dict[str, Any], Any]):
    """Observations are noise; the first number of the action says what happens."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.observation_space = spaces.Dict(
            {
                "images": spaces.Box(0, 255, (2, 3, 5, 7), np.uint8),
                "vehicle": spaces.Box(-np.inf, np.inf, (4,), np.float32),
            }
        )
        self.action_space = spaces.Box(-9.0, 9.0, (2,), np.float32)
        self.closed_at = ""

    def _observe(self) -> dict[str, Any]:
        return {
            "images": self.np_random.integers(0, 256, (2, 3, 5, 7), np.uint8),
            "vehicle": self.np_random.normal(size=4).astype(np.float32),
        }

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        super().reset(seed=seed)
        self.steps, self.end = 0, int(self.np_random.integers(3, 9))
        return self._observe(), {"end": self.end, "options": options}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        if action[0] == 7:
            raise MapError(f"unknown map in {self.name}", allowed="T1")
        if action[0] == 8:
            raise ZeroDivisionError(f"a defect in {self.name}")
        if action[0] == 9:
            os.kill(os.getpid(), signal.SIGKILL)
        self.steps += 1
        over = self.steps >= self.end
        info = {"record": {"speed": float(action[1]), "collision": "vehicle" if over else ""}}
        return self._observe(), float(self.np_random.normal()), over and self.end % 2 == 0, over, info

    def pid(self) -> int:
        """Of the process that it lives in."""
        return os.getpid()

    def threads(self) -> str | None:
        """How many threads libraries are told to use."""
        return os.environ.get("OMP_NUM_THREADS")


@dataclass(frozen=True)
class MakeNoise:
    """Makes one."""

    name: str
    fails: bool = False

    def __call__(self) -> Noise:
        if self.fails:
            raise MapError(f"no world for {self.name}", allowed="others")
        return Noise(self.name)


@dataclass(frozen=True)
class MakeSeededNoise:
    """Makes one whose episodes follow from their index."""

    first: int

    def __call__(self) -> gymnasium.Env[Any, Any]:
        return SeededEpisodes(Noise(str(self.first)), ("noise",), self.first, 3)

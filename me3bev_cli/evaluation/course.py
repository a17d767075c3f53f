"""Several environments that play an evaluation's episodes side by side, for a policy that decides for all at once.

No torch here: worker processes drive courses.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import gymnasium

from me3bev_cli.api import ObservationConfig
from me3bev_cli.evaluation.runner import weather_of

IDLE = "idle"
"""In the infos of a course that has played all its episodes."""


@dataclass(frozen=True)
class Visit:
    """One episode to play."""

    map: str
    density: str
    index: int
    seed: int


class Course(gymnasium.Env[Any, Any]):
    """Plays its visits in order, one per reset; after the last it stands still and reports nothing.

    Args:
        simulator: an instance of a `SimulatorPlugin`.
        visits: at least one; those on the same map and density follow each other, since each change opens a map.
    """

    def __init__(
        self,
        simulator: Any,
        observation: ObservationConfig,
        weather: tuple[str, ...] | None,
        images: bool,
        visits: Sequence[Visit],
    ) -> None:
        self._simulator, self._observation = simulator, observation
        self._weather, self._images = weather, images
        self._visits, self._next = visits, 0
        self._seen: Any = None
        self._open(visits[0])
        self.observation_space = self._env.observation_space
        self.action_space = self._env.action_space

    def _open(self, visit: Visit) -> None:
        self._place = (visit.map, visit.density)
        self._env = self._simulator.make_env(
            self._observation, map=visit.map, density=visit.density, weather=self._weather, images=self._images
        )

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Begin the next visit; a seed that is passed in is not used."""
        if self._next >= len(self._visits):
            self._next = len(self._visits) + 1
            return self._seen, {IDLE: True}
        visit = self._visits[self._next]
        self._next += 1
        if (visit.map, visit.density) != self._place:
            self._env.close()
            self._open(visit)
        self._seen, info = self._env.reset(seed=visit.seed)
        self._name = weather_of(info)
        return self._seen, info

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """A step of the visit; its info names the episode's weather."""
        if self._next > len(self._visits):
            return self._seen, 0.0, False, False, {IDLE: True}
        self._seen, reward, terminated, truncated, info = self._env.step(action)
        return self._seen, float(reward), terminated, truncated, {**info, "weather": self._name}

    def close(self) -> None:
        """Close the environment."""
        self._env.close()


@dataclass(frozen=True)
class CourseMaker:
    """Makes a course, here or in a worker process."""

    simulator: Any
    observation: ObservationConfig
    weather: tuple[str, ...] | None
    images: bool
    visits: tuple[Visit, ...]

    def __call__(self) -> Course:
        return Course(self.simulator, self.observation, self.weather, self.images, self.visits)

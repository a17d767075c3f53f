"""The episodes that a training environment plays. No torch here: worker processes make their environments with it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import gymnasium
from gymnasium.wrappers import RecordEpisodeStatistics

from me3bev_cli.api import ObservationConfig
from me3bev_cli.seeding import derive_seed
from me3bev_cli.training.scouting import Scout
from me3bev_cli.training.shaped_reward import ShapedReward


class SeededEpisodes(gymnasium.Wrapper[Any, Any, Any, Any]):
    """Seeds every episode from (run seed, map, density, episode index); environment k of n plays k, k + n, ...

    Args:
        scout: chooses each episode among several of its index; None: there is one.
    """

    def __init__(
        self,
        env: gymnasium.Env[Any, Any],
        names: tuple[str | int, ...],
        first: int,
        stride: int,
        scout: Scout | None = None,
    ) -> None:
        super().__init__(env)
        self.names, self.scout = names, scout
        self.next_index, self.stride = first, stride

    def play_from(self, episode: int) -> None:
        """Choose the episode of the next reset."""
        self.next_index = episode

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Begin the next episode; a seed that is passed in is not used."""
        episode_seed = self._seed(self.next_index)
        self.next_index += self.stride
        return self.env.reset(seed=episode_seed, options=options)

    def _seed(self, index: int) -> int:
        if self.scout is None:
            return derive_seed(*self.names, index)
        return self.scout.busiest([derive_seed(*self.names, index, one) for one in range(self.scout.count)])

    def close(self) -> None:
        """Close the environment, and the scout's."""
        if self.scout is not None:
            self.scout.close()
        super().close()


Wrapping = Callable[[gymnasium.Env[Any, Any]], gymnasium.Env[Any, Any]]


@dataclass(frozen=True)
class EpisodeMaker:
    """Makes one of a stage's environments, here or in a worker process.

    Its infos hold, where an episode ends, `episode`: its return, its length in steps and its seconds, as r, l and t.
    """

    simulator: Any
    """An instance of a `SimulatorPlugin`."""
    observation: ObservationConfig
    map: str
    density: str
    weather: tuple[str, ...] | None
    images: bool
    run_seed: int
    first: int
    """Index of the first episode."""
    stride: int
    """From there to the next one."""
    around: Wrapping | None = None
    """Wraps the environment once more."""
    terms: Mapping[str, float] = field(default_factory=dict)
    """Weights of the terms that are added to the reward."""
    busiest_of: int = 1
    """Each episode is the busiest of so many."""

    def __call__(self) -> gymnasium.Env[Any, Any]:
        names = (self.run_seed, self.map, self.density)
        scout = Scout(lambda: self._make(images=False), self.busiest_of) if self.busiest_of > 1 else None
        seeded = SeededEpisodes(self._make(self.images), names, self.first, self.stride, scout)
        recorded: gymnasium.Env[Any, Any] = RecordEpisodeStatistics(seeded)
        if self.terms:
            recorded = ShapedReward(recorded, self.terms)
        return self.around(recorded) if self.around is not None else recorded

    def _make(self, images: bool) -> gymnasium.Env[Any, Any]:
        made: gymnasium.Env[Any, Any] = self.simulator.make_env(
            self.observation, map=self.map, density=self.density, weather=self.weather, images=images
        )
        return made

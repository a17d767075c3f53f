"""Plays episodes: the same seed gives the same numbers, for any number of workers."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from me3bev_cli import registry
from me3bev_cli.errors import PluginError
from me3bev_cli.evaluation.drivers import Driver, DriverSpec
from me3bev_cli.evaluation.episode import Episode, ending, from_records
from me3bev_cli.parallel import run_jobs
from me3bev_cli.seeding import derive_seed

if TYPE_CHECKING:
    import gymnasium

    from me3bev_cli.api import ObservationConfig, SimulatorPlugin, StepRecord
    from me3bev_cli.recipe import PluginChoice

CHUNKS, LARGEST_CHUNK = 8, 4
"""A cell's episodes are played in about this many chunks, an environment for each, of at most so many episodes.
Neither depends on the number of workers."""
SNAPSHOT_STEP = 40
"""The snapshot is taken after this many steps, or at the end of a shorter episode."""


def episode_seed(seed: int, map: str, density: str, index: int) -> int:
    """The seed of an evaluation's episode. No training plays it, whatever its recipe's seed."""
    return derive_seed("evaluation", seed, map, density, index)


@dataclass(frozen=True)
class World:
    """What is driven in: a simulator by name with its settings, and what is observed."""

    simulator: PluginChoice
    observation: ObservationConfig
    weather: tuple[str, ...] | None = None
    """Each episode draws one of these by its seed; None: the simulator's default one."""

    def open(self) -> SimulatorPlugin:
        """The simulator.

        Raises:
            PluginError: it is not installed or does not import.
        """
        plugin = registry.load("simulator", self.simulator.name)
        simulator: SimulatorPlugin = plugin(plugin.Config(**self.simulator.settings))
        return simulator


class Job(NamedTuple):
    """Some episodes of one cell."""

    map: str
    density: str
    indices: tuple[int, ...]
    snapshot: int | None = None
    """Index of an episode to look into."""


@dataclass(frozen=True, eq=False)
class Snapshot:
    """One instant as it was seen."""

    map: str
    density: str
    weather: str
    step: int
    cameras: tuple[str, ...]
    images: NDArray[np.uint8]
    """(C, 3, H, W)."""
    bev: NDArray[np.uint8]
    """(X, Y), classes as `api.BEV_CLASSES`."""


class Played(NamedTuple):
    """What a job gives."""

    episodes: list[Episode]
    snapshot: Snapshot | None


@dataclass
class Player:
    """Plays jobs in one process; simulator and driver are made at the first and kept."""

    world: World
    spec: DriverSpec
    seed: int
    _simulator: SimulatorPlugin | None = field(default=None, init=False, repr=False)
    _driver: Driver | None = field(default=None, init=False, repr=False)

    def __call__(self, job: Job) -> Played:
        self._driver = self._driver or self.spec.make()
        self._simulator = self._simulator or self.world.open()
        snapshot = None if job.snapshot is None else self._snapshot(job, job.snapshot)
        if not job.indices:
            return Played([], snapshot)
        with closing(self._make(job, images=self.spec.looks)) as env:
            return Played([self._episode(env, self._driver, job, index) for index in job.indices], snapshot)

    def _make(self, job: Job, images: bool) -> gymnasium.Env[Any, Any]:
        assert self._simulator is not None
        return self._simulator.make_env(
            self.world.observation, map=job.map, density=job.density, weather=self.world.weather, images=images
        )

    def _episode(self, env: gymnasium.Env[Any, Any], driver: Driver, job: Job, index: int) -> Episode:
        seed = episode_seed(self.seed, job.map, job.density, index)
        driven = drive(env, driver, seed)
        return from_records(
            driven.records,
            map=job.map,
            density=job.density,
            weather=driven.weather,
            seed=seed,
            index=index,
            driver=self.spec.label,
            ended=ending(driven.records, terminated=driven.terminated),
        )

    def _snapshot(self, job: Job, index: int) -> Snapshot:
        """Drive the first part of an episode with the cameras on, apart from the drive that is scored."""
        assert self._driver is not None
        seed = episode_seed(self.seed, job.map, job.density, index)
        with closing(self._make(job, images=True)) as env:
            seen, info = env.reset(seed=seed)
            self._driver.begin(env, seed)
            step, over = 0, False
            while step < SNAPSHOT_STEP and not over:
                seen, _, terminated, truncated, _ = env.step(self._driver.act(seen, env))
                step, over = step + 1, terminated or truncated
            bev = np.array(env.unwrapped.bev_semantics())  # type: ignore[attr-defined]
            images = np.array(seen["images"])
        return Snapshot(job.map, job.density, weather_of(info), step, self.world.observation.cameras, images, bev)


class Drive(NamedTuple):
    """What an environment reported of one episode."""

    records: list[StepRecord]
    terminated: bool
    """Whether the environment ended it, rather than the horizon."""
    weather: str


def weather_of(info: Mapping[str, Any]) -> str:
    """The episode's weather, from what an environment reports at its reset.

    Raises:
        PluginError: it is not there.
    """
    weather = info.get("weather")
    if not isinstance(weather, str):
        raise PluginError("the simulator's info['weather'] is not the name of the episode's weather")
    return weather


def drive(env: gymnasium.Env[Any, Any], driver: Driver, seed: int) -> Drive:
    """Play one episode.

    Raises:
        PluginError: the simulator does not say which weather it has.
    """
    observation, info = env.reset(seed=seed)
    weather = weather_of(info)
    driver.begin(env, seed)
    records: list[StepRecord] = []
    while True:
        observation, _, terminated, truncated, info = env.step(driver.act(observation, env))
        records.append(info["record"])
        if terminated or truncated:
            return Drive(records, terminated, weather)


def plan(maps: Sequence[str], densities: Sequence[str], episodes: int, snapshot: bool = False) -> list[Job]:
    """The jobs of an evaluation, cell by cell, after a look into the very first episode if it is wanted."""
    size = max(1, min(LARGEST_CHUNK, episodes // CHUNKS))
    jobs = [
        Job(map, density, tuple(range(first, min(first + size, episodes))))
        for density in densities
        for map in maps
        for first in range(0, episodes, size)
    ]
    look = [Job(jobs[0].map, jobs[0].density, (), snapshot=0)] if snapshot and jobs else []
    return look + jobs


def evaluate(
    player: Player,
    jobs: Sequence[Job],
    workers: int,
    on_episodes: Callable[[Sequence[Episode]], None] | None = None,
    on_death: Callable[[int, int], None] | None = None,
) -> tuple[list[Episode], Snapshot | None]:
    """Play every job.

    Args:
        player: who drives, where, with which seed.
        jobs: as `plan` makes them.
        workers: processes, as in `parallel.run_jobs`.
        on_episodes: called with each job's episodes as it finishes, in any order.
        on_death: called when a worker died, as in `parallel.run_jobs`.

    Returns:
        The episodes in the order of the jobs, and the snapshot if a job took one.
    """

    def report(_: int, played: Played) -> None:
        if on_episodes is not None and played.episodes:
            on_episodes(played.episodes)

    played = run_jobs(player, jobs, workers, report, on_death)
    snapshots = [p.snapshot for p in played if p.snapshot is not None]
    return [e for p in played for e in p.episodes], snapshots[0] if snapshots else None

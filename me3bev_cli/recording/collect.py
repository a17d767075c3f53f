"""Drives episodes and records each as one MCAP file, in several processes if asked."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from numpy.typing import NDArray

from me3bev_cli.api import SimulatorPlugin
from me3bev_cli.errors import LogError
from me3bev_cli.evaluation.drivers import Driver, DriverSpec
from me3bev_cli.evaluation.runner import World, weather_of
from me3bev_cli.parallel import run_jobs
from me3bev_cli.recording.reader import read_metadata
from me3bev_cli.recording.writer import EpisodeWriter
from me3bev_cli.seeding import derive_seed
from me3bev_cli.training.run import versions


class Take(NamedTuple):
    """One episode to record."""

    place: str
    density: str
    number: int

    def path(self, folder: Path) -> Path:
        """The file of the episode: its name says which one it is."""
        return folder / f"{self.place}-{self.density}-{self.number:05d}.mcap"


@dataclass
class Recorder:
    """Records takes in one process; simulator and driver are made at the first and kept."""

    world: World
    spec: DriverSpec
    seed: int
    folder: Path
    quality: int
    _simulator: SimulatorPlugin | None = field(default=None, init=False, repr=False)
    _driver: Driver | None = field(default=None, init=False, repr=False)

    def __call__(self, take: Take) -> int:
        self._simulator = self._simulator or self.world.open()
        self._driver = self._driver or self.spec.make()
        observation = self.world.observation
        env = self._simulator.make_env(observation, map=take.place, density=take.density, weather=self.world.weather)
        with closing(env):
            seed = self.episode_seed(take)
            first, info = env.reset(seed=seed)
            self._driver.begin(env, seed)
            numbers = {f"version.{name}": number for name, number in versions().items()}
            metadata = {**self.identity(take), "weather": weather_of(info), **numbers}
            rig = self._simulator.rig(observation)
            with EpisodeWriter(take.path(self.folder), rig, metadata, self.quality) as writer:
                return record(env, self._driver, writer, first)

    def episode_seed(self, take: Take) -> int:
        """What the environment of a take is reset with: the same in any weather."""
        return derive_seed("collection", self.seed, *take)

    def identity(self, take: Take) -> dict[str, str]:
        """What decides a take, as kept in its file."""
        return {
            "driver": self.spec.label,
            "recipe": self.spec.recipe.name if self.spec.recipe else "",
            "map": take.place,
            "density": take.density,
            "weather_set": ",".join(self.world.weather or ()),
            "index": str(take.number),
            "seed": str(self.episode_seed(take)),
        }

    def refuse_foreign(self, take: Take) -> None:
        """Raises LogError when the take's file holds another episode, so that collections are not mixed up."""
        path = take.path(self.folder)
        found = read_metadata(path)
        for key, value in self.identity(take).items():
            if found.get(key, value) != value:
                raise LogError(
                    f"{path} belongs to another collection: its {key} is '{found[key]}', not '{value}'",
                    hint="Choose another folder, or remove the file",
                )


def record(env: Any, driver: Driver, writer: EpisodeWriter, observation: Mapping[str, NDArray[Any]]) -> int:
    """Drive the episode that begins with `observation` and write its steps; returns how many there were."""
    steps, done = 0, False
    while not done:
        bev = env.unwrapped.bev_semantics()
        pose = env.unwrapped.pose()
        action = driver.act(observation, env)
        after, _, terminated, truncated, info = env.step(action)
        writer.add(observation, action, info["record"], bev, pose)
        observation, done = after, terminated or truncated
        steps += 1
    return steps


def collect(
    recorder: Recorder,
    takes: Sequence[Take],
    workers: int,
    shown: Callable[[Take, int], None] | None = None,
) -> int:
    """Record what is not there yet; returns the number of files written.

    A file under its final name is whole, so a collection that was cut off goes on where it stopped.

    Raises:
        LogError: a file of a take is there but holds another episode, or is damaged.
    """
    recorder.folder.mkdir(parents=True, exist_ok=True)
    for part in recorder.folder.glob(".*.mcap.part"):
        part.unlink()
    there = {take for take in takes if take.path(recorder.folder).exists()}
    for take in sorted(there):
        recorder.refuse_foreign(take)
    missing = [take for take in takes if take not in there]

    def report(index: int, steps: int) -> None:
        if shown is not None:
            shown(missing[index], steps)

    run_jobs(recorder, missing, workers, report)
    return len(missing)

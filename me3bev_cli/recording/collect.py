"""Drives episodes and records each as one MCAP file, in several processes if asked."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any, NamedTuple

from numpy.typing import NDArray

from me3bev_cli.api import SimulatorPlugin, StepRecord
from me3bev_cli.errors import LogError
from me3bev_cli.evaluation.drivers import Driver, DriverSpec
from me3bev_cli.evaluation.episode import ending
from me3bev_cli.evaluation.runner import World, weather_of
from me3bev_cli.parallel import run_jobs
from me3bev_cli.recording.logfile import LogFile
from me3bev_cli.recording.writer import METADATA, EpisodeWriter, Options, Truth, unwritable
from me3bev_cli.seeding import derive_seed
from me3bev_cli.training.run import versions

LOCK = ".collecting"
"""Held while a collection writes into a folder."""


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
    """Records takes in one process; simulator, driver and the last environment are made once and kept."""

    world: World
    spec: DriverSpec
    seed: int
    folder: Path
    options: Options = field(default_factory=Options)
    _simulator: SimulatorPlugin | None = field(default=None, init=False, repr=False)
    _driver: Driver | None = field(default=None, init=False, repr=False)
    _env: tuple[tuple[str, str], Any] | None = field(default=None, init=False, repr=False)

    def __call__(self, take: Take) -> int:
        env, driver = self.environment(take.place, take.density), self.driver()
        seed = self.episode_seed(take)
        first, info = env.reset(seed=seed)
        driver.begin(env, seed)
        numbers = {f"version.{name}": number for name, number in versions().items()}
        metadata = {**self.identity(take), "weather": weather_of(info), **numbers}
        assert self._simulator is not None
        rig = self._simulator.rig(self.world.observation)
        line = getattr(env.unwrapped, "route_line", None)
        route = line() if line is not None else None
        with EpisodeWriter(take.path(self.folder), rig, metadata, self.options, route) as writer:
            return record(env, driver, writer, first)

    def environment(self, place: str, density: str) -> Any:
        """The environment of a place, with cameras."""
        if self._env is None or self._env[0] != (place, density):
            self.close()
            self._simulator = self._simulator or self.world.open()
            env = self._simulator.make_env(
                self.world.observation, map=place, density=density, weather=self.world.weather
            )
            self._env = (place, density), env
        return self._env[1]

    def driver(self) -> Driver:
        """Who drives."""
        self._driver = self._driver or self.spec.make()
        return self._driver

    def close(self) -> None:
        """Close the environment."""
        if self._env is not None:
            self._env[1].close()
            self._env = None

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
            "images": self.options.images,
            "depth": "yes" if self.options.depth else "no",
            "semantics": "yes" if self.options.semantics else "no",
            "observation": self.world.observation.model_dump_json(),
        }

    def refuse_foreign(self, take: Take) -> None:
        """Raises LogError when the take's file holds another episode, so that collections are not mixed up."""
        path = take.path(self.folder)
        log = LogFile(path)
        if log.note is not None:
            raise LogError(f"{log.note}. A log under its final name is whole", hint="Remove the file")
        found = log.metadata.get(METADATA, {})
        for key, value in self.identity(take).items():
            if found.get(key, value) != value:
                raise LogError(
                    f"{path} belongs to another collection: its {key} is '{found[key]}', not '{value}'",
                    hint="Choose another folder, or remove the file",
                )


def record(env: Any, driver: Driver, writer: EpisodeWriter, observation: Mapping[str, NDArray[Any]]) -> int:
    """Drive the episode that begins with `observation`, write its steps and finish; returns how many there were."""
    records: list[StepRecord] = []
    done = terminated = False
    while not done:
        writer.look(observation, truth(env, writer.options))
        action = driver.act(observation, env)
        observation, _, terminated, truncated, info = env.step(action)
        writer.act(action, info["record"])
        records.append(info["record"])
        done = terminated or truncated
    writer.finish({"ended": ending(records, terminated=terminated)})
    return len(records)


def truth(env: Any, options: Options) -> Truth:
    """What the simulator knows of this moment."""
    world = env.unwrapped
    actors = getattr(world, "actors", None)
    depth, semantics = world.camera_truth() if options.depth or options.semantics else (None, None)
    return Truth(
        world.bev_semantics(),
        world.pose(),
        actors() if actors is not None else None,
        depth if options.depth else None,
        semantics if options.semantics else None,
    )


def collect(
    recorder: Recorder,
    takes: Sequence[Take],
    workers: int,
    shown: Callable[[Take, int], None] | None = None,
) -> int:
    """Record what is not there yet; returns the number of files written.

    A file under its final name is whole, so a collection that was cut off goes on where it stopped: what it had begun
    is driven again from the same seed, and has the same bytes.

    Raises:
        LogError: a file of a take is there but holds another episode, or is damaged; the system does not let us
            write; another collection is at work in the folder.
    """
    with folder_of_ours(recorder.folder):
        for part in recorder.folder.glob(".*.mcap.part"):
            part.unlink()
        there = {take for take in takes if take.path(recorder.folder).exists()}
        for take in sorted(there):
            recorder.refuse_foreign(take)
        missing = [take for take in takes if take not in there]

        def report(index: int, steps: int) -> None:
            if shown is not None:
                shown(missing[index], steps)

        with closing(recorder):
            run_jobs(recorder, missing, workers, report)
    return len(missing)


@contextmanager
def folder_of_ours(folder: Path) -> Iterator[None]:
    """Make a folder and keep other collections out of it; a process that is killed leaves it open.

    Raises:
        LogError: another collection is at work in it, or the system refuses.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        file = open(folder / LOCK, "wb")  # noqa: SIM115 - closed below
    except OSError as error:
        raise unwritable(folder, error) from error
    try:
        _lock(file, folder)
        try:
            yield
        finally:
            (folder / LOCK).unlink(missing_ok=True)
    finally:
        file.close()


def _lock(file: IO[bytes], folder: Path) -> None:
    try:
        import fcntl
    except ImportError:
        return  # Windows: there nobody is kept out.
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        raise LogError(f"another collection is at work in {folder}", hint="Wait for it, or choose another") from None

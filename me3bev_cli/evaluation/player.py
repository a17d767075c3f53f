"""Plays an evaluation's episodes in one process, several at once, and keeps each log as soon as it is whole."""

from __future__ import annotations

import multiprocessing
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from me3bev_cli.evaluation.crew import Crew, make_crew, row_of
from me3bev_cli.evaluation.drivers import DriverSpec
from me3bev_cli.evaluation.episode import Episode, ending, from_records
from me3bev_cli.evaluation.runner import World, episode_seed, weather_of
from me3bev_cli.evaluation.snapshot import Snapshot
from me3bev_cli.evaluation.timing import Timing

if TYPE_CHECKING:
    import gymnasium

    from me3bev_cli.api import SimulatorPlugin, StepRecord

SNAPSHOT_STEP = 40
"""The snapshot is taken after this many steps, or at the end of a shorter episode."""


@dataclass(frozen=True)
class Method:
    """A row of the tables: who drives, and in which world."""

    spec: DriverSpec
    world: World

    @property
    def label(self) -> str:
        """The row's name, which no other one has."""
        return self.spec.label


class Job(NamedTuple):
    """Some episodes of one method in one cell."""

    method: int
    map: str
    density: str
    indices: tuple[int, ...]
    snapshot: int | None = None
    """Index of an episode to look into."""


class Played(NamedTuple):
    """What a job gives."""

    episodes: list[Episode]
    snapshot: Snapshot | None
    timing: Timing


@dataclass
class _Seat:
    """A row's environment and the episode in it."""

    env: gymnasium.Env[Any, Any]
    left: list[int]
    """Indices that are still to be played, the next one last."""
    index: int = -1
    weather: str = ""
    seen: Any = None
    records: list[StepRecord] = field(default_factory=list)


@dataclass
class Player:
    """Plays jobs in one process; simulator and crew of a method are made at its first job and kept for the next.

    Args:
        methods: who drives, where.
        seed: of the evaluation.
        folder: where each episode's log is written when it is finished, in a folder by method; None: nowhere.
    """

    methods: tuple[Method, ...]
    seed: int
    folder: Path | None = None
    _method: int = field(default=-1, init=False, repr=False)
    _simulator: SimulatorPlugin | None = field(default=None, init=False, repr=False)
    _crew: Crew | None = field(default=None, init=False, repr=False)

    def __call__(self, job: Job) -> Played:
        timing = Timing()
        with timing.spent("busy"):
            with timing.spent("loading"):
                self._load(job.method)
                snapshot = None if job.snapshot is None else self._snapshot(job, job.snapshot)
            episodes = self._play(job, timing) if job.indices else []
        return Played(episodes, snapshot, timing)

    def _load(self, method: int) -> None:
        if method != self._method:
            self._crew = None
            self._simulator = self.methods[method].world.open()
            self._crew = make_crew(self.methods[method].spec)
            self._method = method

    def _make(self, job: Job, images: bool) -> gymnasium.Env[Any, Any]:
        assert self._simulator is not None
        world = self.methods[job.method].world
        return self._simulator.make_env(
            world.observation, map=job.map, density=job.density, weather=world.weather, images=images
        )

    def _play(self, job: Job, timing: Timing) -> list[Episode]:
        assert self._crew is not None
        looks = self.methods[job.method].spec.looks
        lines: dict[int, list[int]] = {}
        for index in reversed(job.indices):
            lines.setdefault(row_of(index), []).append(index)
        with timing.spent("loading"):
            # The first environment opens the map, which takes long.
            seats = {row: _Seat(self._make(job, looks), left) for row, left in sorted(lines.items())}
        episodes: dict[int, Episode] = {}
        try:
            for row, seat in seats.items():
                self._begin(job, row, seat, timing)
            active = dict(seats)
            while active:
                seen, envs = ({row: getattr(s, name) for row, s in active.items()} for name in ("seen", "env"))
                with timing.spent("network"):
                    actions = self._crew.act(seen, envs)
                for row, seat in list(active.items()):
                    with timing.spent("simulator"):
                        seat.seen, _, terminated, truncated, info = seat.env.step(actions[row])
                    seat.records.append(info["record"])
                    if terminated or truncated:
                        episodes[seat.index] = self._end(job, seat, terminated, timing)
                        if not seat.left:
                            del active[row]
                        else:
                            self._begin(job, row, seat, timing)
        finally:
            for seat in seats.values():
                seat.env.close()
        return [episodes[index] for index in job.indices]

    def _begin(self, job: Job, row: int, seat: _Seat, timing: Timing) -> None:
        assert self._crew is not None
        seat.index, seat.records = seat.left.pop(), []
        seed = episode_seed(self.seed, job.map, job.density, seat.index)
        with timing.spent("simulator"):
            seat.seen, info = seat.env.reset(seed=seed)
        seat.weather = weather_of(info)
        self._crew.begin(row, seat.env, seed)

    def _end(self, job: Job, seat: _Seat, terminated: bool, timing: Timing) -> Episode:
        label = self.methods[job.method].label
        episode = from_records(
            seat.records,
            map=job.map,
            density=job.density,
            weather=seat.weather,
            seed=episode_seed(self.seed, job.map, job.density, seat.index),
            index=seat.index,
            driver=label,
            ended=ending(seat.records, terminated=terminated),
        )
        timing.steps += len(episode)
        timing.episodes += 1
        if self.folder is not None:
            episode.save(self.folder / label / episode.file_name)
        if _abandoned():
            raise SystemExit(1)
        return episode

    def _snapshot(self, job: Job, index: int) -> Snapshot:
        """Drive the first part of an episode with the cameras on, apart from the drive that is scored."""
        assert self._crew is not None
        seed, row = episode_seed(self.seed, job.map, job.density, index), row_of(index)
        with closing(self._make(job, images=True)) as env:
            seen, info = env.reset(seed=seed)
            self._crew.begin(row, env, seed)
            step, over = 0, False
            while step < SNAPSHOT_STEP and not over:
                seen, _, terminated, truncated, _ = env.step(self._crew.act({row: seen}, {row: env})[row])
                step, over = step + 1, terminated or truncated
            bev = np.array(env.unwrapped.bev_semantics())  # type: ignore[attr-defined]
            images = np.array(seen["images"])
        method = self.methods[job.method]
        cameras = method.world.observation.cameras
        return Snapshot(method.label, job.map, job.density, weather_of(info), step, cameras, images, bev)


def _abandoned() -> bool:
    """Whether this is a worker process whose parent was killed, so that nobody waits for the rest of its job."""
    parent = multiprocessing.parent_process()
    return parent is not None and not parent.is_alive()

"""Frames with their truth, drawn from the simulator or read from logs, by jobs that depend on nothing but their number.

No torch here: worker processes draw.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from me3bev_cli.api import BEV_CLASSES, ObservationConfig, View
from me3bev_cli.errors import LogError
from me3bev_cli.perception.truth import CELLS, DepthBins, Sight, packed
from me3bev_cli.seeding import derive_seed

if TYPE_CHECKING:
    from me3bev_cli.recording.frames import FrameLog

TRUTH = ("depth", "semantics")
"""Parts of a log from which depth and sight are told, if it has them."""
ROAM, TRIES = 8.0, 4
"""Metres that another place is away, at most, along each axis; how many are tried."""
SWAY = (0.5, 0.05)
"""Metres aside and radians, at most, that a view from the ego's own place is off. An autopilot keeps so exactly to the
middle of its lane that, where lanes are 4 m wide and straight, lines lie exactly between two cells of the map: which of
them is marked is then settled by nothing that can be seen."""
SCALES = (0.75, 0.85, 1.0, 1.0, 1.15, 1.3)
"""How large the world is when it is seen from another place: lanes and sidewalks of one town are all of one width."""
STAND = slice(CELLS // 2 - 5, CELLS // 2 + 5)
"""The cells that a vehicle stands on, whichever way it looks."""
THINGS = [BEV_CLASSES.index(name) for name in ("building", "vehicle", "pedestrian")]
BURST = (5, 20)
"""Steps that a disturbance of the driving lasts, and that pass before the next one, at least and at most."""


Frame = tuple[NDArray[np.uint8], NDArray[np.uint8], NDArray[np.uint8]]
"""Images, map and depth of one moment, as `Frames` holds them."""
Make = Callable[[], Frame]
"""Makes the frame of a step that has been reached: most are passed over."""


@dataclass(eq=False)
class Frames:
    """N frames, as they are kept and sent."""

    images: NDArray[np.uint8]
    """(N, C, 3, H, W)"""
    maps: NDArray[np.uint8]
    """(N, 200, 200), class and sight as `truth.packed`."""
    depth: NDArray[np.uint8]
    """(N, C, bins, h, w), shares in 255ths; no bins where depth is not learned."""
    steps: int
    """Environment steps that were made for them."""

    def __len__(self) -> int:
        return len(self.images)


class Job(NamedTuple):
    """One stretch of driving, or of one log."""

    names: tuple[str | int, ...]
    """What its seeds are derived from."""
    steps: int
    """Environment steps, at most."""
    map: str
    """Which map it is on."""
    log: Path | None = None


@dataclass
class FrameSource:
    """Draws the frames of jobs; can be pickled. Simulator and environments are made at the first and kept.

    Args:
        simulator: an instance of a `SimulatorPlugin`.
        every: of so many environment steps one is kept.
        noise: strength of the disturbances of the autopilot's actions, so that it is seen off its lane too.
        depth: bins in which depth is predicted; None: it is not.
        roam: share of the frames that are seen from elsewhere near by, where the simulator can.
        dress: share of them that are seen in another dress of the map, where it has any.
    """

    simulator: Any
    observation: ObservationConfig
    density: str
    weather: tuple[str, ...] | None
    every: int
    noise: float
    depth: DepthBins | None
    roam: float = 0.0
    dress: float = 0.0
    _envs: dict[str, Any] = field(default_factory=dict, init=False, repr=False)
    _sight: Sight | None = field(default=None, init=False, repr=False)

    def __call__(self, job: Job) -> Frames:
        """The job's frames: the same in every process.

        Raises:
            LogError: a log is damaged, lacks a topic or holds other images than the policy sees.
        """
        source = self._driven(job) if job.log is None else self._logged(job.log)
        kept, steps = [], 0
        for index, frame in enumerate(itertools.islice(source, job.steps)):
            steps = index + 1
            if index % self.every == 0:
                kept.append(frame())
        images, maps, depth = (np.stack(part) for part in zip(*kept, strict=True))
        return Frames(images, maps, depth, steps)

    def close(self) -> None:
        """Close the environments."""
        for env in self._envs.values():
            env.close()
        self._envs.clear()

    def _environment(self, place: str) -> Any:
        """Without images where views can be asked for: most steps are passed over."""
        if place not in self._envs:
            make = partial(
                self.simulator.make_env, self.observation, map=place, density=self.density, weather=self.weather
            )
            env = make(images=False)
            if not hasattr(env.unwrapped, "look_from"):
                env.close()
                env = make()
            self._envs[place] = env
        return self._envs[place]

    def _driven(self, job: Job) -> Iterator[Make]:
        """One episode after another, each driven by the autopilot, its hands knocked now and then."""
        env = self._environment(job.map)
        for episode in itertools.count():
            seed = derive_seed(*job.names, episode)
            observation, _ = env.reset(seed=seed)
            disturbances = _disturbances(np.random.default_rng(seed), self.noise)
            elsewhere = np.random.default_rng(derive_seed(seed, "elsewhere"))
            done = False
            while not done:
                yield partial(self._frame, env, observation, elsewhere)
                action = np.clip(env.unwrapped.autopilot() + next(disturbances), -1.0, 1.0).astype(np.float32)
                observation, _, terminated, truncated, _ = env.step(action)
                done = terminated or truncated

    def _frame(self, env: Any, observation: dict[str, NDArray[Any]], rng: np.random.Generator) -> Frame:
        world = env.unwrapped
        if hasattr(world, "look_from"):
            far = rng.random() < self.roam
            dress = draw_dress(world, rng, self.dress)
            images, depth, classes, bev = self._elsewhere(world, rng, dress) if far else _beside(world, rng, dress)
        else:
            images, bev = observation["images"].copy(), world.bev_semantics()
            depth, classes = world.camera_truth()
        return images, packed(bev, self._seen(depth, classes, bev)), self._shares(depth)

    def _elsewhere(self, world: Any, rng: np.random.Generator, dress: int) -> View:
        """From a free place near by, looking any way; from the ego's own where none is found."""
        for _ in range(TRIES):
            place, turn = rng.uniform(-ROAM, ROAM, 2), rng.uniform(-np.pi, np.pi)
            view: View = world.look_from(*place, turn, rng.choice(SCALES), dress)
            if not np.isin(view.bev[STAND, STAND], THINGS).any():
                return view
        return _beside(world, rng, dress)

    def _logged(self, path: Path) -> Iterator[Make]:
        from me3bev_cli.recording.frames import FrameLog

        log = FrameLog(path, ("images", "bev"))
        topics = [topic for part in TRUTH for topic in log.mapping.topics_of(part)]
        if topics and all(topic in log.file.channels for topic in topics):
            log = FrameLog(path, ("images", "bev", *TRUTH))
        if log.cameras != self.observation.cameras:
            raise LogError(f"the log has the cameras {_listed(log.cameras)}", where=str(path), hint=_same_recipe(self))
        try:
            for number in range(len(log)):
                yield partial(self._of_log, log, number)
        finally:
            log.close()

    def _of_log(self, log: FrameLog, number: int) -> Frame:
        frame = log.frame(number)
        images, bev = frame["images"], frame["bev"]
        size = (self.observation.height, self.observation.width)
        if images.shape[-2:] != size:
            found = "{} x {}".format(*images.shape[-2:])
            raise LogError(f"the images are {found}", where=str(log.path), hint=_same_recipe(self))
        if "depth" not in frame:
            return images, bev, self._shares(None, len(images))
        return images, packed(bev, self._seen(frame["depth"], frame["semantics"], bev)), self._shares(frame["depth"])

    def _seen(self, depth: NDArray[np.float32], classes: NDArray[np.uint8], bev: NDArray[np.uint8]) -> Any:
        self._sight = self._sight or Sight(self.simulator.rig(self.observation))
        return self._sight(depth, classes, bev)

    def _shares(self, depth: NDArray[np.float32] | None, cameras: int = 0) -> NDArray[np.uint8]:
        """Of nothing, where the depth is not known or is not wanted."""
        if self.depth is None:
            return np.zeros((cameras if depth is None else len(depth), 0, 1, 1), np.uint8)
        if depth is None:
            return np.zeros((cameras, len(self.depth.edges) - 1, *self.depth.size), np.uint8)
        return self.depth.shares(depth)


def draw_dress(world: Any, rng: np.random.Generator, share: float) -> int:
    """One of the map's other dresses, or 0, its own, where it has none; `share` is how often it is another."""
    dresses = getattr(world, "dresses", 0)
    return int(rng.integers(1, dresses + 1)) if dresses and rng.random() < share else 0


def _beside(world: Any, rng: np.random.Generator, dress: int) -> View:
    """From the ego's own place, give or take a little: see `SWAY`."""
    view: View = world.look_from(0.0, rng.uniform(-SWAY[0], SWAY[0]), rng.uniform(-SWAY[1], SWAY[1]), 1.0, dress)
    return view


def _listed(names: Sequence[str]) -> str:
    return ", ".join(names)


def _same_recipe(source: FrameSource) -> str:
    seen = source.observation
    return (
        f"The policy sees {_listed(seen.cameras)}, {seen.height} x {seen.width}; `me3bev collect --recipe RECIPE` "
        "records what a recipe's policy sees"
    )


def _disturbances(rng: np.random.Generator, strength: float) -> Iterator[NDArray[np.float64]]:
    """What is added to each action: bursts of one sign and size, with rests between them."""
    while True:
        for _ in range(rng.integers(*BURST)):
            yield np.zeros(2)
        knock = rng.uniform(-strength, strength, 2) * (1.0, 2.0)
        for _ in range(rng.integers(*BURST)):
            yield knock

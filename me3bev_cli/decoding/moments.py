"""Episodes as moments: what the cameras see and the truth of it, step by step, from live drives or from logs."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from me3bev_cli.api import BEV_CLASSES, Rig
from me3bev_cli.errors import LogError
from me3bev_cli.perception.frames import SCALES, SWAY, TRUTH, draw_dress
from me3bev_cli.perception.truth import Sight, mirrored_cameras
from me3bev_cli.pipeline.assemble import configured
from me3bev_cli.seeding import derive_seed

if TYPE_CHECKING:
    from me3bev_cli.recipe import Recipe
    from me3bev_cli.recording.frames import FrameLog
    from me3bev_cli.recording.mapping import TopicMapping


class Take(NamedTuple):
    """One episode: live, by what its seed is derived from, or a log."""

    name: str
    map: str
    weather: str
    density: str = ""
    seed: int = 0
    log: Path | None = None
    varied: bool = False
    """Whether the world is seen in other sizes and dresses, by turned rigs, and with left and right exchanged."""


class Moment(NamedTuple):
    """One step of an episode."""

    images: NDArray[np.uint8]
    """(C, 3, H, W)"""
    bev: NDArray[np.uint8]
    """(200, 200), the truth."""
    seen: NDArray[np.bool_] | None
    """(200, 200), the cells in some camera's clear sight; None where that is not known."""
    pose: tuple[float, float, float]
    """x, y, heading of the map's middle; NaN where it is not known."""
    time: float
    """Seconds; of logs, as they count them."""


class Stand(NamedTuple):
    """From where an episode is seen, throughout it."""

    left: float
    turn: float
    """Metres and radians to the left of the ego's own place."""
    scale: float
    mirrored: bool
    """Whether left and right are exchanged."""
    dress: int = 0
    """As `look_from` has it."""


Look = Callable[[], Moment]
"""Makes a moment that has been reached: most may be passed over."""

TURNED = 0.25
"""Share of varied episodes that are seen by a rig turned any way: an ego's own lane always leads ahead."""
DRESSED = 0.75
"""Share of varied episodes that are seen in another dress of the map, where it has any."""
UNKNOWN = (math.nan, math.nan, math.nan)


def live_takes(
    maps: Sequence[str],
    density: str,
    weather: Sequence[str],
    episodes: int,
    seed: int,
    purpose: str,
) -> list[Take]:
    """So many episodes, maps and kinds of weather taking turns. A map's routes are the same in any weather."""
    takes = []
    for number in range(episodes):
        turn, place = divmod(number, len(maps))
        # Turned by one with each pass over the maps, so that every map sees every weather.
        kind = weather[(turn + place) % len(weather)]
        episode = derive_seed(seed, "decode", purpose, maps[place], density, turn)
        takes.append(Take(f"{maps[place]}-{density}-{kind}-{turn}", maps[place], kind, density, episode))
    return takes


def log_takes(files: Sequence[Path]) -> list[Take]:
    """An episode for each log; map and weather as its metadata has them."""
    from me3bev_cli.recording.reader import read_metadata

    takes = []
    for path in files:
        about = read_metadata(path)
        takes.append(Take(path.stem, about.get("map", "unknown"), about.get("weather", "unknown"), log=path))
    return takes


@dataclass
class Episodes:
    """Plays takes. Environments are made when they are needed and kept.

    A live episode is driven by the autopilot, and seen from a little beside its place: see `perception.frames.SWAY`.
    The shift stays the same throughout an episode, as if the rig were mounted so; as do size, turn and mirroring of
    those that are `varied`.
    """

    recipe: Recipe
    mapping: TopicMapping | None = None
    _envs: dict[tuple[str, str, str], Any] = field(default_factory=dict, init=False, repr=False)
    _sight: Sight | None = field(default=None, init=False, repr=False)

    def play(self, take: Take) -> Iterator[Look]:
        """The take's moments, in order: the same each time.

        Raises:
            LogError: the log is damaged, lacks a topic or holds other images than the policy sees.
        """
        return self._driven(take) if take.log is None else self._logged(take.log)

    def close(self) -> None:
        """Close the environments."""
        for env in self._envs.values():
            env.close()
        self._envs.clear()

    def _environment(self, take: Take) -> Any:
        key = take.map, take.density, take.weather
        if key not in self._envs:
            # One at a time: each has a town's tables.
            self.close()
            cls, config = configured("simulator", self.recipe.simulator)
            options: dict[str, Any] = {"map": take.map, "density": take.density, "weather": (take.weather,)}
            env = cls(config).make_env(self.recipe.observation, **options, images=False)
            if not hasattr(env.unwrapped, "look_from"):
                env.close()
                env = cls(config).make_env(self.recipe.observation, **options)
            self._envs[key] = env
        return self._envs[key]

    def _driven(self, take: Take) -> Iterator[Look]:
        env = self._environment(take)
        stand = self._stand(take, env.unwrapped)
        observation, _ = env.reset(seed=take.seed)
        time, done = 0.0, False
        while not done:
            now = observation
            yield lambda: self._live(env, now, stand, time)  # noqa: B023 - made before the next step, or never
            observation, _, terminated, truncated, info = env.step(env.unwrapped.autopilot())
            time, done = info["record"]["time"], terminated or truncated

    def _stand(self, take: Take, world: Any) -> Stand:
        rng = np.random.default_rng(derive_seed(take.seed, "stand"))
        left, turn = float(rng.uniform(-SWAY[0], SWAY[0])), float(rng.uniform(-SWAY[1], SWAY[1]))
        if not take.varied:
            return Stand(left, turn, 1.0, False)
        if rng.random() < TURNED:
            turn = float(rng.uniform(-np.pi, np.pi))
        mirrored = bool(rng.random() < 0.5) and self._mirror is not None
        scale = float(rng.choice(SCALES))
        return Stand(left, turn, scale, mirrored, draw_dress(world, rng, DRESSED))

    @cached_property
    def _rig(self) -> Rig:
        cls, config = configured("simulator", self.recipe.simulator)
        rig: Rig = cls(config).rig(self.recipe.observation)
        return rig

    @cached_property
    def _mirror(self) -> list[int] | None:
        found = mirrored_cameras(self._rig)
        return None if found is None else list(found)

    def _live(self, env: Any, observation: dict[str, NDArray[Any]], stand: Stand, time: float) -> Moment:
        world = env.unwrapped
        x, y, heading = world.pose()
        if hasattr(world, "look_from"):
            left = stand.left
            images, depth, classes, bev = world.look_from(0.0, left, stand.turn, stand.scale, stand.dress)
            x, y = x - math.sin(heading) * left, y + math.cos(heading) * left
            heading += stand.turn
        else:
            images, bev = observation["images"].copy(), world.bev_semantics()
            depth, classes = world.camera_truth()
        seen = self._seen(depth, classes, bev)
        if stand.mirrored and self._mirror is not None:
            # Where it is in the world is left as it is: nobody asks for it then.
            images, bev, seen = images[self._mirror, ..., ::-1], bev[:, ::-1], seen[:, ::-1]
        return Moment(images, bev, seen, (x, y, heading), time)

    def _logged(self, path: Path) -> Iterator[Look]:
        log = open_log(path, self.mapping)
        wanted = self.recipe.observation
        if len(log.cameras) != len(wanted.cameras) or (self.mapping is None and log.cameras != wanted.cameras):
            raise LogError(
                f"the log has the cameras {', '.join(log.cameras)}", where=str(path), hint=self._same_recipe()
            )

        def look(number: int) -> Moment:
            frame = log.frame(number)
            images, bev = frame["images"], frame["bev"]
            if images.shape[-2:] != (wanted.height, wanted.width):
                found = "{} x {}".format(*images.shape[-2:])
                raise LogError(f"the images are {found}", where=str(path), hint=self._same_recipe())
            if bev.shape != (200, 200):
                raise LogError("the map is {} x {}".format(*bev.shape), where=str(path), allowed="200 x 200 cells")
            if bev.max() >= len(BEV_CLASSES):
                raise LogError(f"the map has a class {bev.max()}", where=str(path), allowed=f"0-{len(BEV_CLASSES) - 1}")
            seen = self._seen(frame["depth"], frame["semantics"], bev) if "depth" in frame else None
            pose = tuple(frame["pose"]) if "pose" in frame else UNKNOWN
            return Moment(images, bev, seen, pose, float(log.times[number]) / 1e9)

        try:
            for number in range(len(log)):
                yield lambda: look(number)  # noqa: B023 - as above
        finally:
            log.close()

    def _seen(self, depth: NDArray[np.float32], classes: NDArray[np.uint8], bev: NDArray[np.uint8]) -> Any:
        self._sight = self._sight or Sight(self._rig)
        return self._sight(depth, classes, bev)

    def _same_recipe(self) -> str:
        wanted = self.recipe.observation
        return (
            f"The policy '{self.recipe.name}' sees {', '.join(wanted.cameras)}, {wanted.height} x {wanted.width}; "
            "`me3bev collect --recipe RECIPE` records what a recipe's policy sees"
        )


def open_log(path: Path, mapping: TopicMapping | None) -> FrameLog:
    """A log with images and map, and with what tells of sight and of the ego's place if it has that.

    Raises:
        LogError: it cannot be read, or lacks images or maps.
    """
    from me3bev_cli.recording.frames import FrameLog

    log = FrameLog(path, ("images", "bev"), mapping)
    there = set(log.file.channels)

    def has(*parts: str) -> bool:
        topics = [log.mapping.topics_of(part) for part in parts]
        return all(topics) and set(itertools.chain(*topics)) <= there

    more = [*(TRUTH if has(*TRUTH) else ()), *(("pose",) if has("pose") else ())]
    return FrameLog(path, ("images", "bev", *more), mapping) if more else log


def check_logs(files: Sequence[Path], recipe: Recipe, mapping: TopicMapping | None) -> None:
    """Raises LogError unless all logs can be read, and have one calibration: the policy's."""
    from me3bev_cli.recording.calibration import LoggedCamera, cameras_of, refuse_mixed

    logs = [open_log(path, mapping) for path in files]
    refuse_mixed(logs)
    cls, config = configured("simulator", recipe.simulator)
    found = {camera.name: camera for camera in cameras_of(logs[0])}
    logs[0].close()
    for own in cls(config).rig(recipe.observation).cameras:
        mount = np.array(own.camera_to_ego())
        wanted = LoggedCamera(own.name, own.width, own.height, np.array(own.intrinsics()), mount)
        other = found.get(own.name)
        difference = None if other is None or other.to_ego is None else other.differs(wanted)
        if difference is not None:
            raise LogError(
                f"recorded with another calibration than the policy's: {difference}",
                where=str(files[0]),
                hint=f"`me3bev collect --recipe RECIPE` records what the policy '{recipe.name}' sees",
            )

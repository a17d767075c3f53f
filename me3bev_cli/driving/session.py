"""`me3bev drive` from its options to its episodes."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from me3bev_cli.api import ObservationConfig, StepRecord
from me3bev_cli.driving.film import HOLD_FRAMES, TITLE_FRAMES, Film
from me3bev_cli.driving.frame import HEIGHT, WIDTH, Caption
from me3bev_cli.driving.progress import DriveProgress
from me3bev_cli.driving.video import check_target
from me3bev_cli.errors import MapError, UserError, unknown_name
from me3bev_cli.evaluation.choice import choose_driver, choose_weather, reference_or_run, world_of
from me3bev_cli.evaluation.drivers import Driver, DriverSpec
from me3bev_cli.evaluation.episode import Episode, ending, from_records
from me3bev_cli.evaluation.metrics import HORIZON
from me3bev_cli.evaluation.runner import World, episode_seed, weather_of
from me3bev_cli.recipe import PluginChoice
from me3bev_cli.stopping import Stop

ON_AND_ON = 600
"""Steps of an episode that nothing ends, unless the user says how many."""
SIZE = (WIDTH, HEIGHT)
"""Of every frame, pixels."""


@dataclass(frozen=True)
class Plan:
    """What is driven, and where it is recorded."""

    world: World
    driver: DriverSpec
    map: str
    density: str
    seed: int
    episodes: int
    steps: int | None
    """Of an episode at most; None: as many as the simulator allows."""
    stop: bool
    """Whether a collision and the simulator's horizon end an episode."""
    video: Path | None

    @property
    def longest(self) -> int:
        """Steps of an episode at most, as far as that is known."""
        return self.steps or HORIZON


def prepare(
    *,
    driver: str | None,
    run: Path | None,
    checkpoint: str,
    recipe: str | None,
    device: str,
    simulator: str | None,
    map: str | None,
    density: str | None,
    weather: str | None,
    camera_size: str | None,
    seed: int,
    episodes: int,
    steps: int | None,
    stop: bool,
    video: str | None,
) -> Plan:
    """Check every option before anything is driven.

    Args:
        driver: a reference driver or a run; the others as in `evaluation.session.prepare`.
        camera_size: as 256x704, for drivers that do not look.
        video: a file's name, "" for the usual one, or None for no video.

    Raises:
        UserError: any of them is wrong.
    """
    if driver is not None:
        driver, found = reference_or_run(driver)
        if found is not None and run is not None:
            raise UserError("two runs are named", where="--driver", hint="Give either --driver RUN or --run RUN")
        run = found or run
    spec, loaded = choose_driver(run, checkpoint, driver, recipe, device)
    world = world_of(loaded)
    if simulator not in (None, world.simulator.name):
        world = replace(world, simulator=PluginChoice(name=simulator))
    if camera_size is not None:
        world = replace(world, observation=_resized(world.observation, camera_size, spec))
    plugin = world.open()
    here = loaded is not None and world.simulator.name == loaded.simulator.name
    place = _one("map", map, plugin.maps(), loaded.simulator.map if loaded and here else None)
    traffic = _one("density", density, plugin.densities(), loaded.simulator.density if loaded and here else None)
    world = replace(world, weather=choose_weather(weather, plugin, loaded if here else None, "evaluation"))
    limit = steps if stop or steps is not None else ON_AND_ON
    path = None if video is None else Path(video or f"drive-{place}-{spec.label}.mp4")
    plan = Plan(world, spec, place, traffic, seed, episodes, limit, stop, path)
    if path is not None:
        check_target(path, episodes * (plan.longest + TITLE_FRAMES + HOLD_FRAMES))
    return plan


def _one(what: str, name: str | None, known: tuple[str, ...], usual: str | None) -> str:
    """The name that is given, else the usual one where it is known, else the first."""
    if name is None:
        return usual if usual in known else known[0]
    if name not in known:
        raise unknown_name(what, name, known, where=f"--{what}", kind=MapError)
    return name


def _resized(observation: ObservationConfig, size: str, spec: DriverSpec) -> ObservationConfig:
    """The observation with images of another size.

    Raises:
        UserError: the driver looks at the images, or the size makes no sense.
    """
    if spec.looks:
        raise UserError("a policy needs images of the size that it was trained with", where="--camera-size")
    found = re.fullmatch(r"(\d+)x(\d+)", size)
    if not found:
        raise UserError(f"'{size}' is not a size", where="--camera-size", allowed="HEIGHTxWIDTH, as 256x704")
    values = observation.model_dump() | {"height": int(found[1]), "width": int(found[2])}
    try:
        return ObservationConfig.model_validate(values)
    except ValidationError as error:
        first = error.errors()[0]
        raise UserError(f"the {first['loc'][0]} is {first['input']}: {first['msg']}", where="--camera-size") from None


def play(plan: Plan, film: Film | None, stop: Stop, progress: DriveProgress) -> Iterator[Episode]:
    """Drive one episode after another, and film them if there is a film.

    A drive that is stopped ends in the middle of an episode, which is filmed so far and left out here.
    """
    driver, plugin = plan.driver.make(), plan.world.open()
    with closing(
        plugin.make_env(
            plan.world.observation,
            map=plan.map,
            density=plan.density,
            weather=plan.world.weather,
            images=film is not None or plan.driver.looks,
        )
    ) as env:
        for index in range(plan.episodes):
            episode = _episode(plan, env, driver, index, film, stop, progress)
            if episode is None:
                return
            if film is not None:
                film.end(episode)
            progress.episode()
            yield episode


def _episode(
    plan: Plan, env: Any, driver: Driver, index: int, film: Film | None, stop: Stop, progress: DriveProgress
) -> Episode | None:
    """Drive one episode; None when it was stopped. Seeds are those of `me3bev eval`."""
    seed = episode_seed(plan.seed, plan.map, plan.density, index)
    seen, info = env.reset(seed=seed)
    weather = weather_of(info)
    driver.begin(env, seed)
    if film is not None:
        film.begin(Caption(plan.map, plan.density, weather, plan.driver.label, plan.seed, index + 1, plan.episodes))
    records: list[StepRecord] = []
    over = terminated = False
    while not over:
        if stop.asked:
            return None
        seen, _, terminated, truncated, info = env.step(driver.act(seen, env))
        record: StepRecord = info["record"]
        records.append(record)
        if film is not None:
            film.step(env, seen, record)
        progress.step()
        over = terminated or truncated if plan.stop else terminated and not record["collision"]
        over = over or len(records) == plan.steps
    return from_records(
        records, map=plan.map, density=plan.density, weather=weather, seed=seed, index=index,
        driver=plan.driver.label, ended=ending(records, terminated=terminated),
    )  # fmt: skip

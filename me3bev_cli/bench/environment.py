"""Steps per second of an environment, beside stock highway-env and beside what the memory allows.

Timed: calls of `step`, with the images and features that it returns, in a process of its own with one thread. Not
timed with them: the autopilot that chooses the actions, and resets, which are reported by themselves. All that is
compared takes turns, round by round, so that a change of the machine's speed touches all of them.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from me3bev_cli import registry
from me3bev_cli.bench.environment_worker import EnvironmentMeter, Slice, World, steps_per_second
from me3bev_cli.errors import UserError, unknown_name
from me3bev_cli.workers import Worker, stop_workers

FULL, BLIND, STOCK = "full", "no_camera", "stock_highway_env"
TARGETS = {"full_ratio": 15.0, "no_camera_ratio": 200.0, "reset_ms": 50.0, "rss_mb": 300.0, "two_workers_ratio": 1.8}
"""What is wanted: at least, and for `reset_ms` and `rss_mb` at most."""
ACTORS = (50, 100, 200, 500)
"""Vehicles and pedestrians, half of each, of the rows of `scaling`."""
POPULATION = ("vehicles", "pedestrians")
"""Keys of a simulator's settings that say how many there are; `scaling` is left out where there are none."""
RESETS = 2
"""Resets per round, beside those at the ends of episodes."""
FLOOR_REPEATS = 15

Progress = Callable[[int, int], None]


@dataclass
class Samples:
    """What the rounds gave."""

    slices: dict[str, list[Slice]] = field(default_factory=dict)
    one: list[float] = field(default_factory=list)
    """Steps/s of one environment in one worker."""
    many: list[float] = field(default_factory=list)
    """Steps/s of as many environments as workers, all together."""
    floor: list[tuple[float, float, float]] = field(default_factory=list)
    """Seconds to write and to copy an observation's bytes, and to read the environment's tables."""

    def rates(self, name: str) -> list[float]:
        """Steps/s of one of those that took turns, round by round."""
        return steps_per_second(self.slices[name])


def chosen_world(simulator: str, map: str, density: str) -> World:
    """The world of the options.

    Raises:
        UserError: there is no such simulator, map or density.
    """
    cls = registry.load("simulator", simulator)
    plugin = cls(cls.Config())
    if map not in plugin.maps():
        raise unknown_name("map", map, plugin.maps(), where="--map")
    if density not in plugin.densities():
        raise unknown_name("density", density, plugin.densities(), where="--density")
    return World(plugin, map, density)


def crowds(world: World) -> dict[int, World]:
    """The world with each number of `ACTORS`; empty when its simulator cannot be told how many."""
    cls = type(world.simulator)
    if not set(POPULATION) <= set(cls.Config.model_fields):
        return {}
    vehicles, pedestrians = POPULATION
    return {
        number: replace(world, simulator=cls(cls.Config(**{vehicles: number // 2, pedestrians: number - number // 2})))
        for number in ACTORS
    }


def measure(world: World, *, seconds: float, rounds: int, workers: int, progress: Progress) -> dict[str, Any]:
    """Measure everything; the figures as `me3bev bench-env --json` writes them.

    Args:
        seconds: of stepping, all environments together.
        rounds: turns that each takes.
        workers: environments, each in a worker of its own, that are compared with one; below 2: left out.
    """
    memory = _memory(world)
    contestants: dict[str, World | None] = {FULL: world, BLIND: replace(world, images=False), STOCK: None}
    crowd = crowds(world)
    for number, place in crowd.items():
        contestants |= {f"{FULL}_{number}": place, f"{BLIND}_{number}": replace(place, images=False)}
    shares = len(contestants) + (2 if workers > 1 else 0)
    pause = seconds / rounds / shares
    samples = Samples({name: [] for name in contestants})
    with _worker() as meter, _fleets(world, workers) as fleets:
        sizes = {name: _ask(meter, "open", name, place) for name, place in contestants.items()}
        written, held = sum(sizes[FULL].values()), _ask(meter, "tables", FULL)
        for number in range(rounds):
            progress(number, rounds)
            for name in contestants:
                resets = RESETS if name == FULL else 0
                samples.slices[name].append(_ask(meter, "run", name, pause, resets))
            samples.floor.append(_ask(meter, "floor", written, held, FLOOR_REPEATS))
            if fleets:
                samples.one.append(_fleet_rate(fleets[0], pause))
                samples.many.append(_fleet_rate(fleets[1], pause))
        progress(rounds, rounds)
    return _report(samples, sizes[FULL], held, memory, list(crowd), workers)


def _report(
    samples: Samples, sizes: dict[str, int], held: int, memory: tuple[float, float], crowd: list[int], workers: int
) -> dict[str, Any]:
    """The figures of all rounds: medians, and quartiles under `spread`."""
    full, blind, stock = (np.array(samples.rates(name)) for name in (FULL, BLIND, STOCK))
    resets = 1000 * np.array([seconds for part in samples.slices[FULL] for seconds in part.resets])
    series = {
        "full_steps_per_s": full,
        "no_camera_steps_per_s": blind,
        "stock_highway_env_steps_per_s": stock,
        "full_ratio": full / stock,
        "no_camera_ratio": blind / stock,
        "reset_ms": resets,
    }
    if samples.one:
        series["workers_ratio"] = np.array(samples.many) / np.array(samples.one)
    report: dict[str, Any] = {key: float(np.median(values)) for key, values in series.items()}
    ratio = report.pop("workers_ratio", None)
    rows = [
        {
            "actors": number,
            "full_ms": float(np.median(1000 / np.array(samples.rates(f"{FULL}_{number}")))),
            "no_camera_ms": float(np.median(1000 / np.array(samples.rates(f"{BLIND}_{number}")))),
        }
        for number in crowd
    ]
    return report | {
        "reset_p95_ms": float(np.percentile(resets, 95)),
        "rss_mb": memory[1],
        "libraries_rss_mb": memory[0],
        "two_workers_ratio": ratio if workers == 2 else None,
        "workers": {
            "count": workers,
            "ratio": ratio,
            "steps_per_s": _middle(samples.many),
            "one": _middle(samples.one),
        },
        "scaling": rows,
        "growth": {key: growth(crowd, [row[key] for row in rows]) for key in ("full_ms", "no_camera_ms")},
        "floor": _floor(samples, sizes, held, 1e6 / report["full_steps_per_s"]),
        "targets": TARGETS,
        "spread": {key: [float(q) for q in np.percentile(values, [25, 75])] for key, values in series.items()},
    }


def _floor(samples: Samples, sizes: dict[str, int], held: int, step_us: float) -> dict[str, float]:
    """How far a step is from the time in which its observation could be written at all, and copied from somewhere."""
    fill, copy, read = (1e6 * float(value) for value in np.median(samples.floor, axis=0))
    return {
        "bytes_written": sum(sizes.values()),
        "pixel_bytes": sizes.get("images", 0),
        "table_bytes": held,
        "write_us": fill,
        "copy_us": copy,
        "read_tables_us": read,
        "step_us": step_us,
        "times_write": step_us / fill,
        "times_copy": step_us / copy,
    }


def growth(numbers: Sequence[int], times: Sequence[float]) -> float | None:
    """The exponent k of time ~ number^k that fits best; below 1 the cost grows less than linearly."""
    if len(numbers) < 2:
        return None
    return float(np.polyfit(np.log(numbers), np.log(times), 1)[0])


def _middle(values: Sequence[float]) -> float | None:
    return float(np.median(values)) if values else None


@contextmanager
def _worker() -> Iterator[Worker]:
    worker = Worker(EnvironmentMeter())
    try:
        yield worker
    except BaseException:
        stop_workers([worker], at_once=True)
        raise
    stop_workers([worker], at_once=False)


def _ask(worker: Worker, *call: Any) -> Any:
    """What a method of `EnvironmentMeter` returns."""
    try:
        worker.send(call)
        return worker.receive()
    except (EOFError, ConnectionError):
        raise UserError(f"the measuring process died: {worker.bury()}", hint="Is memory short?") from None


def _memory(world: World) -> tuple[float, float]:
    """The least of three fresh processes: one that has to compile code first takes half as much again."""
    found: list[tuple[float, float]] = []
    for _ in range(3):
        with _worker() as worker:
            found.append(_ask(worker, "memory", world))
    return min(found, key=lambda megabytes: megabytes[1])


@contextmanager
def _fleets(world: World, workers: int) -> Iterator[list[Any]]:
    """One environment in one worker, and `workers` in as many; nothing when fewer than two are asked for."""
    if workers < 2:
        yield []
        return
    # Late: Stable-Baselines3 brings torch along.
    from me3bev_cli.parallel_envs import ParallelEnvs
    from me3bev_cli.training.episodes import EpisodeMaker

    def makers(count: int) -> list[EpisodeMaker]:
        return [
            EpisodeMaker(world.simulator, world.observation, world.map, world.density, None, True, 0, index, count)
            for index in range(count)
        ]

    fleets: list[Any] = []
    try:
        for count in (1, workers):
            fleets.append(ParallelEnvs(makers(count), count))
            fleets[-1].reset()
            _fleet_rate(fleets[-1], 0.2)
        yield fleets
    finally:
        for fleet in fleets:
            fleet.close()


def _fleet_rate(envs: Any, seconds: float) -> float:
    """Steps/s of all environments together while their cars stand in traffic; resets and handing over included."""
    actions = np.zeros((envs.num_envs, 2), np.float32)
    begun, steps = time.perf_counter(), 0
    while (passed := time.perf_counter() - begun) < seconds:
        envs.step(actions)
        steps += envs.num_envs
    return steps / passed

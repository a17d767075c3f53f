"""What the process that measures environments does. It loads neither torch nor Stable-Baselines3."""

from __future__ import annotations

import gc
import os
import sys
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from itertools import count
from types import BuiltinFunctionType, FunctionType, MethodType, ModuleType
from typing import Any

import gymnasium
import numpy as np

from me3bev_cli.api import ObservationConfig
from me3bev_cli.seeding import derive_seed

FREQUENCY = 10
"""Steps per second of simulated time, of every environment that is compared."""
STOCK_VEHICLES = 100
IDLE = 1
"""Stock highway-env's action that keeps lane and speed."""
HORIZON = 12.8
"""Seconds of an episode of stock highway-env: as many steps as the others' by default."""


@dataclass(frozen=True)
class World:
    """An environment to measure."""

    simulator: Any
    """An instance of a `SimulatorPlugin`."""
    map: str
    density: str
    images: bool = True
    observation: ObservationConfig = field(default_factory=ObservationConfig)

    def make(self) -> gymnasium.Env[Any, Any]:
        """The environment."""
        env: gymnasium.Env[Any, Any] = self.simulator.make_env(
            self.observation, map=self.map, density=self.density, images=self.images
        )
        return env


@dataclass
class Slice:
    """What a while of driving took."""

    steps: int
    step_seconds: float
    resets: list[float]
    """Seconds of each reset."""


class Drive:
    """One environment, episode after episode. Only `step` is timed, and `reset` by itself: not what chooses actions."""

    def __init__(self, env: gymnasium.Env[Any, Any], act: Callable[[], Any], *names: str) -> None:
        self.env, self.act = env, act
        self.seeds = (derive_seed("bench-env", *names, index) for index in count())
        self.reset()

    def reset(self) -> float:
        """Begin the next episode; the seconds it took."""
        seed = next(self.seeds)
        begun = time.perf_counter()
        self.env.reset(seed=seed)
        return time.perf_counter() - begun

    def run(self, seconds: float, resets: int = 0) -> Slice:
        """Drive until the steps have taken `seconds`, then begin `resets` more episodes."""
        found = Slice(0, 0.0, [])
        while found.step_seconds < seconds:
            action = self.act()
            begun = time.perf_counter()
            _, _, terminated, truncated, _ = self.env.step(action)
            found.step_seconds += time.perf_counter() - begun
            found.steps += 1
            if terminated or truncated:
                found.resets.append(self.reset())
        found.resets += [self.reset() for _ in range(resets)]
        return found


def stock_highway_env() -> gymnasium.Env[Any, Any]:
    """highway-env as it comes: its highway with 100 vehicles at 10 Hz, observing the ego only, drawing nothing."""
    os.environ.setdefault("SDL_VIDEODRIVER", "dummy")
    import highway_env  # noqa: F401  # registers its environments

    config = {
        "vehicles_count": STOCK_VEHICLES,
        "simulation_frequency": FREQUENCY,
        "policy_frequency": FREQUENCY,
        "duration": HORIZON,
        "observation": {"type": "Kinematics", "vehicles_count": 1},
    }
    return gymnasium.make("highway-v0", config=config).unwrapped


def resident_megabytes() -> float:
    """Memory of this process that is in use now, in 10^6 bytes; the most it ever had where the system does not say."""
    try:
        with open("/proc/self/statm") as file:
            return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6
    except (OSError, ValueError):
        import resource

        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        return peak / 1e6 if sys.platform == "darwin" else peak * 1024 / 1e6


def array_bytes(root: object) -> int:
    """Bytes of the arrays that can be reached from an object, each counted once; not by way of modules or classes."""
    apart = (ModuleType, type, FunctionType, MethodType, BuiltinFunctionType)
    seen, waiting, sizes = {id(root)}, [root], {}
    while waiting:
        found = waiting.pop()
        if isinstance(found, np.ndarray):
            owner = found
            while isinstance(owner.base, np.ndarray):
                owner = owner.base
            sizes[id(owner)] = owner.nbytes
        for other in gc.get_referents(found):
            if id(other) not in seen and not isinstance(other, apart):
                seen.add(id(other))
                waiting.append(other)
    return sum(sizes.values())


class EnvironmentMeter:
    """Environments by name, measured when asked; called with (name of a method, its arguments)."""

    def __init__(self) -> None:
        self.drives: dict[str, Drive] = {}

    def __call__(self, call: tuple[Any, ...]) -> Any:
        """Do what the parent asks for."""
        name, *arguments = call
        return getattr(self, name)(*arguments)

    def open(self, name: str, world: World | None) -> dict[str, int]:
        """Make an environment, None for stock highway-env, and drive it a little; bytes of an observation by key."""
        if world is None:
            stock = stock_highway_env()
            self.drives[name] = Drive(stock, lambda: IDLE, name)
            self.drives[name].run(0.2)
            return {}
        env = world.make()
        self.drives[name] = Drive(env, env.unwrapped.autopilot, name)  # type: ignore[attr-defined]
        self.drives[name].run(0.2, resets=1)
        observation, _ = env.reset(seed=0)
        return {key: int(value.nbytes) for key, value in observation.items()}

    def run(self, name: str, seconds: float, resets: int) -> Slice:
        """As `Drive.run`."""
        return self.drives[name].run(seconds, resets)

    def tables(self, name: str) -> int:
        """Bytes of all arrays that an environment holds."""
        return array_bytes(self.drives[name].env.unwrapped)

    def floor(self, written: int, held: int, repeats: int) -> tuple[float, float, float]:
        """Median seconds of writing bytes, of copying as many, and of reading others, in memory that is there already.

        Args:
            written: bytes that are written, and copied.
            held: bytes that are read.
        """
        source, target = np.ones(written, np.uint8), np.zeros(written, np.uint8)
        words = np.ones(held // 8 + 1, np.uint64)
        return (
            _median(repeats, lambda: target.fill(7)),
            _median(repeats, lambda: np.copyto(target, source)),
            _median(repeats, words.max),
        )

    def memory(self, world: World) -> tuple[float, float]:
        """Megabytes with numpy, gymnasium and numba loaded, and with one environment that has driven.

        To be asked first, and in a process of its own.
        """
        import numba  # noqa: F401

        before = resident_megabytes()
        self.open("memory", world)
        return before, resident_megabytes()


def _median(repeats: int, call: Callable[[], Any]) -> float:
    def once() -> float:
        begun = time.perf_counter()
        call()
        return time.perf_counter() - begun

    once()
    return float(np.median([once() for _ in range(repeats)]))


def steps_per_second(slices: Iterable[Slice]) -> list[float]:
    """Of each slice."""
    return [part.steps / part.step_seconds for part in slices]

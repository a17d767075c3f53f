"""Drives an episode again by the actions in its log: the seed and the actions give the same drive, to the last bit."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import closing
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from me3bev_cli.api import ObservationConfig, StepRecord
from me3bev_cli.errors import LogError, MapError
from me3bev_cli.evaluation.episode import Episode
from me3bev_cli.evaluation.runner import World, weather_of
from me3bev_cli.recipe import PluginChoice

CHECKED = ("x", "y", "heading", "speed")
"""Columns of the log in which the drive must be the same."""


class Instant(NamedTuple):
    """The world after a step."""

    step: int
    record: StepRecord
    images: NDArray[np.uint8]
    """(C, 3, H, W)."""
    bev: NDArray[np.uint8]
    """(X, Y), classes as `api.BEV_CLASSES`."""
    plan: NDArray[np.uint8]
    """(size, size, 3)."""


def world_for(identity: Mapping[str, Any]) -> World:
    """The world that a method drove in, from what its evaluation's manifest says, with pictures of the usual size."""
    size = ObservationConfig()
    seen = dict(identity["observation"]) | {"height": size.height, "width": size.width}
    simulator = PluginChoice(name=identity["simulator"], **identity["simulator_settings"])
    return World(simulator, ObservationConfig.model_validate(seen), tuple(identity["weather"]) or None)


def replay(world: World, episode: Episode, first: int, last: int, plan: int) -> Iterator[Instant]:
    """The instants of the steps `first` to `last`.

    Args:
        plan: side of the plan, pixels.

    Raises:
        UserError: the simulator or the map is not installed, or the drive is not the log's any more.
    """
    simulator = world.open()
    if episode.map not in simulator.maps():
        raise MapError(f"the map '{episode.map}' is not installed")
    env = simulator.make_env(world.observation, map=episode.map, density=episode.density, weather=world.weather)
    with closing(env):
        seen, info = env.reset(seed=episode.seed)
        if weather_of(info) != episode.weather:
            raise LogError(f"the weather is {weather_of(info)} now, not {episode.weather} as in the log")
        actions = np.stack([episode["steering"], episode["longitudinal"]], 1)
        for step in range(last + 1):
            seen, _, _, _, info = env.step(actions[step])
            record: StepRecord = info["record"]
            if any(record[name] != episode[name][step] for name in CHECKED):  # type: ignore[literal-required]
                raise LogError(
                    f"the simulator has changed: from step {step + 1} on the drive is not the log's any more"
                )
            if step >= first:
                here: Any = env.unwrapped
                yield Instant(
                    step,
                    record,
                    np.array(seen["images"]),
                    np.array(here.bev_semantics()),
                    np.array(here.plan_view(plan)),
                )

"""Which episodes are worth learning from: the autopilot drives several beforehand, and the busiest is taken.

In a wide town at low density nobody is ahead in nineteen frames of twenty, and a driver that never follows anybody does
not learn how. The episodes stay the town's and the density's own. No torch here: worker processes use it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import gymnasium
import numpy as np

from me3bev_cli.errors import UserError

Env = gymnasium.Env[Any, Any]

AHEAD = 20.0
"""Metres from the ego's centre within which somebody counts as ahead."""
ASIDE = 1.5
"""Metres to the left or right within which it does: not as far as the next lane."""
MOVING = 2.0
"""m/s: who stands behind somebody learns little from it."""


class Scout:
    """Drives episodes with the autopilot, without pictures.

    Args:
        make: an environment that does not draw, with the episodes of the one that is trained in.
        count: of how many episodes one is taken.
    """

    def __init__(self, make: Callable[[], Env], count: int) -> None:
        self.make, self.count = make, count
        self._env: Env | None = None

    def busiest(self, seeds: Sequence[int]) -> int:
        """The seed of the episode in which somebody is ahead most often; the first of equals.

        Raises:
            UserError: the simulator does not tell where others are.
        """
        return max(seeds, key=self.encounters)

    def encounters(self, seed: int) -> int:
        """Steps of an episode in which the ego moves and somebody is right ahead of it."""
        env = self._env = self._env or self.make()
        world: Any = env.unwrapped
        if not hasattr(world, "actors"):
            raise UserError(
                "this simulator does not tell where others are: it has no actors()",
                where="stages: busiest_of",
                hint="Leave the key out",
            )
        env.reset(seed=seed)
        count, over = 0, False
        while not over:
            _, _, terminated, truncated, info = env.step(np.asarray(world.autopilot(), np.float32))
            over = terminated or truncated
            count += float(info["record"]["speed"]) > MOVING and _met(world)
        return count

    def close(self) -> None:
        """Close the environment, if one was made."""
        if self._env is not None:
            self._env.close()
            self._env = None


def _met(world: Any) -> bool:
    boxes = world.actors().boxes
    x, y, heading = world.pose()
    dx, dy = boxes[:, 0] - x, boxes[:, 1] - y
    cos, sin = math.cos(heading), math.sin(heading)
    ahead, left = dx * cos + dy * sin, dy * cos - dx * sin
    return bool(((ahead > 0.0) & (ahead <= AHEAD) & (np.abs(left) <= ASIDE)).any())

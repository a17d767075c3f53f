"""Which frames each round of a perception stage is made of: a function of its number."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from me3bev_cli.perception.augment import Change, draw_change
from me3bev_cli.perception.frames import Job
from me3bev_cli.seeding import derive_seed

if TYPE_CHECKING:
    from me3bev_cli.recipe_stages import PerceptionStage

SPARED = 10
"""One log in so many is held out to be scored on, where there are two at least."""


class Minibatch(NamedTuple):
    """What a gradient step is made of: B frames of the pool by number, and what is done to each."""

    chosen: NDArray[np.int64]
    changes: list[Change]


class Rounds:
    """Makes the jobs of rounds and chooses minibatches.

    Args:
        names: what seeds are derived from.
        map: where the stage takes place.
        mirrors: whether frames can be mirrored.
        stretches: whether the grid can be stretched.

    Raises:
        LogError: the stage learns from logs, and there are none.
    """

    def __init__(
        self, stage: PerceptionStage, names: tuple[str | int, ...], map: str, mirrors: bool, stretches: bool
    ) -> None:
        self.stage, self.names, self.map = stage, names, map
        self.mirrors, self.stretches = mirrors, stretches
        logs: Sequence[Path] = ()
        if stage.logs is not None:
            from me3bev_cli.recording.reader import episode_files

            logs = episode_files(stage.logs)
        spared = max(1, len(logs) // SPARED) if len(logs) > 1 else 0
        self._spared, self._logs = list(logs[:spared]), list(logs[spared:])

    def jobs(self, number: int, before: int) -> list[Job]:
        """The stretches of a round, no longer than what is left of the stage.

        Args:
            number: of the round.
            before: environment steps of the stage that come before it.
        """
        stage, left = self.stage, self.stage.steps - before
        jobs = []
        for k in range(stage.envs):
            steps = min(stage.rollout, left - k * stage.rollout)
            if steps > 0:
                jobs.append(Job((*self.names, number, k), steps, self.map, self._log(number * stage.envs + k)))
        return jobs

    def _log(self, turn: int) -> Path | None:
        """Every log once, in an order that is drawn anew each time."""
        if not self._logs:
            return None
        pass_, place = divmod(turn, len(self._logs))
        order = np.random.default_rng(derive_seed(*self.names, "logs", pass_)).permutation(len(self._logs))
        return self._logs[order[place]]

    def held_out(self) -> list[Job]:
        """Stretches that are never learned from."""
        stage = self.stage
        if not stage.held_out:
            return []
        if self._logs:
            return [Job((), stage.rollout, self.map, log) for log in self._spared]
        # Many short ones: more places for as many frames.
        count = min(stage.held_out, 16)
        steps = stage.every * -(-stage.held_out // count)
        return [Job((*self.names, "held out", k), steps, self.map) for k in range(count)]

    def minibatches(self, number: int, kept: int, pool: int) -> list[Minibatch]:
        """What each gradient step of a round is made of.

        Args:
            number: of the round.
            kept: frames that it has brought.
            pool: frames there are to choose from.
        """
        stage = self.stage
        updates = max(1, round(stage.uses * kept / stage.minibatch))
        rng = np.random.default_rng(derive_seed(*self.names, "minibatches", number))
        stretch = stage.stretch if self.stretches else 0.0
        return [
            Minibatch(
                rng.integers(0, pool, stage.minibatch),
                [draw_change(rng, self.mirrors, stage.colours, stretch) for _ in range(stage.minibatch)],
            )
            for _ in range(updates)
        ]

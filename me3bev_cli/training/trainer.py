"""One run: walks a recipe's stages in order, from the start or from a checkpoint, and leaves a run folder behind."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Mapping
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from stable_baselines3.common.logger import TensorBoardOutputFormat

from me3bev_cli.files import atomic_write_text
from me3bev_cli.pipeline.assemble import build_network, pick_device
from me3bev_cli.pipeline.network import Network
from me3bev_cli.training.checkpoint import (
    Progress,
    checkpoints,
    load_progress,
    load_trainer,
    load_weights,
    prune,
    save_checkpoint,
)
from me3bev_cli.training.curve import draw_curve, read_metrics
from me3bev_cli.training.run import versions

if TYPE_CHECKING:
    from me3bev_cli.recipe import Recipe
    from me3bev_cli.recipe_stages import Stage
    from me3bev_cli.stopping import Stop
    from me3bev_cli.training.display import Display

KEEP = 5
"""Checkpoints kept in a run."""

RUNNERS = {
    "imitation": "me3bev_cli.training.imitation_stage:ImitationRunner",
    "ppo": "me3bev_cli.training.ppo_stage:PpoRunner",
}
"""Kind of a stage -> who runs it."""


class InterruptedTrainingError(Exception):
    """Training was asked to stop; its checkpoint has been written."""


class StageRunner(Protocol):
    """Runs one stage, from where `trainer.progress` stands to its last step.

    It counts with `Trainer.count`, tells with `Trainer.log`, keeps with `Trainer.save` and asks `Trainer.stopping`
    often enough that a stop is answered within a second or two.
    """

    def __init__(self, trainer: Trainer, stage: Any) -> None: ...

    def restore(self, state: dict[str, Any]) -> None:
        """Take up what the runner gave to `Trainer.save`; called before `run`, in a new process."""
        ...

    def run(self) -> None:
        """Go to the end of the stage and save.

        Raises:
            InterruptedTrainingError: a stop was asked for; a checkpoint has been written.
        """
        ...


class Trainer:
    """Holds the network and the progress of a run, and offers the stages what they share."""

    def __init__(self, recipe: Recipe, run: Path, display: Display, stop: Stop) -> None:
        self.recipe, self.run, self.display, self.stop = recipe, run, display, stop
        self.device = pick_device(recipe.device)
        self.network: Network = build_network(recipe, recipe.seed).to(self.device)
        self.progress = Progress()
        self._stage_state: dict[str, Any] | None = None
        self._sitting = time.monotonic()
        self._board: TensorBoardOutputFormat | None = None

    def resume(self) -> None:
        """Take up the newest checkpoint of the run, if there is one.

        Raises:
            CheckpointError: it is damaged or of another architecture.
        """
        found = checkpoints(self.run)
        if found:
            load_weights(self.network, found[-1])
            self.progress = load_progress(found[-1])
            self._stage_state = load_trainer(found[-1])
        self._forget_later_rows()

    def _forget_later_rows(self) -> None:
        """Drop what the log holds beyond the checkpoint: those updates were lost and are made again."""
        rows = [row for row in read_metrics(self.run) if row["steps"] <= self.progress.total_steps]
        atomic_write_text(self.run / "metrics.jsonl", "".join(json.dumps(row) + "\n" for row in rows))

    def train(self) -> Path:
        """Train until every stage is done; returns the last checkpoint.

        Raises:
            InterruptedTrainingError: Ctrl-C was pressed; a checkpoint has been written.
        """
        atomic_write_text(self.run / "versions.json", json.dumps(versions(), indent=1))
        while self.progress.stage < len(self.recipe.stages):
            runner = self._runner(self.recipe.stages[self.progress.stage])
            if self._stage_state:
                runner.restore(self._stage_state)
            runner.run()
            self.progress.stage += 1
            self.progress.stage_steps = self.progress.episodes = self.progress.updates = 0
            self._stage_state = None
        self.progress.done = True
        last = self.save({})
        self._finish(last)
        return last

    def _runner(self, stage: Stage) -> StageRunner:
        module, _, name = RUNNERS[stage.kind].partition(":")
        runner: StageRunner = getattr(import_module(module), name)(self, stage)
        return runner

    @property
    def stopping(self) -> bool:
        """Whether someone asked to stop."""
        return self.stop.asked

    def count(self, steps: int, episodes: int = 0) -> None:
        """Enter environment steps and finished episodes."""
        self.progress.stage_steps += steps
        self.progress.total_steps += steps
        self.progress.episodes += episodes

    def standing(self) -> dict[str, Any]:
        """Where the run stands: the first keys of every row of the log."""
        progress = self.progress
        return {
            "stage": progress.stage,
            "kind": self.recipe.stages[progress.stage].kind,
            "steps": progress.total_steps,
            "stage_steps": progress.stage_steps,
            "episodes": progress.episodes,
        }

    def log(self, values: Mapping[str, float | None]) -> None:
        """One row of `metrics.jsonl`, of TensorBoard and on the screen: an update of any kind of stage."""
        row = self.standing() | {key: value if _finite(value) else None for key, value in values.items()}
        with open(self.run / "metrics.jsonl", "a") as file:
            file.write(json.dumps(row) + "\n")
        if self._board is None:
            self._board = TensorBoardOutputFormat(str(self.run / "tensorboard"))
        scalars = {f"{row['kind']}/{key}": value for key, value in values.items() if value is not None}
        self._board.write(scalars, dict.fromkeys(scalars, ()), row["steps"])
        self.display.update(row)

    def save(self, state: dict[str, Any]) -> Path:
        """Write a checkpoint: the weights, where the run stands, and `state`, what the stage's runner needs to go on.

        Args:
            state: a tree of tensors and plain values; empty between stages.
        """
        now = time.monotonic()
        self.progress.seconds += now - self._sitting
        self._sitting = now
        folder = save_checkpoint(self.run, self.network, self.recipe, self.progress, state)
        prune(self.run, KEEP)
        with suppress(ValueError):  # nothing to draw before the first update
            draw_curve(self.run, self.run / "reward.png")
        return folder

    def _finish(self, last: Path) -> None:
        rows = read_metrics(self.run)
        rewards = [row["reward_per_step"] for row in rows if row.get("reward_per_step") is not None][-10:]
        summary = {
            "recipe": self.recipe.name,
            "seed": self.recipe.seed,
            "steps": self.progress.total_steps,
            "seconds": round(self.progress.seconds, 1),
            "reward_per_step": float(np.mean(rewards)) if rewards else None,
            "checkpoint": last.name,
            "parameters": sum(p.numel() for p in self.network.parameters()),
        }
        atomic_write_text(self.run / "summary.json", json.dumps(summary, indent=1))


def _finite(value: float | None) -> bool:
    return value is None or math.isfinite(value)

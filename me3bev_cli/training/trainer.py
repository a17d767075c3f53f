"""One run: walks a recipe's stages in order, from the start or from a checkpoint, and leaves a run folder behind."""

from __future__ import annotations

import json
import time
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
import torch

from me3bev_cli.errors import CheckpointError
from me3bev_cli.files import atomic_write_text
from me3bev_cli.pipeline.assemble import build_network, pick_device
from me3bev_cli.pipeline.network import Network
from me3bev_cli.training.alarms import CHECKPOINT, DiskError
from me3bev_cli.training.best import read_best
from me3bev_cli.training.checkpoint import (
    Progress,
    checkpoints,
    clear_leftovers,
    load_progress,
    load_trainer,
    load_weights,
    prune,
    save_checkpoint,
    set_aside,
)
from me3bev_cli.training.curve import draw_curve, read_metrics
from me3bev_cli.training.evaluations import Evaluations
from me3bev_cli.training.journal import Journal
from me3bev_cli.training.memory_need import check_memory
from me3bev_cli.training.run import provenance

if TYPE_CHECKING:
    from me3bev_cli.recipe import Recipe
    from me3bev_cli.recipe_stages import Stage
    from me3bev_cli.stopping import Stop
    from me3bev_cli.training.display import Display

KEEP = 5
"""Checkpoints kept in a run."""

RUNNERS = {
    "imitation": "me3bev_cli.training.imitation_stage:ImitationRunner",
    "perception": "me3bev_cli.training.perception_stage:PerceptionRunner",
    "ppo": "me3bev_cli.training.ppo_stage:PpoRunner",
}
"""Kind of a stage -> who runs it."""


class InterruptedTrainingError(Exception):
    """Training was asked to stop; its checkpoint has been written."""


class StageRunner(Protocol):
    """Runs one stage, from where `trainer.progress` stands to its last step.

    It counts with `Trainer.count`, tells with `Trainer.log` and asks `Trainer.stopping` often enough that a stop is
    answered within a second or two. It keeps with `Trainer.save`, or with `Trainer.mark` wherever it could go on from
    and `Trainer.save_mark` now and then: the mark is what is written when the stage is interrupted.
    """

    def __init__(self, trainer: Trainer, stage: Any) -> None: ...

    def restore(self, state: dict[str, Any]) -> None:
        """Take up what the runner gave to `Trainer.save` or `Trainer.mark`; called before `run`, in a new process."""
        ...

    def run(self) -> None:
        """Go to the end of the stage, where the trainer saves.

        Raises:
            InterruptedTrainingError: a stop was asked for; what is to be kept is saved or marked.
        """
        ...


class Trainer:
    """Holds the network and the progress of a run, and offers the stages what they share."""

    def __init__(self, recipe: Recipe, run: Path, display: Display, stop: Stop) -> None:
        self.recipe, self.run, self.display, self.stop = recipe, run, display, stop
        self.device = pick_device(recipe.device)
        self.network: Network = build_network(recipe, recipe.seed).to(self.device)
        check_memory(self.network, recipe, self.device)
        self.progress = Progress()
        self.evaluations = Evaluations(self)
        self._stage_state: dict[str, Any] | None = None
        self.journal = Journal(run)
        self._mark: _Mark | None = None
        self._sitting = time.monotonic()
        self._seconds_before = 0.0

    def resume(self) -> None:
        """Take up the newest checkpoint of the run, if there is one; a damaged one is set aside.

        Raises:
            CheckpointError: every one is damaged or of another architecture.
        """
        clear_leftovers(self.run)
        damaged: list[tuple[Path, CheckpointError]] = []
        for folder in reversed(checkpoints(self.run)):
            try:
                progress, state = load_progress(folder), load_trainer(folder)
                load_weights(self.network, folder)
            except CheckpointError as error:
                damaged.append((folder, error))
                continue
            self.progress, self._stage_state = progress, state
            self._seconds_before = progress.seconds
            break
        else:
            if damaged:
                raise damaged[0][1]
        for folder, why in damaged:
            self.warn(CHECKPOINT, f"{why}; it is kept as {set_aside(folder).name}, and an older one is taken up")
        self.journal.forget_after(self.progress.total_steps)

    def train(self) -> Path:
        """Train until every stage is done; returns the last checkpoint.

        Raises:
            InterruptedTrainingError: Ctrl-C was pressed; a checkpoint has been written.
        """
        atomic_write_text(self.run / "versions.json", json.dumps(provenance(self.recipe), indent=1))
        while self.progress.stage < len(self.recipe.stages):
            self._run_stage(self.recipe.stages[self.progress.stage])
            self.progress.stage += 1
            self.progress.stage_steps = self.progress.episodes = self.progress.updates = 0
            if self.progress.stage < len(self.recipe.stages):
                self.save({})
                if self.stopping:
                    raise InterruptedTrainingError
        self.progress.done = True
        last = self.save({})
        self._finish(last)
        return last

    def _run_stage(self, stage: Stage) -> None:
        """Run a stage; whatever ends it early, the last place that it could go on from is kept."""
        runner = self._runner(stage)
        if self._stage_state:
            runner.restore(self._stage_state)
        self._stage_state, self._mark = None, None
        try:
            runner.run()
            self.evaluations.when_due(at_end=True)
        except InterruptedTrainingError:
            self._go_back_to_mark()
            raise
        except DiskError:
            raise
        except Exception:
            with suppress(DiskError):
                self._go_back_to_mark()
            raise
        self._mark = None

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
        """One row of `metrics.jsonl`, of TensorBoard and on the screen: an update of any kind of stage.

        Raises:
            DiskError: it cannot be written.
        """
        row = self.journal.row(self.standing(), values)
        self.display.update(row)

    def warn(self, kind: str, text: str) -> None:
        """Say that something went wrong after which the run goes on: on the screen, in `alarms.jsonl`, and counted in
        the next row of the log."""
        self.display.say(f"warning: {text}")
        self.journal.alarm(kind, text, self.progress.total_steps)

    def mark(self, state: dict[str, Any], saved: bool = False) -> None:
        """Keep in memory what a checkpoint of this moment holds: the weights, where the run stands, and `state`.

        Args:
            state: a tree of tensors and plain values, copied: what the runner needs to go on exactly.
            saved: a checkpoint of this moment is on the disk already.
        """
        weights = {key: value.detach().clone() for key, value in self.network.state_dict().items()}
        self._mark = _Mark(replace(self.progress), weights, state, saved)

    def save_mark(self, draw: bool = True) -> None:
        """Write the checkpoint that was marked last, unless it has been written.

        Args:
            draw: the curve too, which takes longer than all the rest.
        """
        mark = self._mark
        if mark is not None and not mark.saved:
            mark.progress.seconds = self._seconds()
            self._save(mark.weights, mark.progress, mark.state)
            mark.saved = True
            if draw:
                self._draw()

    def _go_back_to_mark(self) -> None:
        """End a stage where it was marked last: what came after is done again when the run goes on."""
        if self._mark is None:
            return
        self.save_mark(draw=False)
        again = self.progress.total_steps - self._mark.progress.total_steps
        if again:
            self.display.say(f"the last {again:,} steps will be done again: their update was not finished")
        self.progress = self._mark.progress

    def save(self, state: dict[str, Any]) -> Path:
        """Write a checkpoint: the weights, where the run stands, and `state`, what the stage's runner needs to go on.

        Args:
            state: a tree of tensors and plain values; empty between stages.

        Raises:
            DiskError: it cannot be written.
        """
        self.progress.seconds = self._seconds()
        folder = self._save(self.network.state_dict(), self.progress, state)
        if not self.stopping:
            self._draw()
        return folder

    def _seconds(self) -> float:
        """Time spent training, over all sittings, until now."""
        return self._seconds_before + time.monotonic() - self._sitting

    def _save(self, weights: Mapping[str, torch.Tensor], progress: Progress, state: dict[str, Any]) -> Path:
        folder = save_checkpoint(self.run, weights, self.recipe, progress, state)
        prune(self.run, KEEP, self.recipe.keep_every)
        return folder

    def _draw(self) -> None:
        # Nothing to draw before the first update; and a curve that cannot be written is no reason to stop.
        with suppress(ValueError, OSError):
            draw_curve(self.run, self.run / "reward.png")

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
            "best_evaluation": read_best(self.run),
            "parameters": sum(p.numel() for p in self.network.parameters()),
        }
        atomic_write_text(self.run / "summary.json", json.dumps(summary, indent=1))


@dataclass
class _Mark:
    """A checkpoint in memory."""

    progress: Progress
    weights: dict[str, torch.Tensor]
    state: dict[str, Any]
    saved: bool

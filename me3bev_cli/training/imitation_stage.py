"""An `imitation` stage: the policy learns from the autopilot, in states that it gets itself into (DAgger)."""

from __future__ import annotations

import math
import time
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from numpy.typing import NDArray

from me3bev_cli.errors import CheckpointError
from me3bev_cli.seeding import derive_seed
from me3bev_cli.training.alarms import WORKER, guard_gradients, guard_outputs
from me3bev_cli.training.demonstrations import Floats, Pool, Round, Taught
from me3bev_cli.training.environments import first_episode_of, make_environments
from me3bev_cli.training.imitation_driving import Outcome, RoundDriver
from me3bev_cli.training.imitation_learning import Learner, Losses, errors
from me3bev_cli.training.trainer import InterruptedTrainingError

if TYPE_CHECKING:
    from me3bev_cli.recipe_stages import ImitationStage
    from me3bev_cli.training.trainer import Trainer


class ImitationRunner:
    """Rounds of driving and learning.

    What was seen is not kept on disk. A checkpoint has the actions of the rounds that are still learned from: a run
    that goes on plays them again, and has the same frames. A round that was being driven is driven again.
    """

    def __init__(self, trainer: Trainer, stage: ImitationStage) -> None:
        self.trainer, self.stage = trainer, stage
        self.learner = Learner(trainer.network, stage, trainer.device)
        # A window is preceded by its own frames; a stream fills its memory with frames before the segment.
        streams = stage.burn_in if trainer.recipe.temporal and trainer.recipe.context.kind == "stream" else 0
        self.prefix = max(trainer.network.prefix, streams)
        self.pool = Pool(stage.pool, stage.segment, self.prefix)
        self.index, self.first = 0, 0
        """The round, and its first episode."""
        self.counted, self.learned = 0, 0
        """Rows of it that were driven, and minibatches that were learned."""
        self.losses: list[Losses] = []
        self._before: list[tuple[int, int, Floats]] = []

    def restore(self, state: dict[str, Any]) -> None:
        """Take up optimiser, random state and the round; its frames come when the environments have been made.

        Raises:
            CheckpointError: the state is of another version.
        """
        if not {"optimizer", "round", "rounds"} <= state.keys():
            raise CheckpointError("the checkpoint is of another version of me3bev and cannot be gone on from")
        self.learner.optimizer.load_state_dict(state["optimizer"])
        torch.set_rng_state(state["torch_random"])
        if "cuda_random" in state and torch.cuda.is_available():
            torch.cuda.set_rng_state_all(state["cuda_random"])
        self.index, self.first = state["round"], state["first"]
        self.counted, self.learned = state["counted"], state["learned"]
        self.losses = [Losses(*pair) for pair in state["losses"]]
        if self.learned:
            # The present round's row is written when it is finished: again, if that had been so.
            self.trainer.journal.forget_after(self.trainer.progress.total_steps - 1)
        self._before = [(index, first, actions.numpy()) for index, first, actions in state["rounds"]]

    def run(self) -> None:
        """Drive and learn until the stage's steps are done.

        Raises:
            InterruptedTrainingError: a stop was asked for; a checkpoint has been written.
            AlarmError: something is wrong; a checkpoint of the moment before has been written.
        """
        trainer, stage = self.trainer, self.stage
        if self.index >= self.count:
            return
        first = first_episode_of(trainer.progress.stage)
        env = make_environments(trainer.recipe, stage, first, Taught, lambda text: trainer.warn(WORKER, text))
        end = guard_outputs(trainer.network, trainer.run)
        guard_gradients(self.learner.optimizer, trainer.network, trainer.run)
        try:
            driver = RoundDriver(env, trainer.network, stage, trainer.device)
            # A stop in here leaves nothing to keep: the checkpoint that is taken up still stands.
            outcome = self._play_again(driver)
            try:
                self._rounds(driver, outcome)
            except Exception:
                self.save()
                raise
            self.save()
        finally:
            end()
            env.close()

    def _rounds(self, driver: RoundDriver, outcome: Outcome | None) -> None:
        """The rounds that are left; the first of them has been driven already if there is an outcome."""
        progress, stage = self.trainer.progress, self.stage
        saved = progress.stage_steps
        while self.index < self.count:
            clock = time.monotonic()
            if outcome is None:
                outcome = self._drive(driver)
            self._learn()
            self._tell(outcome, time.monotonic() - clock)
            self.first = outcome.next_first
            self.index, self.counted, self.learned, outcome = self.index + 1, 0, 0, None
            if progress.stage_steps - saved >= stage.checkpoint_every:
                saved = progress.stage_steps
                self.save()
            self._check_stop()
            self.trainer.evaluations.when_due()

    @property
    def count(self) -> int:
        """Rounds of the stage."""
        return math.ceil(self.stage.steps / (self.stage.envs * self.stage.rollout))

    def _length(self, index: int) -> int:
        """Steps per environment of a round: the last one is no longer than the stage's steps need."""
        stage = self.stage
        left = math.ceil(stage.steps / stage.envs) - index * stage.rollout
        return min(stage.rollout, math.ceil(left / stage.segment) * stage.segment)

    def _rng(self, what: str, index: int) -> np.random.Generator:
        trainer = self.trainer
        return np.random.default_rng(derive_seed(trainer.recipe.seed, "imitation", what, trainer.progress.stage, index))

    def _empty(self, index: int, first: int) -> Round:
        return Round(index, first, self._length(index), self.stage.envs, self.prefix)

    def _drive(self, driver: RoundDriver) -> Outcome:
        """Drive the present round and put it into the pool."""
        one = self._empty(self.index, self.first)
        self.pool.make_room(one.size)
        outcome = driver.drive(one, self.stage.beta**self.index, self._rng("driving", self.index), self._stepped)
        self.pool.add(one)
        return outcome

    def _stepped(self, row: int, dones: NDArray[np.bool_]) -> None:
        if row >= self.counted:
            self.counted = row + 1
            self.trainer.count(len(dones), int(dones.sum()))
        self._show()
        self._check_stop()

    def _play_again(self, driver: RoundDriver) -> Outcome | None:
        """Fill the pool as it was when the checkpoint was written; the present round's outcome if it was driven."""
        outcome = None
        for index, first, actions in self._before:
            one = self._empty(index, first)
            rng = self._rng("driving", index)
            played = driver.drive(one, self.stage.beta**index, rng, lambda *_: self._check_stop(), actions)
            self.pool.add(one)
            outcome = played if index == self.index else None
        return outcome

    def _learn(self) -> None:
        """The present round's gradient steps."""
        stage, rate = self.stage, self.stage.learning_rate.at(self.trainer.progress.stage_steps)
        batches = math.ceil(stage.epochs * self.pool.rounds[-1].size / stage.minibatch)
        order = self.pool.order(self._rng("learning", self.index), batches, stage.minibatch // stage.segment)
        if self.learned == 0:
            self.losses = []
        for segments in order[self.learned :]:
            self._show()
            self._check_stop()
            self.losses.append(self.learner.learn(self.pool.lesson(segments), rate))
            self.learned += 1

    def _tell(self, outcome: Outcome, seconds: float) -> None:
        """One row of the log. What is said of driving is the policy's own: None while the autopilot drives."""
        one, episodes = outcome.round, outcome.student_episodes
        own = ~one.guided
        steering, longitudinal = errors(one.actions[own], one.labels[own]) if own.any() else (None, None)
        action, value = np.mean(self.losses, axis=0).tolist()
        row: dict[str, float | None] = {
            "round": float(one.index),
            "reward_per_step": float(np.mean(outcome.rewards)),
            "autopilot_share": float(one.guided.mean()),
            "loss": action,
            "value_loss": value,
            "steering_error": steering,
            "longitudinal_error": longitudinal,
            "learning_rate": self.stage.learning_rate.at(self.trainer.progress.stage_steps),
            "steps_per_second": one.size / seconds,
        }
        for key in ("collision_rate", "route_completion", "episode_steps"):
            row[key] = float(np.mean([episode[key] for episode in episodes])) if episodes else None
        self.trainer.progress.updates += 1
        self.trainer.log(row)

    def _show(self) -> None:
        blank = dict.fromkeys(("reward_per_step", "collision_rate", "route_completion"))
        self.trainer.display.step(lambda: self.trainer.standing() | blank)

    def _check_stop(self) -> None:
        if self.trainer.stopping:
            raise InterruptedTrainingError

    def save(self) -> None:
        """Write a checkpoint of the stage that is running."""
        state: dict[str, Any] = {
            "optimizer": self.learner.optimizer.state_dict(),
            "torch_random": torch.get_rng_state(),
            "round": self.index,
            "first": self.first,
            "counted": self.counted,
            "learned": self.learned,
            "losses": [list(pair) for pair in self.losses],
            "rounds": [[one.index, one.first, torch.from_numpy(one.actions)] for one in self.pool.rounds],
        }
        if self.trainer.device.type == "cuda":
            state["cuda_random"] = torch.cuda.get_rng_state_all()
        self.trainer.save(state)

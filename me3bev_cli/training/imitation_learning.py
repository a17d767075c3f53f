"""Behaviour cloning's gradient steps: the policy's mean action towards the autopilot's, the critic to the returns."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

from me3bev_cli.pipeline.policy import PARTS, computing
from me3bev_cli.pipeline.transfer import to_device, to_tensors
from me3bev_cli.training.demonstrations import Floats, Lesson

if TYPE_CHECKING:
    from me3bev_cli.pipeline.network import Network
    from me3bev_cli.recipe_stages import ImitationStage


class Losses(NamedTuple):
    """Of one minibatch."""

    action: float
    value: float


class Learner:
    """Adam on what may learn in the stage. A Gaussian policy keeps its deviation: PPO is to explore with it."""

    def __init__(self, network: Network, stage: ImitationStage, device: torch.device) -> None:
        self.network, self.stage, self.device = network, stage, device
        named = [getattr(network, module) for part in stage.freeze for module in PARTS[part]]
        self.frozen: list[nn.Module] = [module for module in named if module is not None]
        network.freeze(self.frozen)
        network.microbatch = stage.microbatch
        self.parameters = [p for name, p in network.named_parameters() if p.requires_grad and name != "actor.log_std"]
        critic = {id(p) for p in network.critic.parameters()}
        # The critic's errors are much larger, above all where something happens: clipped with the policy's, they would
        # take its gradient away just there.
        self.clipped = [[p for p in self.parameters if (id(p) in critic) == judging] for judging in (False, True)]
        self.optimizer = torch.optim.Adam(self.parameters, lr=stage.learning_rate.initial, eps=1e-5)
        self.weights = torch.tensor([stage.steering_weight, 1.0], device=device)

    def learn(self, lesson: Lesson, rate: float) -> Losses:
        """One gradient step."""
        for group in self.optimizer.param_groups:
            group["lr"] = rate
        self.network.train()
        for module in self.frozen:
            module.eval()
        with computing(self.device, self.stage.autocast):
            modes, values = self._evaluate(lesson)
        action = self._distance(modes, to_device(lesson.labels, self.device))
        value = nn.functional.mse_loss(values, to_device(lesson.returns, self.device))
        self.optimizer.zero_grad()
        (action + self.stage.value * value).backward()  # type: ignore[no-untyped-call]
        for parameters in self.clipped:
            nn.utils.clip_grad_norm_(parameters, self.stage.max_grad_norm)
        self.optimizer.step()
        return Losses(float(action.detach()), float(value.detach()))

    def _evaluate(self, lesson: Lesson) -> tuple[Tensor, Tensor]:
        """Mean actions (B L, 2) and values (B L,) of segments. The critic reads the policy's features, no more."""
        frames = to_tensors(lesson.observations, self.device)
        starts = to_device(lesson.starts, self.device)
        state = self.network.initial_state(len(starts))
        shaped = {name: e.reshape(*starts.shape, *e.shape[1:]) for name, e in self.network.encode(frames).items()}
        latents = self.network.memory.sequence(shaped, state, starts)
        # A stream also answers for the frames that only filled its memory.
        own = {name: y[:, -self.stage.segment :].flatten(0, 1) for name, y in latents.items()}
        u = self.network.fuse(own)
        return self.network.actor(u).mode(), self.network.critic(u.detach())

    def _distance(self, modes: Tensor, labels: Tensor) -> Tensor:
        error = modes - labels
        each = error.abs() if self.stage.loss == "l1" else error.square()
        return (each * self.weights).sum(-1).mean()


def errors(actions: Floats, labels: Floats) -> tuple[float, float]:
    """Mean absolute error of steering and of throttle and brake."""
    mean = np.abs(actions - labels).reshape(-1, 2).mean(0)
    return float(mean[0]), float(mean[1])

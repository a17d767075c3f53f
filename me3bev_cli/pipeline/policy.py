"""The network in Stable-Baselines3's clothes, so that its PPO can train it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from gymnasium import spaces
from stable_baselines3.common.policies import BasePolicy
from stable_baselines3.common.type_aliases import PyTorchObs, Schedule
from torch import Tensor

from me3bev_cli.pipeline.network import Network

STARTS = "episode_starts"
STATE = "state"
"""Keys that a minibatch carries beside the observations: (B, P + L) bool and the stored memory."""

PARTS = {
    "spatial": ("spatial",),
    "encoders": ("encoders",),
    "temporal": ("memory",),
    "fusion": ("projection", "fusion"),
}
"""A recipe's name of a part that can be frozen -> the network's modules."""


class DrivingPolicy(BasePolicy):
    """Wraps a `Network`; PPO's loss calls `evaluate_actions`, collection calls `step`."""

    def __init__(
        self,
        observation_space: spaces.Space[Any],
        action_space: spaces.Space[Any],
        lr_schedule: Schedule,
        use_sde: bool = False,
        *,
        network: Network,
        frozen: tuple[str, ...] = (),
    ) -> None:
        super().__init__(observation_space, action_space, squash_output=False, normalize_images=False)
        self.network = network
        named = [getattr(network, module) for part in frozen for module in PARTS[part]]
        self.frozen = [module for module in named if module is not None]
        network.freeze(self.frozen)
        trained = [p for p in network.parameters() if p.requires_grad]
        self.optimizer = torch.optim.Adam(trained, lr=lr_schedule(1), eps=1e-5)
        self.before_minibatch: Callable[[], None] | None = None

    def set_training_mode(self, mode: bool) -> None:
        """Frozen parts stay in evaluation mode."""
        super().set_training_mode(mode)
        for module in self.frozen:
            module.eval()

    def evaluate_actions(self, obs: PyTorchObs, actions: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Values, log-probabilities and entropies (B L,) of segments, as PPO's loss needs them."""
        if self.before_minibatch is not None:
            self.before_minibatch()
        frames = dict(obs)
        starts, state = frames.pop(STARTS), frames.pop(STATE, None)
        decision = self.network.evaluate(frames, state, starts)
        return decision.values, decision.actions.log_prob(actions), decision.actions.entropy()

    def forward(self, obs: Any, deterministic: bool = False) -> Any:
        """Not how a policy with memory is called: use `network.step`."""
        raise TypeError("a driving policy has memory: call network.step with its state")

    def _predict(self, observation: PyTorchObs, deterministic: bool = False) -> Tensor:
        """As `forward`: without its memory there is nothing to predict from."""
        raise TypeError("a driving policy has memory: drive it with pipeline.control.Controller")

"""The network in Stable-Baselines3's clothes, so that its PPO can train it."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from contextlib import AbstractContextManager, nullcontext
from typing import Any, Literal, Protocol

import torch
from gymnasium import spaces
from stable_baselines3.common.policies import BasePolicy
from stable_baselines3.common.type_aliases import PyTorchObs, Schedule
from torch import Tensor

from me3bev_cli.pipeline.network import Network

STARTS = "episode_starts"
ROWS = "rows"
STATE = "state"
"""Keys that a minibatch carries beside the observations: (B, P + L) bool, (B, P + L) which frame stands where, and the
stored memory."""

PARTS = {
    "spatial": ("spatial",),
    "encoders": ("encoders",),
    "temporal": ("memory",),
    "fusion": ("projection", "fusion"),
}
"""A recipe's name of a part that can be frozen -> the network's modules."""

BEFORE_MEMORY = {"spatial": ("bev",), "encoders": ("vr", "nav")}
"""Those of them that read one frame each -> the modalities that they encode."""

Precision = Literal["bfloat16"]


class Guide(Protocol):
    """Draws mean actions to what somebody else would do."""

    key: str
    """Where an observation holds that, (2,)."""

    def __call__(self, labels: Tensor, modes: Tensor, log_probs: Tensor) -> Tensor:
        """Of a minibatch; the same log-probabilities (N,), with a loss that is descended with them."""
        ...


def settled_embeddings(network: Network, frozen: Iterable[str]) -> dict[str, tuple[int, int]]:
    """(K, D) of the embeddings that no update changes: what encodes them is frozen."""
    settled = {modality for part in frozen for modality in BEFORE_MEMORY.get(part, ())}
    return {name: shape for name, shape in network.embedding_shapes.items() if name in settled}


def computing(device: torch.device, autocast: Precision | None) -> AbstractContextManager[None]:
    """The context in which a network is computed in a shorter type; None: in its own."""
    return nullcontext() if autocast is None else torch.autocast(device.type, getattr(torch, autocast))


class DrivingPolicy(BasePolicy):
    """Wraps a `Network`; PPO's loss calls `evaluate_actions`, collection calls `network.advance`.

    Args:
        frozen: parts of `PARTS` that do not learn.
        autocast: the type in which the network is computed where autocast allows it; None: in its own.
        microbatch: frames whose images are encoded at a time.
        guide: draws the mean actions to the labels that observations hold; None: reward alone.
    """

    def __init__(
        self,
        observation_space: spaces.Space[Any],
        action_space: spaces.Space[Any],
        lr_schedule: Schedule,
        use_sde: bool = False,
        *,
        network: Network,
        frozen: tuple[str, ...] = (),
        autocast: Precision | None = None,
        microbatch: int | None = None,
        guide: Guide | None = None,
    ) -> None:
        super().__init__(observation_space, action_space, squash_output=False, normalize_images=False)
        self.network = network
        named = [getattr(network, module) for part in frozen for module in PARTS[part]]
        self.frozen = [module for module in named if module is not None]
        network.freeze(self.frozen)
        network.microbatch = microbatch
        self.autocast = autocast
        trained = [p for p in network.parameters() if p.requires_grad]
        self.optimizer = torch.optim.Adam(trained, lr=lr_schedule(1), eps=1e-5)
        self.guide = guide
        self.before_minibatch: Callable[[], None] | None = None

    def set_training_mode(self, mode: bool) -> None:
        """Frozen parts stay in evaluation mode."""
        super().set_training_mode(mode)
        for module in self.frozen:
            module.eval()

    def computing(self) -> AbstractContextManager[None]:
        """The context in which the network runs, in collection as in the update."""
        return computing(self.network.device, self.autocast)

    def evaluate_actions(self, obs: PyTorchObs, actions: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Values, log-probabilities and entropies (B L,) of segments, as PPO's loss needs them."""
        if self.before_minibatch is not None:
            self.before_minibatch()
        frames = dict(obs)
        starts, state, rows = frames.pop(STARTS), frames.pop(STATE, None), frames.pop(ROWS, None)
        with self.computing():
            decision = self.network.evaluate(frames, state, starts, rows)
        log_probs = decision.actions.log_prob(actions)
        if self.guide is not None:
            labels = frames[self.guide.key] if rows is None else frames[self.guide.key][rows.flatten()]
            own = labels.reshape(*starts.shape, -1)[:, self.network.prefix :].flatten(0, 1)
            log_probs = self.guide(own, decision.actions.mode(), log_probs)
        return decision.values, log_probs, decision.actions.entropy()

    def forward(self, obs: Any, deterministic: bool = False) -> Any:
        """Not how a policy with memory is called: use `network.step`."""
        raise TypeError("a driving policy has memory: call network.step with its state")

    def _predict(self, observation: PyTorchObs, deterministic: bool = False) -> Tensor:
        """As `forward`: without its memory there is nothing to predict from."""
        raise TypeError("a driving policy has memory: drive it with pipeline.control.Controller")

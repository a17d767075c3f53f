"""One round of imitation's driving: who drives which episode, and what the autopilot says to it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from numpy.typing import NDArray

from me3bev_cli.pipeline.network import embedding_key
from me3bev_cli.pipeline.policy import computing, settled_embeddings
from me3bev_cli.pipeline.sensor import SOURCES
from me3bev_cli.pipeline.transfer import to_device, to_tensors
from me3bev_cli.training.alarms import check_rewards
from me3bev_cli.training.demonstrations import LABEL, Arrays, Floats, Round, drifting_noise
from me3bev_cli.training.replay import ReplayedEnvs
from me3bev_cli.training.shaped_reward import PLAIN

if TYPE_CHECKING:
    from me3bev_cli.pipeline.network import Network
    from me3bev_cli.recipe_stages import ImitationStage

Stepped = Callable[[int, NDArray[np.bool_]], None]
"""Told of every step: the row, and which environments' episodes ended."""


@dataclass
class Outcome:
    """How a round went."""

    round: Round
    next_first: int
    """Index of the first episode that no environment has begun."""
    rewards: list[float] = field(default_factory=list)
    """The simulator's own, whatever the recipe adds to it."""
    student_episodes: list[dict[str, float]] = field(default_factory=list)
    """Collision and route completion of the episodes that the policy drove to their end."""


class RoundDriver:
    """Drives rounds: a share of the episodes by the autopilot, disturbed by noise, the others by the policy.

    Everything random in a round comes from one generator and is drawn before its first step, so a round that is
    driven again by the same policy is the same round.
    """

    def __init__(self, env: ReplayedEnvs, network: Network, stage: ImitationStage, device: torch.device) -> None:
        self.env, self.network, self.stage, self.device = env, network, stage, device

    def drive(
        self, one: Round, share: float, rng: np.random.Generator, stepped: Stepped, again: Floats | None = None
    ) -> Outcome:
        """Fill a round.

        Args:
            share: of the episodes that the autopilot drives.
            again: the actions (T, n, 2) with which the round was driven before: nobody drives, it is played.
        """
        noise = drifting_noise(rng, one.length, one.envs, (self.stage.steering_noise, self.stage.longitudinal_noise))
        draws = rng.random((one.length, one.envs))
        begun = np.ones(one.envs, np.int64)
        outcome = Outcome(one, 0)
        observation, labels = self._begin(one)
        starts, guided = np.ones(one.envs, np.bool_), np.ones(one.envs, np.bool_)
        self.network.eval()
        state = self.network.initial_state(one.envs)
        for row in range(one.length):
            guided = np.where(starts, draws[row] < share, guided)
            frames, kept = self._frames(observation)
            one.observe(row, kept, starts)
            if again is not None:
                actions = again[row]
            else:
                own, state = self._decide(frames, state, starts) if share < 1 else (labels, state)
                actions = np.where(guided[:, None], np.clip(labels + noise[row], -1, 1), own)
            one.labels[row], one.actions[row], one.guided[row] = labels, actions, guided
            seen, rewards, dones, infos = self.env.step(one.actions[row])
            check_rewards(rewards, self.env.episodes)
            outcome.rewards += [float(info.get(PLAIN, reward)) for info, reward in zip(infos, rewards, strict=True)]
            cut = np.array([bool(info.get("TimeLimit.truncated", False)) for info in infos])
            one.rewards[row], one.ended[row], one.cut[row] = rewards, dones & ~cut, dones & cut
            observation, labels = _parted(seen)
            outcome.student_episodes += [_episode(infos[i]) for i in np.flatnonzero(dones & ~guided)]
            begun += dones
            starts = dones
            stepped(row, dones)
        one.finish(self.stage.gamma, self.stage.reward_scale)
        outcome.next_first = one.first + one.envs * int(begun.max())
        return outcome

    def _begin(self, one: Round) -> tuple[Arrays, Floats]:
        """Begin an episode in every environment: observations and labels."""
        for i in range(one.envs):
            self.env.env_method("play_from", one.first + i, indices=[i])
        return _parted(self.env.reset())

    @torch.no_grad()
    def _frames(self, observation: Arrays) -> tuple[dict[str, torch.Tensor], Arrays]:
        """The frames as the network takes them, and as they are stored: encoded already where the encoder is fixed."""
        frames = to_tensors(observation, self.device)
        settled = settled_embeddings(self.network, self.stage.freeze)
        if not settled:
            return frames, observation
        with computing(self.device, self.stage.autocast):
            embeddings = self.network.encode(frames)
        replaced = {source for name in settled for source in SOURCES[name]}
        kept = {key: value for key, value in observation.items() if key not in replaced}
        for name in settled:
            frames[embedding_key(name)] = embeddings[name].float()
            kept[embedding_key(name)] = embeddings[name].float().cpu().numpy()
        return frames, kept

    @torch.no_grad()
    def _decide(self, frames: dict[str, torch.Tensor], state: Any, starts: NDArray[np.bool_]) -> tuple[Floats, Any]:
        """The policy's mean actions (n, 2), and its memory after them."""
        with computing(self.device, self.stage.autocast):
            decision, state = self.network.step(frames, state, to_device(starts, self.device))
        return decision.actions.mode().clamp(-1.0, 1.0).cpu().numpy(), state


def _parted(seen: Any) -> tuple[Arrays, Floats]:
    """What the policy sees, and what the autopilot would do."""
    observation = dict(seen)
    return observation, observation.pop(LABEL)


def _episode(info: dict[str, Any]) -> dict[str, float]:
    record = info["record"]
    return {
        "collision_rate": float(record["collision"] != ""),
        "route_completion": min(1.0, record["route_done"] / max(record["route_length"], 1e-6)),
        "episode_steps": float(info["episode"]["l"]),
    }

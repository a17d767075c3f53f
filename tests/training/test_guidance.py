"""The autopilot beside PPO: its gradient comes in once and whole, on the frames judged, and nothing else moves."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from stable_baselines3.common.logger import Logger

from me3bev_cli.pipeline.assemble import build_network
from me3bev_cli.pipeline.control import Controller
from me3bev_cli.pipeline.policy import ROWS, STARTS, STATE, DrivingPolicy
from me3bev_cli.recipe_loading import dump, resolve_recipe
from me3bev_cli.recipe_stages import Guidance
from me3bev_cli.stopping import Stop
from me3bev_cli.training.curve import read_metrics
from me3bev_cli.training.demonstrations import LABEL, Taught
from me3bev_cli.training.display import Display
from me3bev_cli.training.environments import make_environments
from me3bev_cli.training.guidance import AutopilotGuide
from me3bev_cli.training.rollout import SequenceRolloutBuffer
from me3bev_cli.training.run import make_run
from me3bev_cli.training.sequence_ppo import SequencePPO
from me3bev_cli.training.trainer import Trainer

WEIGHTS = Guidance(weight=3.0, steering_weight=7.0)


def collected(path: Path, overrides: list[str], guided: bool) -> SequencePPO:
    """Two rollouts; the optimiser stands still, so that the gradient of the last minibatch can be looked at."""
    recipe = resolve_recipe(path, overrides)
    network = build_network(recipe, 1)
    model = SequencePPO(
        DrivingPolicy,
        make_environments(recipe, recipe.stages[0], around=Taught),
        rollout_buffer_class=SequenceRolloutBuffer,
        rollout_buffer_kwargs={"segment": 8, "prefix": network.prefix, "seed": 0},
        policy_kwargs={
            "network": network,
            "frozen": recipe.stages[0].freeze,
            "guide": AutopilotGuide(WEIGHTS) if guided else None,
        },
        n_steps=16, batch_size=32, n_epochs=1, learning_rate=0.0, max_grad_norm=1e9, seed=5, device="cpu",
    )  # fmt: skip
    model.set_logger(Logger(None, []))
    model.learn(64)
    return model


def gradients(model: SequencePPO) -> dict[str, torch.Tensor]:
    return {name: p.grad.clone() for name, p in model.network.named_parameters() if p.grad is not None}


@pytest.mark.parametrize(
    "overrides",
    [[], ["context={kind: stream}"], ["stages.0.freeze=[spatial]"], ["temporal=null", "policy.distribution=beta"]],
)
def test_the_gradient_is_ppos_and_the_weighted_distances(line_recipe: Path, overrides: list[str]) -> None:
    """Against the formula, frame by frame, through a policy that reads the stored frames in order."""
    sizes = ["stages.0.envs=2", "stages.0.workers=1"]
    alone, guided = (collected(line_recipe, [*overrides, *sizes], guide) for guide in (False, True))
    buffer = guided.rollout_buffer
    assert np.array_equal(alone.rollout_buffer.actions, buffer.actions)
    network, ppo, both = guided.network, gradients(alone), gradients(guided)
    sample = next(iter(buffer.get(None)))
    frames = dict(sample.observations)
    labels = frames[LABEL] if ROWS not in frames else frames[LABEL][frames[ROWS].flatten()]
    judged = labels.reshape(*frames[STARTS].shape, 2)[:, network.prefix :]
    # It always drives straight on with full throttle.
    assert (judged == torch.tensor([0.0, 1.0])).all()
    network.zero_grad()
    starts, state, rows = frames.pop(STARTS), frames.pop(STATE, None), frames.pop(ROWS, None)
    modes = network.evaluate(frames, state, starts, rows).actions.mode()
    formula = sum(7.0 * s**2 + (t - 1.0) ** 2 for s, t in modes) / len(modes)
    (WEIGHTS.weight * formula).backward()  # type: ignore[union-attr]
    expected = {name: p.grad for name, p in network.named_parameters() if p.grad is not None}
    assert expected.keys() <= both.keys()
    for name, gradient in both.items():
        torch.testing.assert_close(gradient, ppo[name] + expected.get(name, 0.0), rtol=1e-3, atol=2e-5)


def test_it_learns_from_the_autopilot_what_the_reward_does_not_say(line_recipe: Path, tmp_path: Path) -> None:
    overrides = ["stages.0.guidance={weight: 5.0}", "stages.0.steps=512", "stages.0.learning_rate=0.003"]
    recipe = resolve_recipe(line_recipe, [*overrides, "reward={}", "stages.0.reward_scale=0.000001"])
    make_run(tmp_path / "run", dump(recipe))
    Trainer(recipe, tmp_path / "run", Display(512, 1), Stop()).train()
    losses = [row["guidance_loss"] for row in read_metrics(tmp_path / "run")]
    assert losses[-1] < 0.5 * losses[0]
    controller = Controller.load(tmp_path / "run")
    env = make_environments(recipe, recipe.stages[0], around=Taught)
    observation = {key: value[0] for key, value in env.reset().items()}
    assert observation[LABEL].tolist() == [0.0, 1.0]
    steering, longitudinal = controller.act(observation)
    assert longitudinal > 0.5
    assert abs(steering) < 0.3
    env.close()


def test_without_guidance_nothing_is_asked_of_the_autopilot(line_recipe: Path) -> None:
    recipe = resolve_recipe(line_recipe)
    env = make_environments(recipe, recipe.stages[0])
    assert LABEL not in env.reset()
    env.close()

"""Distributions over actions against torch's own, integrated numerically where they were changed."""

from __future__ import annotations

import pytest
import torch

from me3bev_cli.pipeline.heads import Actor, BetaActions, GaussianActions


def test_a_beta_density_integrates_to_one_over_minus_one_to_one() -> None:
    alpha, beta = torch.tensor([[2.0, 3.0]]).double(), torch.tensor([[4.0, 1.5]]).double()
    axis = (torch.arange(400).double() + 0.5) / 200 - 1
    grid = torch.cartesian_prod(axis, axis)
    density = BetaActions(alpha, beta).log_prob(grid).exp()
    assert float(density.sum() / 200**2) == pytest.approx(1.0, abs=1e-3)


def test_a_beta_entropy_is_the_mean_of_minus_log_density() -> None:
    torch.manual_seed(0)
    actions = BetaActions(torch.full((20000, 2), 2.5), torch.full((20000, 2), 1.7))
    samples = actions.sample()
    assert samples.abs().max() <= 1
    assert float(-actions.log_prob(samples).mean()) == pytest.approx(float(actions.entropy()[0]), abs=0.02)


def test_a_gaussian_by_hand() -> None:
    actions = GaussianActions(torch.zeros(1, 2), torch.zeros(2))
    # Two standard normals at their mean: 2 * log(1 / sqrt(2 pi)) = -1.8379.
    assert float(actions.log_prob(torch.zeros(1, 2))) == pytest.approx(-1.8379, abs=1e-4)


@pytest.mark.parametrize("distribution", ["gaussian", "beta"])
def test_an_untrained_actor_starts_in_the_middle(distribution: str) -> None:
    torch.manual_seed(0)
    actor = Actor(16, (8,), torch.nn.Tanh, distribution, -1.0)
    assert actor(torch.randn(64, 16)).mode().abs().max() < 0.1

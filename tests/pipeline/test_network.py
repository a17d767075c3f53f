"""The network: stepping equals segments, segments equal stacked observations, resets are exact."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

from me3bev_cli.pipeline.assemble import build_network
from me3bev_cli.pipeline.network import Network
from me3bev_cli.recipe_loading import resolve_recipe

B, L, T = 3, 8, 4


def network(path: Path, *overrides: str) -> Network:
    return build_network(resolve_recipe(path, overrides), 1).double()


def frames(count: int, generator: torch.Generator) -> dict[str, torch.Tensor]:
    return {
        "images": torch.randint(0, 256, (count, 2, 3, 16, 32), generator=generator, dtype=torch.uint8),
        "road": torch.randn(count, 9, generator=generator, dtype=torch.float64),
        "vehicle": torch.randn(count, 4, generator=generator, dtype=torch.float64),
        "navigation": torch.randn(count, 5, generator=generator, dtype=torch.float64),
    }


def episode_starts() -> torch.Tensor:
    starts = torch.zeros(B, L, dtype=torch.bool)
    starts[:, 0] = True
    starts[0, 3] = starts[1, 5] = starts[1, 6] = True
    return starts


@pytest.mark.parametrize("temporal", ["gru", "lstm", "mamba", "transformer"])
@pytest.mark.parametrize("context", ["{kind: window, length: 4}", "{kind: stream}"])
def test_stepping_equals_the_segment(line_recipe: Path, temporal: str, context: str) -> None:
    net = network(line_recipe, f"temporal={{name: {temporal}}}", f"context={context}")
    data, starts = frames(B * L, torch.Generator().manual_seed(0)), episode_starts()
    state, stepped = net.initial_state(B), []
    shaped = {key: value.reshape(B, L, *value.shape[1:]) for key, value in data.items()}
    for t in range(L):
        decision, state = net.step({key: value[:, t] for key, value in shaped.items()}, state, starts[:, t])
        stepped.append(decision.values)
    prefix = net.prefix
    padded = with_prefix(shaped, prefix)
    flags = torch.cat([torch.zeros(B, prefix, dtype=torch.bool), starts], 1)
    whole = net.evaluate({key: value.flatten(0, 1) for key, value in padded.items()}, net.initial_state(B), flags)
    torch.testing.assert_close(whole.values.reshape(B, L), torch.stack(stepped, 1), rtol=1e-5, atol=1e-6)


def with_prefix(shaped: dict[str, torch.Tensor], count: int) -> dict[str, torch.Tensor]:
    """Frames of before, whose content must not matter."""
    return {
        key: torch.cat([value[:, :1].expand(-1, count, *value.shape[2:]), value], 1) for key, value in shaped.items()
    }


def stacked_values(net: Network, shaped: dict[str, torch.Tensor], starts: torch.Tensor) -> torch.Tensor:
    """Naive: for every frame, encode its whole window afresh and run it alone from its last episode start."""
    values = []
    for b in range(B):
        for t in range(L):
            first = max([0, t - T + 1] + [s for s in range(t + 1) if starts[b, s]])
            window = {key: value[b, first : t + 1] for key, value in shaped.items()}
            embeddings = {name: e[None] for name, e in net.encode(window).items()}
            latents = {}
            for name, module in net.memory.temporal.items():
                k = embeddings[name].shape[2]
                x = embeddings[name][0].transpose(0, 1)
                y, _ = module(x, module.initial_state(k), torch.zeros(k, x.shape[1], dtype=torch.bool))
                latents[name] = y[:, -1][None]
            values.append(net.decide(latents).values[0])
    return torch.stack(values)


@pytest.mark.parametrize("temporal", ["gru", "mamba"])
def test_segments_give_the_gradients_of_stacked_observations(line_recipe: Path, temporal: str) -> None:
    net = network(line_recipe, f"temporal={{name: {temporal}}}")
    data, starts = frames(B * L, torch.Generator().manual_seed(2)), episode_starts()
    shaped = {key: value.reshape(B, L, *value.shape[1:]) for key, value in data.items()}
    weight = torch.randn(B * L, dtype=torch.float64)

    def gradients(values: torch.Tensor) -> list[torch.Tensor]:
        found = torch.autograd.grad((values * weight).sum(), list(net.parameters()), allow_unused=True)
        return [torch.zeros(1) if g is None else g for g in found]

    naive = gradients(stacked_values(net, shaped, starts))
    prefix = net.prefix
    padded = with_prefix(shaped, prefix)

    def segment(flags: torch.Tensor) -> list[torch.Tensor]:
        flags = torch.cat([torch.zeros(B, prefix, dtype=torch.bool), flags], 1)
        return gradients(net.evaluate({k: v.flatten(0, 1) for k, v in padded.items()}, {}, flags).values)

    for mine, theirs in zip(segment(starts), naive, strict=True):
        torch.testing.assert_close(mine, theirs.to(mine.dtype), rtol=1e-5, atol=1e-6)
    wrong = starts.clone()
    wrong[0, 3] = False
    assert any(
        mine.shape == theirs.shape and not torch.allclose(mine, theirs.to(mine.dtype), rtol=1e-5, atol=1e-6)
        for mine, theirs in zip(segment(wrong), naive, strict=True)
    )


@pytest.mark.parametrize("overrides", [["temporal=null"], ["fusion={name: concat}"], ["modalities=[vr, nav]"]])
def test_every_combination_decides(line_recipe: Path, overrides: list[str]) -> None:
    net = network(line_recipe, *overrides)
    data = frames(B, torch.Generator().manual_seed(0))
    decision, _ = net.step(data, net.initial_state(B), torch.ones(B, dtype=torch.bool))
    assert decision.values.shape == (B,)
    assert decision.actions.mode().shape == (B, 2)


def test_the_seed_decides_the_weights(line_recipe: Path) -> None:
    recipe = resolve_recipe(line_recipe)
    one, same, other = (build_network(recipe, seed).state_dict() for seed in (1, 1, 2))
    assert all(torch.equal(one[key], same[key]) for key in one)
    assert any(not torch.equal(one[key], other[key]) for key in one)

"""One `me3bev decode`: gather frames, train the decoder, score it, draw it."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from safetensors.torch import save_file

from me3bev_cli.decoding.decoder import SemanticDecoder
from me3bev_cli.decoding.frames import Pairs, gather, live_episodes, logged_episodes
from me3bev_cli.decoding.panel import panel, write_png
from me3bev_cli.decoding.scores import most_frequent, score_rows
from me3bev_cli.decoding.training import decode_all, train_decoder
from me3bev_cli.errors import UserError
from me3bev_cli.files import atomic_write_text
from me3bev_cli.pipeline.control import Controller
from me3bev_cli.recording.reader import episode_files

EVERY = 4
"""Every fourth frame is kept: neighbours are nearly the same picture."""


@dataclass(frozen=True)
class Plan:
    """What to decode and how long to train."""

    maps: list[str]
    density: str
    episodes: int
    steps: int
    batch: int
    seed: int
    logs: Path | None = None
    pretrained: str | None = None
    weather: tuple[str, ...] | None = None
    """Of the live episodes. None: the recipe's training set to learn from, its evaluation set to score on."""


def decode(controller: Controller, plan: Plan, out: Path, say: Callable[[str], None]) -> dict[str, Any]:
    """Train and score a decoder for the controller's policy; writes weights, scores and a picture to `out`.

    A fifth of the episodes is held out: scores and pictures come from it.

    Raises:
        UserError: the policy has no spatial encoder, or there are fewer than two episodes.
    """
    network = controller.network
    if network.tokens is None:
        raise UserError(f"the policy '{controller.recipe.name}' has no spatial encoder, so it has no latent to decode")
    pairs, held_out = _frames(controller, plan, say)
    torch.manual_seed(plan.seed)
    decoder = SemanticDecoder(network.tokens, plan.pretrained).to(network.device)

    def shown(step: int, loss: float) -> None:
        if step % 50 == 0 or step == plan.steps:
            say(f"decoder: {step}/{plan.steps} steps, loss {loss:.3f}")

    train_decoder(decoder, pairs, steps=plan.steps, batch=plan.batch, seed=plan.seed, shown=shown)
    decoded = decode_all(decoder, held_out.latents)
    rows = score_rows(held_out.truth, decoded, "u_bev")
    trivial = np.broadcast_to(most_frequent(pairs.truth), held_out.truth.shape)
    rows += score_rows(held_out.truth, np.ascontiguousarray(trivial), "most_frequent")
    out.mkdir(parents=True, exist_ok=True)
    save_file(decoder.state_dict(), out / "decoder.safetensors")
    result = {"recipe": controller.recipe.name, "frames": len(held_out.truth), "rows": rows}
    atomic_write_text(out / "scores.json", json.dumps(result, indent=1))
    middle = len(held_out.truth) // 2
    write_png(out / "panel.png", panel(held_out.images[middle], [held_out.truth[middle], decoded[middle]]))
    return result


def _frames(controller: Controller, plan: Plan, say: Callable[[str], None]) -> tuple[Pairs, Pairs]:
    """Frames to learn from and frames to score, of different episodes."""
    files = episode_files(plan.logs) if plan.logs is not None else []
    count = len(files) or plan.episodes
    if count < 2:
        raise UserError("decoding needs at least two episodes: one to learn from, one to score on")
    test = max(1, count // 5)

    def run(which: str, wanted: list[int]) -> Pairs:
        if files:
            episodes = logged_episodes(controller.recipe, (files[index] for index in wanted))
        else:
            recipe, seed = controller.recipe, plan.seed + (which == "scoring")
            usual = recipe.weather.evaluation if which == "scoring" else recipe.weather.training
            episodes = live_episodes(recipe, plan.maps, plan.density, plan.weather or usual, len(wanted), seed)
        return gather(controller.network, episodes, EVERY, lambda done: say(f"{which}: {done}/{len(wanted)} episodes"))

    return run("learning", list(range(test, count))), run("scoring", list(range(test)))

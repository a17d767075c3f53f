"""Trains the decoder on the frozen policy's latents."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from me3bev_cli.api import BEV_CLASSES
from me3bev_cli.decoding.decoder import SemanticDecoder
from me3bev_cli.decoding.frames import Pairs


def class_weights(truth: NDArray[np.uint8]) -> Tensor:
    """Weights (8,) that lift rare classes: inverse square root of frequency, of mean 1 over the classes present."""
    share = np.bincount(truth.ravel(), minlength=len(BEV_CLASSES)) / truth.size
    weights = np.where(share > 0, 1 / np.sqrt(np.maximum(share, 1e-4)), 0.0)
    return torch.tensor(weights / weights[share > 0].mean(), dtype=torch.float32)


def train_decoder(
    decoder: SemanticDecoder,
    pairs: Pairs,
    *,
    steps: int,
    batch: int,
    seed: int,
    shown: Callable[[int, float], None] | None = None,
) -> None:
    """Minimise class-balanced cross entropy with Adam for `steps` minibatches."""
    device = next(decoder.parameters()).device
    weights = class_weights(pairs.truth).to(device)
    optimizer = torch.optim.Adam(decoder.parameters(), lr=1e-3)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, 2e-3, total_steps=max(steps, 2))
    generator = np.random.default_rng(seed)
    decoder.train()
    for step in range(steps):
        chosen = generator.integers(0, len(pairs.latents), batch)
        latent = torch.from_numpy(pairs.latents[chosen]).to(device)
        truth = torch.from_numpy(pairs.truth[chosen]).to(device).long()
        loss = torch.nn.functional.cross_entropy(decoder(latent), truth, weight=weights)
        optimizer.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        optimizer.step()
        schedule.step()
        if shown is not None:
            shown(step + 1, float(loss.detach()))


@torch.inference_mode()
def decode_all(decoder: SemanticDecoder, latents: NDArray[np.float32], batch: int = 16) -> NDArray[np.uint8]:
    """Decoded classes (N, 200, 200) of latents (N, K, D)."""
    device = next(decoder.parameters()).device
    decoder.eval()
    parts = [
        decoder(torch.from_numpy(latents[low : low + batch]).to(device)).argmax(1).to(torch.uint8).cpu().numpy()
        for low in range(0, len(latents), batch)
    ]
    return np.concatenate(parts)

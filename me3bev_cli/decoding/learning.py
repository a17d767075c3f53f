"""Trains decoders on a frozen policy's latents, in rounds; goes on exactly where it was left.

A round draws some episodes, until all of them are in the pool, makes its gradient steps and scores the held-out
episodes. What the pool holds and which frames each step takes are functions of the round's number, so that a training
that goes on draws the same frames again.
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from me3bev_cli.api import BEV_CLASSES
from me3bev_cli.decoding.counting import Counts
from me3bev_cli.decoding.decoder import SemanticDecoder
from me3bev_cli.decoding.latents import Reader
from me3bev_cli.decoding.moments import Episodes, Take
from me3bev_cli.decoding.plan import Plan
from me3bev_cli.decoding.pool import Batch, Kept, Pool, kept
from me3bev_cli.decoding.scores import NEAR
from me3bev_cli.decoding.store import keep_training
from me3bev_cli.perception.losses import balanced_weights, cell_weights, likeliest, segmentation_losses
from me3bev_cli.perception.truth import SEEN, classes_of, seen_in
from me3bev_cli.seeding import derive_seed
from me3bev_cli.stopping import Stop
from me3bev_cli.training.pace import clock

ROUND = 4
"""Episodes of a round."""
HIDDEN, BALANCE = 0.3, 0.4
"""Weight of far cells out of sight; power of the classes' frequency, as for perception."""
BETTER = 1e-3
"""By how much a score must rise to be a better one."""
WARMUP = 20
SHOW = 5.0
"""Seconds between two lines of progress."""


class StoppedError(Exception):
    """Training was asked to stop, and is kept."""


@dataclass
class Scenes:
    """The episodes that are learned from and those that are held out."""

    player: Episodes
    learned: list[Take]
    held_out: list[Take]


class Training:
    """Decoders, their optimisers and where in the training they are.

    Args:
        folder: where checkpoints are written, after each round.
        identity: of plan and policy, kept in them.
        say: shows a line of progress.
    """

    def __init__(
        self,
        plan: Plan,
        scenes: Scenes,
        reader: Reader,
        decoders: dict[str, SemanticDecoder],
        folder: Path,
        identity: dict[str, Any],
        say: Callable[[str], None],
    ) -> None:
        self.plan, self.scenes, self.reader, self.decoders = plan, scenes, reader, decoders
        self.folder, self.identity, self.say = folder, identity, say
        self.device: torch.device = reader.networks[0].device
        self.autocast: torch.dtype | None = None if plan.autocast is None else getattr(torch, plan.autocast)
        for decoder in decoders.values():
            # Twice as fast in short types, slower in long ones.
            decoder.to(memory_format=torch.channels_last if self.autocast else torch.contiguous_format)
        self.optimizers = {n: torch.optim.AdamW(d.parameters(), weight_decay=1e-4) for n, d in decoders.items()}
        self.pool = Pool(plan.memory * 1_000_000)
        self.round, self.update, self.step = 0, 0, 0
        self.best: dict[str, dict[str, Any]] = {}
        self.frequency = torch.zeros(len(BEV_CLASSES), 200, 200, dtype=torch.int32)
        self.class_weights: Tensor | None = None
        self.stop = Stop()
        self._rate: tuple[float, int] = (0.0, 0)
        self._shown = 0.0
        self._ready = False
        """Whether the pool holds what it should: before that, nothing may be kept."""

    @property
    def passes(self) -> int:
        """Rounds until every episode has been drawn."""
        return -(-len(self.scenes.learned) // ROUND)

    def run(self, state: dict[str, Any] | None) -> str:
        """Train to the end, from a state that was kept; why it ended.

        Raises:
            StoppedError: Ctrl-C; what was done is kept.
        """
        numbers = [] if state is None else self._restore(state)
        with self.stop.listening():
            held_out = self._gather(self.scenes.held_out, "held-out", self.plan.memory * 250_000)
            for number in numbers:
                self.pool.add(number, self._drawn(number))
            self._ready = True
            while self.step < self.plan.steps:
                self._round(held_out, drawn=self.round in numbers)
                if self._stale():
                    return f"no better score in {self.plan.patience} rounds"
        return f"{self.step} steps"

    def _drawn(self, number: int) -> list[Kept]:
        first = number % self.passes * ROUND
        return self._gather(self.scenes.learned[first : first + ROUND], f"round {number + 1}")

    def _gather(self, takes: Sequence[Take], what: str, size: int | None = None) -> list[Kept]:
        frames: list[Kept] = []
        for number, take in enumerate(takes):
            for _, moment, latents in self.reader.read(self.scenes.player.play(take), self.plan.every):
                self._check_stop()
                if size is None or not frames or len(frames) * frames[0].bytes < size:
                    frames.append(kept(moment, latents))
                self._show(f"{what}: episode {number + 1}/{len(takes)}, {len(frames)} frames")
        return frames

    def _round(self, held_out: list[Kept], drawn: bool) -> None:
        whole = self.pool.numbers == list(range(self.passes))
        if not whole and not drawn:
            frames = self._drawn(self.round)
            self.pool.add(self.round, frames)
            if self.round < self.passes:
                self._count(frames)
            if self.class_weights is None:
                counts = self.frequency.sum((1, 2)) + _frequency(held_out).sum((1, 2))
                self.class_weights = balanced_weights(counts, BALANCE).to(self.device)
                for decoder in self.decoders.values():
                    decoder.class_weights.copy_(self.class_weights)
        rng = np.random.default_rng(derive_seed(self.plan.seed, "decode", "minibatches", self.round))
        chosen = rng.integers(0, len(self.pool), (self.plan.check, self.plan.batch))
        self._rate = (time.monotonic(), self.step)
        for decoder in self.decoders.values():
            decoder.train()
        while self.update < self.plan.check and self.step < self.plan.steps:
            self._check_stop()
            losses = self._learn(chosen[self.update])
            self.update, self.step = self.update + 1, self.step + 1
            self._show(f"{self._standing()}, loss {losses:.3f}")
        self._score(held_out)
        self.round, self.update = self.round + 1, 0
        self.keep()

    def _learn(self, chosen: NDArray[np.int64]) -> float:
        """One gradient step of every decoder; the mean of their losses."""
        batch, total = self.pool.batch(chosen, self.device), 0.0
        assert self.class_weights is not None
        cells = cell_weights(batch.seen, HIDDEN, NEAR)
        half = 0.5 * (1 + math.cos(math.pi * self.step / self.plan.steps))
        rate = self.plan.learning_rate * min(1.0, (self.step + 1) / WARMUP) * (0.02 + 0.98 * half)
        for name, decoder in self.decoders.items():
            optimizer = self.optimizers[name]
            for group in optimizer.param_groups:
                group["lr"] = rate
            with nullcontext() if self.autocast is None else torch.autocast(self.device.type, self.autocast):
                scores = decoder(batch.latents[name])
            entropy, dice = segmentation_losses(scores.float(), batch.truth, self.class_weights, cells)
            optimizer.zero_grad()
            (entropy + dice).backward()  # type: ignore[no-untyped-call]
            torch.nn.utils.clip_grad_norm_(decoder.parameters(), 5.0)
            optimizer.step()
            total += float((entropy + dice).detach())
        return total / len(self.decoders)

    def _score(self, held_out: list[Kept]) -> None:
        """Mean IoU of the held-out frames; the best weights are kept."""
        told = []
        for name, counts in score_frames(self.decoders, held_out, self.device).items():
            score = counts.mean()
            if name not in self.best or score > self.best[name]["score"] + BETTER:
                weights = {key: value.detach().cpu().clone() for key, value in self.decoders[name].state_dict().items()}
                self.best[name] = {"score": score, "round": self.round, "weights": weights}
            told.append(f"{name} {score:.3f} (best {self.best[name]['score']:.3f})")
        self.say(f"{self._standing()}, held-out mean IoU: {', '.join(told)}")

    def _stale(self) -> bool:
        best = max((own["round"] for own in self.best.values()), default=0)
        return self.round - 1 - best >= self.plan.patience

    def _count(self, frames: list[Kept]) -> None:
        self.frequency += _frequency(frames)

    def _standing(self) -> str:
        seconds, steps = time.monotonic() - self._rate[0], self.step - self._rate[1]
        text = f"decoder: step {self.step}/{self.plan.steps}"
        if seconds > 0 and steps:
            text += f", {steps / seconds:.1f} steps/s, left {clock((self.plan.steps - self.step) * seconds / steps)}"
        return text

    def _show(self, text: str) -> None:
        if time.monotonic() - self._shown >= SHOW:
            self._shown = time.monotonic()
            self.say(text)

    def _check_stop(self) -> None:
        if self.stop.asked:
            if self._ready and self.class_weights is not None:
                self.keep()
            raise StoppedError

    def keep(self) -> None:
        """Write where the training is."""
        keep_training(
            self.folder,
            {
                "identity": json.dumps(self.identity),
                "place": [self.round, self.update, self.step],
                "pool": self.pool.numbers,
                "decoders": {name: decoder.state_dict() for name, decoder in self.decoders.items()},
                "optimizers": {name: optimizer.state_dict() for name, optimizer in self.optimizers.items()},
                "best": self.best,
                "frequency": self.frequency,
                "class_weights": self.class_weights,
            },
        )

    def _restore(self, state: dict[str, Any]) -> list[int]:
        """Take up a state; the rounds that the pool held."""
        self.round, self.update, self.step = state["place"]
        for name, decoder in self.decoders.items():
            decoder.load_state_dict(state["decoders"][name])
            self.optimizers[name].load_state_dict(state["optimizers"][name])
        self.best, self.frequency = state["best"], state["frequency"]
        self.class_weights = state["class_weights"].to(self.device)
        numbers: list[int] = state["pool"]
        return numbers


def _frequency(frames: Sequence[Kept]) -> Tensor:
    """(8, 200, 200), how often each cell has each class."""
    counts = torch.zeros(len(BEV_CLASSES), 200, 200, dtype=torch.int32)
    for frame in frames:
        classes = torch.from_numpy(frame.maps & np.uint8(SEEN - 1)).long()
        counts.scatter_add_(0, classes[None], torch.ones(1, 200, 200, dtype=torch.int32))
    return counts


@torch.inference_mode()
def decoded_maps(decoder: SemanticDecoder, latents: Tensor) -> NDArray[np.uint8]:
    """The likeliest class of each cell (N, 200, 200)."""
    found = likeliest(decoder(latents).float(), decoder.class_weights)
    array: NDArray[np.uint8] = found.to(torch.uint8).cpu().numpy()
    return array


def score_frames(
    decoders: dict[str, SemanticDecoder], frames: Sequence[Kept], device: torch.device, together: int = 8
) -> dict[str, Counts]:
    """Each decoder's maps of kept frames against the truth."""
    counts = {name: Counts() for name in decoders}
    for decoder in decoders.values():
        decoder.eval()
    for low in range(0, len(frames), together):
        part = list(frames[low : low + together])
        batch = Batch.of(part, device)
        for name, decoder in decoders.items():
            for frame, found in zip(part, decoded_maps(decoder, batch.latents[name]), strict=True):
                counts[name].add(classes_of(frame.maps), found, seen_in(frame.maps) if frame.told else None)
    return counts

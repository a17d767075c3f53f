"""The latents of the last rounds of episodes, in bounded memory."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from me3bev_cli.decoding.latents import Read
from me3bev_cli.decoding.moments import Moment
from me3bev_cli.perception.truth import SEEN, packed


@dataclass(eq=False)
class Kept:
    """One frame: its latents, and class and sight of each cell in one byte; `told` says whether sight is known."""

    latents: Read
    maps: NDArray[np.uint8]
    told: bool

    @property
    def bytes(self) -> int:
        """Memory that it takes."""
        return self.maps.nbytes + sum(array.nbytes for array in self.latents.values())


def kept(moment: Moment, latents: Read) -> Kept:
    """A frame as the pool has it: without its images."""
    own = Read({name: np.array(array) for name, array in latents.items()})
    if moment.seen is None:
        return Kept(own, np.array(moment.bev), False)
    return Kept(own, packed(moment.bev, moment.seen), True)


class Pool:
    """Rounds of frames: the newest that fit, the newest one in any case.

    Args:
        size: bytes.
    """

    def __init__(self, size: int) -> None:
        self.size = size
        self.rounds: deque[tuple[int, list[Kept]]] = deque()
        self._frames: list[Kept] = []

    def add(self, number: int, frames: Iterable[Kept]) -> None:
        """Take in a round; older ones go where it gets too much."""
        self.rounds.append((number, list(frames)))
        while len(self.rounds) > 1 and sum(frame.bytes for _, part in self.rounds for frame in part) > self.size:
            self.rounds.popleft()
        self._frames = [frame for _, part in self.rounds for frame in part]

    @property
    def numbers(self) -> list[int]:
        """Of the rounds that are there."""
        return [number for number, _ in self.rounds]

    def __len__(self) -> int:
        return len(self._frames)

    def batch(self, chosen: NDArray[np.int64], device: torch.device) -> Batch:
        """Frames by number."""
        return Batch.of([self._frames[number] for number in chosen], device)


@dataclass
class Batch:
    """B frames on a device."""

    latents: dict[str, Tensor]
    """(B, channels, rows, columns) float32 by probe."""
    truth: Tensor
    """(B, 200, 200) int64"""
    seen: Tensor
    """(B, 200, 200) bool; all cells of a frame of which it is not known."""

    @classmethod
    def of(cls, frames: list[Kept], device: torch.device) -> Batch:
        """A batch of kept frames."""
        maps = torch.from_numpy(np.stack([frame.maps for frame in frames])).to(device)
        told = torch.tensor([frame.told for frame in frames], device=device)
        return cls(
            latents={
                name: torch.from_numpy(np.stack([frame.latents[name] for frame in frames])).to(device).float()
                for name in frames[0].latents
            },
            truth=(maps & (SEEN - 1)).long(),
            seen=(maps >= SEEN) | ~told[:, None, None],
        )

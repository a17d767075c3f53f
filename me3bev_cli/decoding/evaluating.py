"""Scores decoders on episodes as they are played: nothing but counts and the few frames to be drawn stays in memory."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from me3bev_cli.api import BEV_CLASSES
from me3bev_cli.decoding.counting import Counts
from me3bev_cli.decoding.decoder import SemanticDecoder
from me3bev_cli.decoding.latents import Reader
from me3bev_cli.decoding.learning import decoded_maps
from me3bev_cli.decoding.moments import Episodes, Moment, Take
from me3bev_cli.decoding.plan import GRID, MOST_FREQUENT
from me3bev_cli.perception.model import PerceptionModel
from me3bev_cli.pipeline.transfer import to_device
from me3bev_cli.seeding import derive_seed

HEAD = "perception_head"
"""The perception stage's own head on the grid, as results name it."""
TOGETHER = 8
APART = 32
"""Steps of an episode of which the worst frame is drawn."""


class Shot(NamedTuple):
    """One scored frame, to be drawn."""

    take: Take
    step: int
    number: int
    """Among all scored frames."""
    score: float
    """Mean IoU of the first decoded map, over its classes."""
    moment: Moment
    maps: dict[str, NDArray[np.uint8]]


@dataclass(frozen=True)
class Wanted:
    """Which frames are kept for pictures."""

    kind: Literal["worst", "random", "chosen"] = "worst"
    count: int = 4
    numbers: tuple[int, ...] = ()
    seed: int = 0

    def weight(self, shot: Shot) -> float | None:
        """The frames with the greatest weights are kept; None: not this one."""
        if self.kind == "chosen":
            return -float(shot.number) if shot.number in self.numbers else None
        if self.kind == "random":
            return float(derive_seed(self.seed, "shot", shot.number))
        return -shot.score


@dataclass
class Album:
    """The frames that are wanted for pictures."""

    wanted: Wanted
    _kept: dict[tuple[str, int], tuple[float, Shot]] = field(default_factory=dict)

    def see(self, shot: Shot) -> None:
        """Keep it if it is wanted more than another."""
        weight = self.wanted.weight(shot)
        if weight is None:
            return
        # Of neighbours, which look alike, one is enough, unless each was chosen.
        place = shot.take.name, shot.step if self.wanted.kind == "chosen" else shot.step // APART
        if place in self._kept and self._kept[place][0] >= weight:
            return
        self._kept[place] = weight, shot
        if len(self._kept) > max(self.wanted.count, len(self.wanted.numbers)):
            self._kept.pop(min(self._kept, key=lambda key: self._kept[key][0]))

    @property
    def shots(self) -> list[Shot]:
        """The worst first; random and chosen ones by number."""
        found = [shot for _, shot in self._kept.values()]
        return sorted(found, key=lambda shot: (shot.score if self.wanted.kind == "worst" else 0.0, shot.number))


@dataclass
class Scored:
    """Counts of every episode by probe."""

    takes: list[Take]
    counts: list[dict[str, Counts]]

    def of(self, probe: str, chosen: Callable[[Take], bool] = lambda take: True) -> Counts:
        """All counts of a probe in the chosen episodes."""
        found = [c[probe] for take, c in zip(self.takes, self.counts, strict=True) if chosen(take)]
        return sum(found, start=Counts())


@dataclass
class Scorer:
    """All that is asked of a frame.

    Args:
        decoders: by probe.
        head: the perception stage's model, if the run has one and it is asked.
        most_frequent: (200, 200), the trivial baseline; None: it is not asked.
    """

    reader: Reader
    decoders: dict[str, SemanticDecoder]
    head: PerceptionModel | None
    most_frequent: NDArray[np.uint8] | None
    device: torch.device
    every: int

    def maps(self, moments: Sequence[Moment], latents: Sequence[Any]) -> dict[str, NDArray[np.uint8]]:
        """What each makes of N frames, (N, 200, 200)."""
        found = {}
        for name, decoder in self.decoders.items():
            stacked = torch.from_numpy(np.stack([read[name] for read in latents])).to(self.device).float()
            found[name] = decoded_maps(decoder.eval(), stacked)
        if self.head is not None:
            images = to_device(np.stack([moment.images for moment in moments]), self.device)
            found[HEAD] = self.head.eval().classes(images)
        if self.most_frequent is not None:
            found[MOST_FREQUENT] = np.broadcast_to(self.most_frequent, (len(moments), *self.most_frequent.shape))
        return found

    def frames(self, player: Episodes, take: Take) -> Iterable[tuple[int, Moment, dict[str, NDArray[np.uint8]]]]:
        """(step, moment, maps by probe) of an episode's kept frames."""
        waiting: list[tuple[int, Moment, Any]] = []

        def flush() -> Iterable[tuple[int, Moment, dict[str, NDArray[np.uint8]]]]:
            maps = self.maps([moment for _, moment, _ in waiting], [read for _, _, read in waiting])
            for place, (step, moment, _) in enumerate(waiting):
                yield step, moment, {name: found[place] for name, found in maps.items()}
            waiting.clear()

        for entry in self.reader.read(player.play(take), self.every):
            waiting.append(entry)
            if len(waiting) == TOGETHER:
                yield from flush()
        if waiting:
            yield from flush()

    def score(
        self,
        player: Episodes,
        takes: Sequence[Take],
        album: Album | None,
        shown: Callable[[int], None] = lambda done: None,
    ) -> Scored:
        """Score episodes one after another."""
        counts, number = [], 0
        for done, take in enumerate(takes):
            own: dict[str, Counts] = {}
            for step, moment, maps in self.frames(player, take):
                for name, found in maps.items():
                    own.setdefault(name, Counts()).add(moment.bev, found, moment.seen)
                if album is not None:
                    album.see(_shot(take, step, number, moment, maps))
                number += 1
            counts.append(own)
            shown(done + 1)
        return Scored(list(takes), counts)


def _shot(take: Take, step: int, number: int, moment: Moment, maps: dict[str, NDArray[np.uint8]]) -> Shot:
    one = Counts()
    one.add(moment.bev, next(iter(maps.values())), None)
    # Copied: the others of its batch shall not stay in memory with it.
    own = {name: np.array(found) for name, found in maps.items()}
    return Shot(take, step, number, one.mean(), moment, own)


def rows_of(scored: Scored, probe: str, **labels: Any) -> list[dict[str, Any]]:
    """A row per mask, class and map; and `mean`, over the maps where the class is there."""
    maps = list(dict.fromkeys(take.map for take in scored.takes))
    parts = {place: scored.of(probe, lambda take, place=place: take.map == place) for place in maps}  # type: ignore[misc]
    return _rows({"map": parts}, labels)


def weather_rows(scored: Scored, probe: str, **labels: Any) -> list[dict[str, Any]]:
    """A row per mask, class and kind of weather, over all maps."""
    kinds = list(dict.fromkeys(take.weather for take in scored.takes))
    parts = {kind: scored.of(probe, lambda take, kind=kind: take.weather == kind) for kind in kinds}  # type: ignore[misc]
    return _rows({"weather": parts}, labels, mean=False)


def _rows(parts: dict[str, dict[str, Counts]], labels: dict[str, Any], mean: bool = True) -> list[dict[str, Any]]:
    (axis, counts), rows = next(iter(parts.items())), []
    masks = next(iter(counts.values())).masks() if counts else []
    for mask in masks:
        found = {place: own.iou(mask) for place, own in counts.items() if mask in own.masks()}
        values: dict[str, NDArray[np.float64]] = dict(found)
        if mean:
            values["mean"] = np.array([_mean([own[k] for own in found.values()]) for k in range(len(BEV_CLASSES))])
        for place, ious in values.items():
            for name, value in zip((*BEV_CLASSES, "mean"), (*ious, _mean(ious)), strict=True):
                rows.append(labels | {"mask": mask, axis: place, "class": name, "iou": float(value)})
    return rows


def _mean(values: Iterable[float]) -> float:
    there = [float(value) for value in values if not math.isnan(value)]
    return sum(there) / len(there) if there else math.nan


def sources_of(decoders: dict[str, SemanticDecoder], head: PerceptionModel | None) -> dict[str, str]:
    """Probe -> source in the results' rows: what a baseline is has its own name."""
    found = {name: name for name in decoders}
    if head is not None:
        found[HEAD] = GRID if GRID not in decoders else HEAD
    return found | {MOST_FREQUENT: MOST_FREQUENT}

"""Which memory keeps what: two runs' u_BEV scored on cells that are hidden now and were visible a moment ago."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from me3bev_cli.api import BEV_CLASSES
from me3bev_cli.decoding.decoder import SemanticDecoder
from me3bev_cli.decoding.evaluating import Scorer
from me3bev_cli.decoding.latents import Reader
from me3bev_cli.decoding.moments import Episodes, Look, Moment, Take
from me3bev_cli.decoding.scores import confusion
from me3bev_cli.errors import LogError
from me3bev_cli.seeding import derive_seed

SECONDS = 2.0
"""How long ago a cell may have been visible, at most."""
PROBED = ("remembered", "never_seen", "seen")
"""Cells hidden now that were visible within `SECONDS`; hidden ones that were not; visible ones."""
MOVING = ("vehicle", "pedestrian")
RESAMPLES, LEVEL = 2000, 0.95
CELLS, CELL = 200, 0.5

Bools = NDArray[np.bool_]


class Glance(NamedTuple):
    """What was visible at one moment."""

    time: float
    pose: tuple[float, float, float]
    seen: Bools


def remembered(now: Glance, past: Iterable[Glance]) -> Bools:
    """Cells (200, 200) that are hidden now and were visible in the past, as the places that they are in the world.

    Args:
        past: glances within `SECONDS` before.
    """
    rows, columns = np.nonzero(~now.seen)
    ahead = (CELLS / 2 - rows - 0.5) * CELL
    left = (CELLS / 2 - columns - 0.5) * CELL
    x, y, heading = now.pose
    c, s = math.cos(heading), math.sin(heading)
    world_x, world_y = x + c * ahead - s * left, y + s * ahead + c * left
    found = np.zeros(len(rows), bool)
    for glance in past:
        c, s = math.cos(glance.pose[2]), math.sin(glance.pose[2])
        dx, dy = world_x - glance.pose[0], world_y - glance.pose[1]
        row = np.floor(CELLS / 2 - (c * dx + s * dy) / CELL).astype(np.int64)
        column = np.floor(CELLS / 2 - (c * dy - s * dx) / CELL).astype(np.int64)
        inside = (row >= 0) & (row < CELLS) & (column >= 0) & (column < CELLS)
        found[inside] |= glance.seen[row[inside], column[inside]]
    mask = np.zeros((CELLS, CELLS), bool)
    mask[rows[found], columns[found]] = True
    return mask


class _Tap:
    """Lets moments pass and notes what was visible at each."""

    def __init__(self, take: Take) -> None:
        self.take = take
        self.glances: list[Glance] = []

    def play(self, looks: Iterable[Look]) -> Iterator[Look]:
        """The same looks."""
        for look in looks:
            yield lambda: self._noted(look())  # noqa: B023 - made before the next one

    def _noted(self, moment: Moment) -> Moment:
        if moment.seen is None or math.isnan(moment.pose[0]):
            lacking = "the cameras' depth and semantics" if moment.seen is None else "the ego's pose"
            raise LogError(
                f"the log lacks {lacking}, from which hidden cells are told",
                where=str(self.take.log),
                hint="Record with `me3bev collect --depth --semantics`",
            )
        self.glances.append(Glance(moment.time, moment.pose, moment.seen))
        return moment

    def masks(self, step: int) -> dict[str, Bools]:
        """The cells of each of `PROBED`."""
        now = self.glances[step]
        past = [g for g in self.glances[:step] if g.time >= now.time - SECONDS - 1e-6]
        kept = remembered(now, past)
        return {"remembered": kept, "never_seen": ~now.seen & ~kept, "seen": now.seen}


@dataclass
class Probed:
    """Confusion of both runs by episode and mask: (E, 2, 3, 8, 8)."""

    counts: NDArray[np.int64]


class _Tapped(Episodes):
    """Plays through a tap."""

    def __init__(self, player: Episodes) -> None:
        super().__init__(player.recipe, player.mapping)
        self.tap: _Tap | None = None

    def play(self, take: Take) -> Iterator[Look]:
        """As its parent; what was visible is noted."""
        self.tap = _Tap(take)
        return self.tap.play(super().play(take))


def probe(
    reader: Reader,
    decoders: Sequence[SemanticDecoder],
    player: Episodes,
    takes: Sequence[Take],
    every: int,
    device: torch.device,
    shown: Callable[[int], None] = lambda done: None,
) -> Probed:
    """Play episodes once and score both runs on them.

    Args:
        reader: of both runs' u_BEV; its probes stand in the order of `decoders`.

    Raises:
        LogError: a log does not tell what was visible.
    """
    names = [own.name for own in reader.probes]
    scorer = Scorer(reader, dict(zip(names, decoders, strict=True)), None, None, device, every)
    tapped = _Tapped(player)
    table = np.zeros((len(takes), len(names), len(PROBED), len(BEV_CLASSES), len(BEV_CLASSES)), np.int64)
    try:
        for number, take in enumerate(takes):
            for step, moment, maps in scorer.frames(tapped, take):
                assert tapped.tap is not None
                masks = tapped.tap.masks(step)
                for run, name in enumerate(names):
                    for m, mask in enumerate(PROBED):
                        table[number, run, m] += confusion(moment.bev, maps[name], masks[mask])
            shown(number + 1)
    finally:
        tapped.close()
    return Probed(table)


CLASSES = (*BEV_CLASSES, "moving", "mean")
"""Each class, vehicle and pedestrian as one, and the mean over those that are there."""


def ious(counts: NDArray[np.int64]) -> NDArray[np.float64]:
    """Confusions (..., 8, 8) -> intersection over union (..., 10) of `CLASSES`; NaN where there is nothing."""
    hit = np.diagonal(counts, axis1=-2, axis2=-1).astype(float)
    union = counts.sum(-1) + counts.sum(-2) - hit
    own = np.divide(hit, union, out=np.full(hit.shape, np.nan), where=union > 0)
    first, last = (BEV_CLASSES.index(name) for name in MOVING)
    both = counts[..., first : last + 1, first : last + 1].sum((-1, -2)).astype(float)
    either = counts[..., first : last + 1, :].sum((-1, -2)) + counts[..., first : last + 1].sum((-1, -2)) - both
    moving = np.divide(both, either, out=np.full(both.shape, np.nan), where=either > 0)
    there = np.isfinite(own)
    mean = np.divide(
        np.where(there, own, 0).sum(-1), there.sum(-1), out=np.full(moving.shape, np.nan), where=there.any(-1)
    )
    return np.concatenate([own, moving[..., None], mean[..., None]], -1)


def probe_rows(probed: Probed, seed: int = 0) -> list[dict[str, Any]]:
    """A row per mask and class: both runs, the second less the first, and its percentile bootstrap interval.

    Episodes are drawn anew, the same ones for both runs.
    """
    counts, episodes = probed.counts, len(probed.counts)
    rng = np.random.default_rng(derive_seed(seed, "probing"))
    drawn = rng.multinomial(episodes, np.full(episodes, 1 / episodes), RESAMPLES)
    pooled = ious(counts.sum(0))
    resampled = ious(np.einsum("re,eamij->ramij", drawn, counts))
    difference, spread = pooled[1] - pooled[0], resampled[:, 1] - resampled[:, 0]
    cells = counts[:, 0].sum((0, 3))
    rows = []
    for m, mask in enumerate(PROBED):
        amounts = [*cells[m], sum(cells[m][BEV_CLASSES.index(name)] for name in MOVING), cells[m].sum()]
        for k, name in enumerate(CLASSES):
            low, high = _interval(spread[:, m, k])
            row = {"source": "u_bev", "mask": mask, "class": name, "cells": int(amounts[k]), "episodes": episodes}
            row |= {"a": float(pooled[0, m, k]), "b": float(pooled[1, m, k])}
            rows.append(row | {"difference": float(difference[m, k]), "low": low, "high": high})
    return rows


def _interval(values: NDArray[np.float64]) -> tuple[float, float]:
    there = values[np.isfinite(values)]
    if not len(there):
        return math.nan, math.nan
    low, high = np.percentile(there, [50 * (1 - LEVEL), 100 - 50 * (1 - LEVEL)])
    return float(low), float(high)

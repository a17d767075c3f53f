"""Scores, pictures and copies of logs by decoders that are there."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from me3bev_cli.decoding import evaluating
from me3bev_cli.decoding.evaluating import Album, Scored, Scorer, Shot, Wanted
from me3bev_cli.decoding.grid_log import Maps, copy_with_maps, topics_of
from me3bev_cli.decoding.latents import Probe, Reader
from me3bev_cli.decoding.moments import Episodes, Take, open_log
from me3bev_cli.decoding.panel import Picture, panel, stacked, write_pictures
from me3bev_cli.decoding.plan import GRID, MOST_FREQUENT, U_BEV, UNTRAINED
from me3bev_cli.decoding.probing import SECONDS, probe, probe_rows
from me3bev_cli.decoding.session import Policy, Say, probes_of
from me3bev_cli.decoding.store import Decoders
from me3bev_cli.errors import LogError, UserError


@dataclass(frozen=True)
class Asked:
    """What is made beside the scores."""

    panel: Path | None = None
    wanted: Wanted = field(default_factory=Wanted)
    every: int = 4


def scorer_of(policy: Policy, decoders: Decoders, every: int, *, baselines: bool = True) -> Scorer:
    """Asks all decoders that are there, and the perception stage's head."""
    names = [name for name in decoders.modules if baselines or name != UNTRAINED]
    return Scorer(
        reader=Reader(probes_of(policy, names)),
        decoders={name: decoders.modules[name] for name in names},
        head=policy.head(),
        most_frequent=decoders.most_frequent if baselines else None,
        device=policy.device,
        every=every,
    )


def score(
    policy: Policy, decoders: Decoders, player: Episodes, takes: Sequence[Take], asked: Asked, say: Say
) -> dict[str, Any]:
    """Score episodes, and draw the panel that is asked for; the result as JSON has it.

    Raises:
        LogError: a log cannot be read.
        UserError: a chosen frame is not there, or the picture cannot be written.
    """
    scorer = scorer_of(policy, decoders, asked.every)
    album = None if asked.panel is None else Album(asked.wanted)
    scored = scorer.score(player, takes, album, lambda done: say(f"scored: {done}/{len(takes)} episodes"))
    rows: list[dict[str, Any]] = []
    baselines: list[dict[str, Any]] = []
    by_weather: list[dict[str, Any]] = []
    for name, source in evaluating.sources_of(scorer.decoders, scorer.head).items():
        labels = {"source": source, "decoder": name if name in (evaluating.HEAD, MOST_FREQUENT) else "resnet"}
        own = evaluating.rows_of(scored, name, **labels)
        (rows if source in (U_BEV, GRID) else baselines).extend(own)
        by_weather += evaluating.weather_rows(scored, name, **labels)
    if asked.panel is not None and album is not None:
        draw(asked.panel, scorer, player, album.shots)
        say(f"picture: {asked.panel}")
    return {
        "recipe": policy.recipe.name,
        "run": str(policy.run),
        "checkpoint": policy.identity["checkpoint"],
        "decoder": {key: decoders.about[key] for key in ("steps", "ended", "scores")},
        "notes": _notes(decoders, scorer, scored),
        "frames": scored.of(next(iter(scored.counts[0]))).frames,
        "episodes": len(takes),
        "maps": [*dict.fromkeys(take.map for take in takes), "mean"],
        "weathers": list(dict.fromkeys(take.weather for take in takes)),
        "rows": rows,
        "baselines": baselines,
        "by_weather": by_weather,
    }


def _notes(decoders: Decoders, scorer: Scorer, scored: Scored) -> list[str]:
    notes = [decoders.about["note"]] if decoders.about["note"] else []
    if scorer.head is not None:
        notes.append("grid: " + ("by the decoder; " if GRID in decoders.modules else "") + (
            "the head that the perception stage left stands beside it" if GRID in decoders.modules
            else "by the head that the perception stage left"
        ))  # fmt: skip
    if not any(counts.told for own in scored.counts for counts in own.values()):
        notes.append("logs without --depth and --semantics do not tell which cells are seen")
    return notes


def draw(path: Path, scorer: Scorer, player: Episodes, shots: Sequence[Shot]) -> None:
    """Panels of some frames as PNG, or an animation along the first one's episode as WebP.

    Raises:
        UserError: there is none, or the picture cannot be written.
    """
    if not shots:
        raise UserError("none of the chosen frames was scored", where="--frames", hint="Numbers count scored frames")
    if path.suffix.lower() != ".webp":
        write_pictures(path, [stacked([_panel(shot) for shot in shots])])
        return
    take, every = shots[0].take, scorer.every
    scorer.every = 1
    try:
        pictures = [
            stacked([_panel(Shot(take, step, step, 0.0, moment, maps), scores=False)])
            for step, moment, maps in scorer.frames(player, take)
        ]
    finally:
        scorer.every = every
    write_pictures(path, pictures)


def _panel(shot: Shot, scores: bool = True) -> Picture:
    maps = {"truth": shot.moment.bev}
    for name, found in shot.maps.items():
        if name in (U_BEV, GRID, evaluating.HEAD):
            maps["decoded from grid" if name == evaluating.HEAD else f"decoded from {name}"] = found
    title = f"{shot.take.map}, {shot.take.weather}, step {shot.step}"
    if scores:
        title += f", frame {shot.number}, mean IoU {shot.score:.2f}"
    return panel(shot.moment.images, maps, title)


def add_to_logs(policy: Policy, decoders: Decoders, player: Episodes, takes: Sequence[Take], out: Path) -> list[Path]:
    """Copies of logs with the decoded maps added; a folder, or one file where `out` ends in .mcap.

    Raises:
        LogError: a log cannot be read, or a copy not written.
    """
    one = out.suffix == ".mcap"
    if one and len(takes) != 1:
        raise LogError(f"one file cannot hold the copies of {len(takes)} logs", where="--mcap", hint="Name a folder")
    scorer = scorer_of(policy, decoders, 1, baselines=False)
    topics = topics_of(scorer.decoders)
    written = []
    for take in takes:
        assert take.log is not None
        target = out if one else out / take.log.name
        if target.exists() and os.path.samefile(target, take.log):
            raise LogError("a copy cannot replace its log", where="--mcap", hint="Name another folder")
        maps = Maps()
        for step, _, found in scorer.frames(player, take):
            for name, topic in topics.items():
                maps.add(topic, step, found[name])
        about = {"run": policy.run.name, **policy.identity, **{topic: name for name, topic in topics.items()}}
        copy_with_maps(open_log(take.log, player.mapping), maps, target, about)
        written.append(target)
    return written


def compare(
    policies: Sequence[Policy], decoders: Sequence[Decoders], player: Episodes, takes: Sequence[Take], every: int,
    say: Say,
) -> dict[str, Any]:  # fmt: skip
    """Both runs' u_BEV on the same frames, by what was visible when.

    Raises:
        UserError: they see other cameras.
        LogError: the logs do not tell what was visible.
    """
    a, b = policies
    if a.recipe.observation.model_dump(exclude={"navigation", "waypoint_spacing"}) != b.recipe.observation.model_dump(
        exclude={"navigation", "waypoint_spacing"}
    ):
        raise UserError(
            f"'{a.recipe.name}' and '{b.recipe.name}' see other cameras or images of another size",
            where="--compare",
            hint="Compare runs of one observation",
        )
    for own in decoders:
        if U_BEV not in own.modules:
            raise UserError("one of the decoders does not read u_bev", where="--compare", hint="--overwrite")
    reader = Reader([Probe("a", a.network, U_BEV), Probe("b", b.network.to(a.device), U_BEV)])
    modules = [own.modules[U_BEV].to(a.device) for own in decoders]
    shown = lambda done: say(f"probed: {done}/{len(takes)} episodes")  # noqa: E731
    probed = probe(reader, modules, player, takes, every, a.device, shown)
    rows = probe_rows(probed)
    cells = int(probed.counts[:, 0].sum())
    notes = [f"{p.run.name}: {d.about['note']}" for p, d in zip(policies, decoders, strict=True) if d.about["note"]]
    return {
        "runs": [str(a.run), str(b.run)],
        "recipes": [a.recipe.name, b.recipe.name],
        "checkpoints": [policy.identity["checkpoint"] for policy in policies],
        "seconds": SECONDS,
        "episodes": len(takes),
        "frames": cells // 40_000,
        "notes": notes,
        "rows": rows,
    }

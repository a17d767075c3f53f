"""The page's part on failures: how often each kind happened, and the clips."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from me3bev_cli.evaluation.episode import Episode
from me3bev_cli.evaluation.logs import kept
from me3bev_cli.reporting.clips import Clip, Wanted, make_clips
from me3bev_cli.reporting.failures import KINDS, Failure, about, chosen, counted
from me3bev_cli.reporting.replay import world_for
from me3bev_cli.reporting.suites import Method, Suite
from me3bev_cli.reporting.summary import leading


@dataclass(frozen=True)
class Shown:
    """A clip on the page."""

    words: str
    video: str | None
    poster: str | None
    width: int
    height: int
    reason: str


@dataclass(frozen=True)
class Kind:
    """One kind of failure on the page."""

    title: str
    count: str
    clips: Sequence[Shown]


@dataclass
class Failures:
    """All kinds that happened."""

    kinds: list[Kind] = field(default_factory=list)
    note: str = ""
    warnings: list[str] = field(default_factory=list)
    data: list[dict[str, Any]] = field(default_factory=list)


@dataclass
class _Logged:
    """What the logs of the methods hold; each episode has the method's label of the report."""

    episodes: list[Episode] = field(default_factory=list)
    methods: dict[str, Method] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)


def tell_failures(suites: Sequence[Suite], each: int, stage: Path, told: Callable[[int, int], None]) -> Failures:
    """Count the failures of the methods that the report is about, and film some.

    Args:
        each: clips of a kind at most, of each suite.
        stage: the folder that stands for the report's until it is whole.
        told: called with the number of clips that are done, and of all.
    """
    found = Failures()
    counts: dict[str, list[str]] = {kind: [] for kind in KINDS}
    wanted: list[Wanted] = []
    drivers: list[str] = []
    for suite in suites:
        logged = _read(suite)
        found.warnings += logged.warnings
        drivers += logged.methods
        where = f" ({suite.title})" if len(suites) > 1 else ""
        driven = Counter(episode.driver for episode in logged.episodes)
        for kind, of in counted(logged.episodes).items():
            counts[kind] += [f"{name}{where}: {n} of {driven[name]} episodes" for name, n in of.items()]
        for failure in chosen(logged.episodes, each):
            label = failure.episode.driver
            wanted.append(Wanted(failure, world_for(logged.methods[label].about["identity"]), label))
    clips = make_clips(wanted, stage / "clips", stage, lambda done: told(done, len(wanted)))
    for kind, words in counts.items():
        if words:
            shown = [_shown(clip) for clip in clips.of(kind)]
            found.kinds.append(Kind(KINDS[kind], "; ".join(words), shown))
    found.note = _note(found, drivers, each)
    found.data = [{**about(clip.failure), "clip": clip.video, "reason": clip.reason} for clip in clips.clips]
    return found


def _read(suite: Suite) -> _Logged:
    found, without = _Logged(), dict[Path, list[str]]()
    for method in leading(suite):
        logs, identity = method.evaluation.logs, method.about.get("identity")
        if logs is None or not identity:
            without.setdefault(method.evaluation.folder, []).append(method.label)
            continue
        there = kept(logs, method.name)
        found.warnings += [f"{sentence}; the gallery leaves it out." for sentence in there.lost]
        inside = [e for e in there.episodes if e.map in suite.maps and e.density in suite.densities]
        found.episodes += [replace(episode, driver=method.label) for episode in inside]
        found.methods[method.label] = method
    found.warnings += [
        f"failures of {', '.join(labels)} are not shown: {folder} has no logs that can be driven again, as "
        "evaluations by this version of me3bev have."
        for folder, labels in without.items()
    ]
    return found


def _note(found: Failures, drivers: Sequence[str], each: int) -> str:
    if not drivers:
        return "There are no logs to look for failures in."
    if not found.kinds:
        return f"No episode of {', '.join(dict.fromkeys(drivers))} has a failure of any kind."
    if not each:
        return "Clips were not asked for."
    return (
        "The last four seconds before each: cameras, plan and the true bird's-eye map, driven again in the simulator "
        f"by seed and logged actions. At most {each} of a kind, of different methods and maps where there are."
    )


def _shown(clip: Clip) -> Shown:
    return Shown(_words(clip.failure, clip.method), clip.video, clip.poster, clip.width, clip.height, clip.reason)


def _words(failure: Failure, method: str) -> str:
    episode = failure.episode
    fault = ", at fault" if failure.at_fault else ""
    return (
        f"{method}: {KINDS[failure.kind].lower()}{fault}; {episode.map}, {episode.density} density, "
        f"{episode.weather.replace('_', ' ')}, episode {episode.index}, after {episode['time'][failure.step]:.1f} s; "
        f"seed {episode.seed}"
    )

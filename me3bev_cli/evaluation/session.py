"""`me3bev eval` from its options to its results: what is to be driven, the drive, what is written."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from me3bev_cli import __version__
from me3bev_cli.errors import UserError
from me3bev_cli.evaluation import folder
from me3bev_cli.evaluation.crew import make_crew
from me3bev_cli.evaluation.episode import Episode
from me3bev_cli.evaluation.folder import Manifest
from me3bev_cli.evaluation.identity import identity
from me3bev_cli.evaluation.logs import kept
from me3bev_cli.evaluation.maps import shorten
from me3bev_cli.evaluation.methods import Asked, Chosen, choose
from me3bev_cli.evaluation.plan import Visit, jobs_for, look_into, visits
from me3bev_cli.evaluation.player import Method, Played, Player
from me3bev_cli.evaluation.progress import EvaluationProgress
from me3bev_cli.evaluation.references import ReferenceLogs, reference_logs
from me3bev_cli.evaluation.runner import episode_seed
from me3bev_cli.evaluation.snapshot import Snapshot, load_snapshot
from me3bev_cli.evaluation.timing import Timing, note, pace
from me3bev_cli.parallel import run_jobs
from me3bev_cli.pretrained import named, results_home
from me3bev_cli.training.run import runs_root, versions


@dataclass(frozen=True)
class Evaluation:
    """Everything that decides the figures, and where they go."""

    methods: tuple[Method, ...]
    maps: tuple[str, ...]
    densities: tuple[str, ...]
    weather: tuple[str, ...]
    """Each episode draws one of these by its seed."""
    episodes: int
    """For each map and density."""
    seed: int
    out: Path
    baseline: str | None = None
    """The method that the others are compared with."""
    overwrite: bool = False

    @cached_property
    def visits(self) -> list[Visit]:
        """Every episode."""
        return visits(len(self.methods), self.maps, self.densities, self.episodes)

    @cached_property
    def identities(self) -> list[dict[str, Any]]:
        """What decides each method's episodes."""
        return [identity(method, self.seed, self.maps) for method in self.methods]

    @property
    def manifest(self) -> Manifest:
        """What the folder is for."""
        labels = [method.label for method in self.methods]
        return Manifest(self.maps, self.densities, self.episodes, dict(zip(labels, self.identities, strict=True)))

    @property
    def judged(self) -> list[str]:
        """The methods that a gate is for: policies of runs, or every driver where there is none."""
        runs = [method.label for method in self.methods if method.spec.run is not None]
        return runs or [method.label for method in self.methods]

    def setup(self) -> dict[str, Any]:
        """What `results.json` says about where its rows come from; beside all methods, the first one's own."""
        methods = [_about(method, found) for method, found in zip(self.methods, self.identities, strict=True)]
        world = self.methods[0].world
        return {
            "me3bev": __version__,
            "versions": versions(),
            **{key: methods[0][key] for key in ("method", "driver", "run", "checkpoint", "recipe")},
            "simulator": world.simulator.name,
            "simulator_settings": world.simulator.settings,
            "observation": world.observation.model_dump(mode="json"),
            "maps": list(self.maps),
            "densities": list(self.densities),
            "weather": list(self.weather),
            "episodes": self.episodes,
            "seed": self.seed,
            "methods": methods,
        }


def _about(method: Method, found: dict[str, Any]) -> dict[str, Any]:
    spec = method.spec
    return {
        "method": method.label,
        "driver": spec.name,
        "run": named(spec.run) if spec.run is not None else None,
        "checkpoint": spec.checkpoint if spec.run is not None else None,
        "recipe": spec.recipe.name if spec.recipe else None,
        "identity": found,
    }


def prepare(
    asked: Asked,
    *,
    maps: str | None,
    density: str | None,
    weather: str | None,
    episodes: int,
    seed: int,
    out: Path | None,
    overwrite: bool,
) -> Evaluation:
    """Check every option before anything is driven.

    Raises:
        UserError: any of them is wrong, or there is neither a run nor a driver.
    """
    chosen = choose(asked, maps, density, weather)
    cells = chosen.cells
    if out is None:
        words = [cells.maps, cells.densities, *([] if weather is None else [cells.world.weather or ()])]
        out = _folder(chosen, asked.checkpoint) / "-".join(shorten(names) for names in words)
    evaluation = Evaluation(
        chosen.methods, cells.maps, cells.densities, cells.world.weather or (), episodes, seed, out,
        chosen.baseline, overwrite,
    )  # fmt: skip
    folder.check_folder(out, evaluation.manifest, overwrite)
    return evaluation


def _folder(chosen: Chosen, checkpoint: str) -> Path:
    """Where an evaluation is kept unless the user says otherwise: with its run, if there is just one."""
    runs = [method.spec.run for method in chosen.methods if method.spec.run is not None]
    if len(runs) == 1:
        home = results_home(runs[0]) / "eval"
        return home if checkpoint == "last" else home / checkpoint
    label = ",".join(method.label for method in chosen.methods)
    own = all(method.spec.recipe is chosen.recipe for method in chosen.methods)
    # A reference driver's figures depend on the recipe's world.
    name = label if runs or chosen.recipe is None or own else f"{label}-{chosen.recipe.name}"
    return runs_root() / "eval" / name


@dataclass(eq=False)
class Driven:
    """What an evaluation's episodes are, and what it took."""

    episodes: Sequence[Episode]
    """Method by method and cell by cell."""
    snapshot: Snapshot | None
    """Of the first episode."""
    notes: Sequence[str]
    """What the user should know: logs that had to be driven again."""
    pace: str


def drive(evaluation: Evaluation, workers: int, progress: EvaluationProgress) -> Driven:
    """Drive what the folder does not have yet; every episode is kept there as soon as it is finished.

    Raises:
        UserError: a policy cannot be loaded, or a simulator breaks its contract.
        KeyboardInterrupt: what has been finished is kept.
    """
    if evaluation.overwrite:
        # Before anything is removed: a policy that cannot be loaded replaces nothing.
        for method in evaluation.methods:
            make_crew(method.spec)
    folder.prepare_folder(evaluation.out, evaluation.manifest, evaluation.overwrite)
    done, notes = _there(evaluation)
    progress.begin(list(done.values()))
    player = Player(evaluation.methods, evaluation.seed, evaluation.out / folder.EPISODES)
    jobs = jobs_for(evaluation.visits, done, workers)
    picture = evaluation.out / folder.SNAPSHOT
    timing = Timing()
    shared = _shared(evaluation)

    def take(number: int, played: Played) -> None:
        timing.add(played.timing)
        if played.snapshot is not None:
            played.snapshot.save(picture)
        for episode in played.episodes:
            method = everything[number].method
            done[Visit(method, episode.map, episode.density, episode.index)] = episode
            cache = shared[method]
            if cache is not None:
                cache.keep(episode)
        progress.add(played.episodes)

    everything = jobs if _has_picture(evaluation) else [look_into(evaluation.visits[0]), *jobs]
    try:
        run_jobs(player, everything, workers, take, progress.died)
    except UserError:
        folder.discard_empty(evaluation.out)
        raise
    finally:
        if timing.steps:
            note(evaluation.out / folder.TIMING, timing, progress.seconds, workers)
    episodes = [done[visit] for visit in evaluation.visits]
    return Driven(episodes, load_snapshot(picture), notes, pace(timing, progress.seconds, workers))


def _has_picture(evaluation: Evaluation) -> bool:
    """Whether the folder's snapshot is of the first episode: an evaluation that has grown may begin elsewhere."""
    snapshot, first = load_snapshot(evaluation.out / folder.SNAPSHOT), evaluation.visits[0]
    if snapshot is None:
        return False
    label = evaluation.methods[first.method].label
    return (snapshot.method, snapshot.map, snapshot.density) == (label, first.map, first.density)


def _shared(evaluation: Evaluation) -> list[ReferenceLogs | None]:
    return [reference_logs(m, i) for m, i in zip(evaluation.methods, evaluation.identities, strict=True)]


def _there(evaluation: Evaluation) -> tuple[dict[Visit, Episode], list[str]]:
    """The episodes that need not be driven: in the folder already, or driven by the same reference driver before."""
    wanted, logs = set(evaluation.visits), evaluation.out / folder.EPISODES
    found: dict[Visit, Episode] = {}
    notes: list[str] = []
    for number, method in enumerate(evaluation.methods):
        there = kept(logs, method.label)
        notes += [f"{sentence}; the episode is driven again" for sentence in there.lost]
        for episode in there.episodes:
            visit = Visit(number, episode.map, episode.density, episode.index)
            if visit in wanted and episode.seed == _seed(evaluation, visit) and episode.driver == method.label:
                found[visit] = episode
    shared = _shared(evaluation)
    for visit in evaluation.visits:
        cache = shared[visit.method] if visit not in found else None
        driven = cache.find(visit.map, visit.density, visit.number, _seed(evaluation, visit)) if cache else None
        if driven is not None:
            found[visit] = driven
            driven.save(logs / driven.driver / driven.file_name)
    return found, notes


def _seed(evaluation: Evaluation, visit: Visit) -> int:
    return episode_seed(evaluation.seed, visit.map, visit.density, visit.number)


def finished(evaluation: Evaluation) -> int:
    """How many of the episodes are kept in the folder."""
    return len(_there(evaluation)[0])

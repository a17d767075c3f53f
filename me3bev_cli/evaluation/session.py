"""`me3bev eval` from its options to its results: what is to be driven, the drive, what is written."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from me3bev_cli import __version__
from me3bev_cli.evaluation.choice import choose_cells, choose_driver
from me3bev_cli.evaluation.drivers import DriverSpec
from me3bev_cli.evaluation.episode import Episode
from me3bev_cli.evaluation.maps import shorten
from me3bev_cli.evaluation.progress import EvaluationProgress
from me3bev_cli.evaluation.results import CSV, JSON, PICTURE, document, refuse_foreign, save_episodes
from me3bev_cli.evaluation.runner import Player, Snapshot, World, plan
from me3bev_cli.evaluation.runner import evaluate as run_evaluation
from me3bev_cli.evaluation.summary import Row, WeatherRow, by_weather, summarise
from me3bev_cli.evaluation.tables import csv_text
from me3bev_cli.files import atomic_write_bytes, atomic_write_text
from me3bev_cli.output import write_json
from me3bev_cli.recipe import Recipe
from me3bev_cli.training.run import runs_root, versions


@dataclass(frozen=True)
class Evaluation:
    """Everything that decides the figures, and where they go."""

    world: World
    driver: DriverSpec
    maps: tuple[str, ...]
    densities: tuple[str, ...]
    episodes: int
    """For each map and density."""
    seed: int
    out: Path

    @property
    def total(self) -> int:
        """Episodes in all."""
        return len(self.maps) * len(self.densities) * self.episodes

    @property
    def weather(self) -> tuple[str, ...]:
        """Each episode draws one of these by its seed."""
        return self.world.weather or ()

    def setup(self) -> dict[str, Any]:
        """What `results.json` says about where its rows come from."""
        run = self.driver.run
        return {
            "me3bev": __version__,
            "versions": versions(),
            "method": self.driver.label,
            "driver": self.driver.name,
            "run": str(run) if run is not None else None,
            "checkpoint": self.driver.checkpoint if run is not None else None,
            "recipe": self.driver.recipe.name if self.driver.recipe else None,
            "simulator": self.world.simulator.name,
            "simulator_settings": self.world.simulator.settings,
            "observation": self.world.observation.model_dump(mode="json"),
            "maps": list(self.maps),
            "densities": list(self.densities),
            "weather": list(self.weather),
            "episodes": self.episodes,
            "seed": self.seed,
        }


def prepare(
    *,
    run: Path | None,
    checkpoint: str,
    driver: str | None,
    recipe: str | None,
    device: str,
    maps: str | None,
    density: str | None,
    weather: str | None,
    episodes: int,
    seed: int,
    out: Path | None,
) -> Evaluation:
    """Check every option before anything is driven.

    Raises:
        UserError: any of them is wrong, or there is neither a run nor a driver.
    """
    spec, loaded = choose_driver(run, checkpoint, driver, recipe, device)
    cells = choose_cells(loaded, maps, density, weather, "evaluation")
    if out is None:
        words = [cells.maps, cells.densities, *([] if weather is None else [cells.world.weather or ()])]
        out = _folder(spec, loaded, checkpoint) / "-".join(shorten(names) for names in words)
    refuse_foreign(out)
    return Evaluation(cells.world, spec, cells.maps, cells.densities, episodes, seed, out)


def _folder(spec: DriverSpec, recipe: Recipe | None, checkpoint: str) -> Path:
    """Where a driver's evaluations are kept unless the user says otherwise."""
    if spec.run is not None:
        return spec.run / "eval" if checkpoint == "last" else spec.run / "eval" / checkpoint
    # A reference driver's figures depend on the recipe's world.
    label = spec.label if recipe is None or recipe is spec.recipe else f"{spec.label}-{recipe.name}"
    return runs_root() / "eval" / label


@dataclass(eq=False)
class Outcome:
    """What an evaluation found."""

    setup: dict[str, Any]
    episodes: Sequence[Episode]
    rows: Sequence[Row]
    weather_rows: Sequence[WeatherRow]
    """Empty where all episodes have the same weather."""
    snapshot: Snapshot | None
    pace: str
    """How long it took, for people."""

    @cached_property
    def document(self) -> dict[str, Any]:
        """What `results.json` holds."""
        return document(self.setup, self.rows, self.weather_rows)

    @cached_property
    def csv(self) -> str:
        """The rows as CSV."""
        return csv_text(self.rows)

    @cached_property
    def picture(self) -> bytes:
        """The picture as PNG."""
        from me3bev_cli.evaluation.picture import picture_bytes

        count = self.setup["episodes"]
        title = f"{self.setup['method']}: {count} episodes per map and density, seed {self.setup['seed']}"
        return picture_bytes(self.rows, title, self.snapshot)

    def write(self, out: Path) -> list[Path]:
        """Write the evaluation's folder; returns what is in it."""
        logs = save_episodes(out, self.episodes)
        write_json(self.document, str(out / JSON))
        atomic_write_text(out / CSV, self.csv)
        atomic_write_bytes(out / PICTURE, self.picture)
        return [out / JSON, out / CSV, out / PICTURE, logs]


def play(evaluation: Evaluation, workers: int, progress: EvaluationProgress) -> Outcome:
    """Drive every episode and score it."""
    player = Player(evaluation.world, evaluation.driver, evaluation.seed)
    jobs = plan(evaluation.maps, evaluation.densities, evaluation.episodes, snapshot=True)
    episodes, snapshot = run_evaluation(player, jobs, workers, progress.add, progress.died)
    steps = sum(len(episode) for episode in episodes)
    pace = f"{steps:,} steps in {progress.seconds:.1f} s ({steps / progress.seconds:.0f} per s), {workers} workers"
    weather_rows = by_weather(episodes, evaluation.weather) if len(evaluation.weather) > 1 else []
    return Outcome(evaluation.setup(), episodes, summarise(episodes), weather_rows, snapshot, pace)

"""`me3bev eval` from its options to its results: what is to be driven, the drive, what is written."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from me3bev_cli import __version__
from me3bev_cli.api import ObservationConfig
from me3bev_cli.errors import RunError, UserError
from me3bev_cli.evaluation.drivers import DriverSpec
from me3bev_cli.evaluation.episode import Episode
from me3bev_cli.evaluation.maps import parse_densities, parse_maps, shorten
from me3bev_cli.evaluation.progress import EvaluationProgress
from me3bev_cli.evaluation.results import CSV, JSON, PICTURE, document, refuse_foreign, save_episodes
from me3bev_cli.evaluation.runner import Player, Snapshot, World, plan
from me3bev_cli.evaluation.runner import evaluate as run_evaluation
from me3bev_cli.evaluation.summary import Row, summarise
from me3bev_cli.evaluation.tables import csv_text
from me3bev_cli.files import atomic_write_bytes, atomic_write_text
from me3bev_cli.output import write_json
from me3bev_cli.recipe import PluginChoice, Recipe
from me3bev_cli.recipe_loading import resolve_recipe
from me3bev_cli.training.run import newest_run, open_run, runs_root, versions

SIMULATOR = "highway"
"""What reference drivers drive in when no recipe says otherwise."""


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
    episodes: int,
    seed: int,
    out: Path | None,
) -> Evaluation:
    """Check every option before anything is driven.

    Raises:
        UserError: any of them is wrong, or there is neither a run nor a driver.
    """
    spec, loaded = _who(run, checkpoint, driver, recipe, device)
    # The recipe's map and density say where it trained; the rest of the block is the world.
    choice = PluginChoice(name=loaded.simulator.name, **loaded.simulator.settings) if loaded else _default_choice()
    world = World(choice, loaded.observation if loaded else ObservationConfig())
    simulator = world.open()
    known_maps, known_densities = simulator.maps(), simulator.densities()
    chosen_maps = parse_maps(maps, known_maps) if maps is not None else list(known_maps)
    default = loaded.simulator.density if loaded else known_densities[0]
    chosen_densities = parse_densities(default if density is None else density, known_densities)
    if out is None:
        out = _folder(spec, loaded, checkpoint) / f"{shorten(chosen_maps)}-{shorten(chosen_densities)}"
    refuse_foreign(out)
    return Evaluation(world, spec, tuple(chosen_maps), tuple(chosen_densities), episodes, seed, out)


def _folder(spec: DriverSpec, recipe: Recipe | None, checkpoint: str) -> Path:
    """Where a driver's evaluations are kept unless the user says otherwise."""
    if spec.run is not None:
        return spec.run / "eval" if checkpoint == "last" else spec.run / "eval" / checkpoint
    # A reference driver's figures depend on the recipe's world.
    label = spec.label if recipe is None or recipe is spec.recipe else f"{spec.label}-{recipe.name}"
    return runs_root() / "eval" / label


def _default_choice() -> PluginChoice:
    return PluginChoice(name=SIMULATOR)


def _who(
    run: Path | None, checkpoint: str, driver: str | None, recipe: str | None, device: str
) -> tuple[DriverSpec, Recipe | None]:
    """The driver, and the recipe whose world it drives in."""
    if recipe is not None and (run is not None or driver is None):
        hint = "Give --driver too" if run is None else "A run drives in the world of its own recipe"
        raise UserError("a recipe alone is not a driver", where="--recipe", hint=hint)
    if driver is None:
        return _policy(run, checkpoint, device)
    loaded: Recipe | None = None
    if run is not None:
        loaded = resolve_recipe(_policy_folder(run) / "recipe.yaml")
    elif recipe is not None:
        loaded = resolve_recipe(recipe)
    if driver == "untrained":
        label = f"untrained-{loaded.name}" if loaded else driver
        return DriverSpec(driver, label, recipe=loaded, device=device), loaded
    return DriverSpec(driver, driver), loaded


def _policy(run: Path | None, checkpoint: str, device: str) -> tuple[DriverSpec, Recipe]:
    """A run's policy. Which checkpoint it is, is settled here: a training that goes on may make newer ones."""
    from me3bev_cli.training.checkpoint import find_checkpoint

    folder = _policy_folder(run)
    name = find_checkpoint(folder, checkpoint).name
    recipe = resolve_recipe(folder / "recipe.yaml")
    return DriverSpec("policy", folder.resolve().name, folder, name, recipe, device), recipe


def _policy_folder(run: Path | None) -> Path:
    """The run or checkpoint folder that is named, or the newest run.

    Raises:
        RunError: there is none.
    """
    if run is not None:
        # A checkpoint folder can stand alone: it holds its own recipe.
        is_checkpoint = (run / "recipe.yaml").is_file() and (run / "policy.safetensors").is_file()
        return run if is_checkpoint else open_run(run)
    newest = newest_run()
    if newest is None:
        raise RunError(
            f"there is no run under {runs_root()}",
            hint="`me3bev train RECIPE` makes one; `--driver autopilot` needs none",
        )
    return newest


@dataclass(eq=False)
class Outcome:
    """What an evaluation found."""

    setup: dict[str, Any]
    episodes: Sequence[Episode]
    rows: Sequence[Row]
    snapshot: Snapshot | None
    pace: str
    """How long it took, for people."""

    @cached_property
    def document(self) -> dict[str, Any]:
        """What `results.json` holds."""
        return document(self.setup, self.rows)

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
    return Outcome(evaluation.setup(), episodes, summarise(episodes), snapshot, pace)

"""Who drives and in which world, from a command's options."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from me3bev_cli.api import ObservationConfig, SimulatorPlugin
from me3bev_cli.errors import UserError, unknown_name
from me3bev_cli.evaluation.drivers import REFERENCES, DriverSpec
from me3bev_cli.evaluation.maps import parse_densities, parse_maps, parse_weathers
from me3bev_cli.evaluation.runner import World
from me3bev_cli.pretrained import NAME, default_run, find_run, run_path
from me3bev_cli.recipe import PluginChoice, Recipe
from me3bev_cli.recipe_loading import resolve_recipe
from me3bev_cli.training.run import open_run

WeatherSet = Literal["training", "evaluation"]
"""The recipe's set that stands for an option `--weather` that is not given."""

SIMULATOR = "highway"
"""What reference drivers drive in when no recipe says otherwise."""


def choose_driver(
    run: Path | None, checkpoint: str, driver: str | None, recipe: str | None, device: str
) -> tuple[DriverSpec, Recipe | None]:
    """The driver, and the recipe whose world it drives in.

    Raises:
        UserError: the options do not go together, or what they name is missing.
    """
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


def world_of(recipe: Recipe | None) -> World:
    """The world of a recipe, or the default one. Its map and density say where it trained, and are left out."""
    if recipe is None:
        return World(PluginChoice(name=SIMULATOR), ObservationConfig())
    return World(PluginChoice(name=recipe.simulator.name, **recipe.simulator.settings), recipe.observation)


@dataclass(frozen=True)
class Cells:
    """The world with the weather that episodes draw from, and where in it they take place."""

    world: World
    maps: tuple[str, ...]
    densities: tuple[str, ...]


def choose_cells(
    recipe: Recipe | None, maps: str | None, density: str | None, weather: str | None, unset: WeatherSet
) -> Cells:
    """What `--maps`, `--density` and `--weather` name: by default every map, the recipe's density and `unset` set.

    Raises:
        UserError: one of them names what is not there.
    """
    world = world_of(recipe)
    simulator = world.open()
    known_maps, known_densities = simulator.maps(), simulator.densities()
    if density is None:
        density = recipe.simulator.density if recipe else known_densities[0]
    return Cells(
        replace(world, weather=choose_weather(weather, simulator, recipe, unset)),
        tuple(known_maps if maps is None else parse_maps(maps, known_maps)),
        tuple(parse_densities(density, known_densities)),
    )


def choose_weather(
    option: str | None, simulator: SimulatorPlugin, recipe: Recipe | None, unset: WeatherSet
) -> tuple[str, ...]:
    """What `--weather` names; without it the recipe's `unset` set, or the default weather where there is no recipe.

    Raises:
        MapError: it names what is not there.
    """
    available = simulator.weathers()
    sets: dict[str, tuple[str, ...]] = {}
    if recipe is not None:
        default = available[:1]
        sets = {
            "training": recipe.weather.training or default,
            "evaluation": recipe.weather.evaluation or default,
        }
    if option is None:
        return sets.get(unset, available[:1])
    return tuple(parse_weathers(option, available, sets))


def reference_or_run(driver: str) -> tuple[str | None, Path | None]:
    """What `--driver NAME|RUN` means: (a reference driver, None), or (None, the path of a run).

    Raises:
        UserError: it is neither the name of a driver nor a folder nor the name of a run.
    """
    if driver in REFERENCES:
        return driver, None
    path = run_path(driver)
    if path is None:
        raise unknown_name("driver or run", driver, (*REFERENCES, NAME), where="--driver")
    return None, path


def _policy(run: Path | None, checkpoint: str, device: str) -> tuple[DriverSpec, Recipe]:
    """A run's policy. Which checkpoint it is, is settled here: a training that goes on may make newer ones."""
    from me3bev_cli.training.checkpoint import find_checkpoint

    folder = _policy_folder(run)
    name = find_checkpoint(folder, checkpoint).name
    recipe = resolve_recipe(folder / "recipe.yaml")
    return DriverSpec("policy", folder.resolve().name, folder, name, recipe, device), recipe


def _policy_folder(run: Path | None) -> Path:
    """The run or checkpoint folder that is named, or what drives when none is.

    Raises:
        RunError: there is no such run.
    """
    if run is None:
        return default_run()
    place = find_run(run)
    # A checkpoint folder can stand alone: it holds its own recipe.
    is_checkpoint = (place / "recipe.yaml").is_file() and (place / "policy.safetensors").is_file()
    return place if is_checkpoint else open_run(place)

"""Do the stages of a recipe fit together? Asked of the plugins' class methods, before anything is allocated."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeVar

from pydantic import BaseModel

from me3bev_cli import registry
from me3bev_cli.api import ObservationConfig, PluginConfig, Rig, TokenSpec
from me3bev_cli.errors import PluginError, RecipeError, UserError, unknown_name
from me3bev_cli.perception.grid import grid_of
from me3bev_cli.recipe import MODALITIES, Encoders, PluginChoice, Recipe, SimulatorChoice
from me3bev_cli.recipe_faults import Fault, validate
from me3bev_cli.recipe_yaml import Path

T = TypeVar("T")
M = TypeVar("M", bound=BaseModel)

BLOCKS: dict[str, type[BaseModel]] = {
    "simulator": SimulatorChoice,
    "spatial": PluginChoice,
    "temporal": PluginChoice,
    "fusion": PluginChoice,
}
"""The plugin blocks of a recipe; their names are the kinds of plugins."""


@dataclass(frozen=True)
class Chosen:
    """A plugin class and the configuration that the recipe gives it."""

    plugin: type[Any]
    config: PluginConfig


@dataclass(frozen=True)
class Fit:
    """A recipe whose stages fit: the plugins, and the sizes they agreed on."""

    simulator: Any
    """An instance of the simulator plugin; maps are not opened yet."""
    rig: Rig
    plugins: Mapping[str, Chosen]
    """By kind; spatial and temporal only where the recipe has them."""
    tokens: Mapping[str, TokenSpec]
    """Per chosen modality what enters its temporal module; `vr` and `nav` have one token."""
    widths: Mapping[str, int]
    """Per chosen modality the width of its vector at the fusion."""
    fused: int
    """Width of the fused vector."""


def check_recipe(recipe: Recipe) -> Fit:
    """The recipe's plugins and sizes.

    Raises:
        RecipeError: every fault, by key.
    """
    checker = Checker(recipe.model_dump(mode="json"))
    result = checker.run()
    if result is None:
        raise RecipeError([fault.located() for fault in checker.faults])
    return result


def _block(model: type[M], data: Any) -> M | None:
    """A block of the recipe that may be absent; None where it breaks the schema, which says so itself."""
    block, _ = validate(model, data or {})
    return block


def _modalities(data: Any) -> tuple[str, ...]:
    default = Recipe.model_fields["modalities"].default
    return tuple(name for name in MODALITIES if name in data) if isinstance(data, list) else default


class Checker:
    """Collects every fault that needs the plugins; parts that an earlier fault makes undecidable are left out.

    Args:
        data: the recipe as plain values; it may break the schema.
    """

    def __init__(self, data: Mapping[str, Any]) -> None:
        self.data = data
        self.faults: list[Fault] = []
        self.chosen: dict[str, Chosen] = {}
        self.default_weather: tuple[str, ...] | None = None
        """What a set that the recipe leaves open stands for; None without a simulator."""

        self.modalities = _modalities(data.get("modalities"))
        self.encoders = _block(Encoders, data.get("encoders"))

    def run(self) -> Fit | None:
        """The fit; None when there are faults or the schema left nothing to fit."""
        for kind in BLOCKS:
            self._choose(kind)
        simulator = self._simulator()
        rig = self._rig(simulator)
        tokens = self._tokens(rig)
        self._grid(rig)
        self._temporal(tokens)
        widths = self._widths()
        fused = self._fused(widths) if widths else None
        if self.faults or rig is None or fused is None or len(tokens) < len(widths):
            return None
        return Fit(simulator, rig, dict(self.chosen), tokens, widths, fused)

    def _fault(self, path: Path, error: UserError | ValueError) -> None:
        if isinstance(error, UserError):
            self.faults.append(Fault(path, error.what, error.allowed, error.hint))
        else:
            self.faults.append(Fault(path, str(error)))

    def _asked(self, path: Path, question: Callable[[], T]) -> T | None:
        """The plugin's answer; a refusal becomes a fault at `path`."""
        try:
            return question()
        except (UserError, ValueError) as error:
            self._fault(path, error)
            return None

    def _choose(self, kind: str) -> None:
        block = self.data.get(kind)
        if not isinstance(block, Mapping) or not isinstance(block.get("name"), str):
            return
        try:
            plugin = registry.load(kind, block["name"])
        except PluginError as error:
            self._fault((kind, "name"), error)
            return
        own = {key: value for key, value in block.items() if key not in BLOCKS[kind].model_fields}
        config, faults = validate(plugin.Config, own, (kind,))
        self.faults.extend(faults)
        if not faults:
            self.chosen[kind] = Chosen(plugin, config)

    def _simulator(self) -> Any:
        chosen = self.chosen.get("simulator")
        if chosen is None:
            return None
        simulator: Any = self._asked(("simulator",), lambda: chosen.plugin(chosen.config))
        if simulator is None:
            return None
        stages = [(("stages", index), stage) for index, stage in self._stages()]
        for key, options in (("map", simulator.maps()), ("density", simulator.densities())):
            for path, block in [(("simulator",), self.data["simulator"]), *stages]:
                self._known(key, (*path, key), block.get(key), options)
        evaluation = self.data.get("evaluation")
        for what, key, options in (("map", "maps", simulator.maps()), ("density", "densities", simulator.densities())):
            names = evaluation.get(key) if isinstance(evaluation, Mapping) else None
            for index, word in enumerate(names if isinstance(names, list) else ()):
                self._known(what, ("evaluation", key, index), word, options)
        self._weather(simulator.weathers(), stages)
        for path, stage in stages:
            own = stage.get("simulator")
            if isinstance(own, Mapping):
                changed = {**chosen.config.model_dump(mode="json"), **own}
                self.faults.extend(validate(chosen.plugin.Config, changed, (*path, "simulator"), nulls=True)[1])
        return simulator

    def _known(self, what: str, path: Path, word: Any, options: Collection[str]) -> None:
        if isinstance(word, str) and word not in options:
            self._fault(path, unknown_name(what, word, options))

    def _weather(self, options: tuple[str, ...], stages: Sequence[tuple[Path, Mapping[str, Any]]]) -> None:
        self.default_weather = options[:1]
        block = self.data.get("weather")
        sets: list[tuple[Path, Any]] = (
            [(("weather", key), names) for key, names in block.items()] if isinstance(block, Mapping) else []
        )
        sets += [((*path, "weather"), stage.get("weather")) for path, stage in stages]
        for path, names in sets:
            for index, word in enumerate(names if isinstance(names, list) else ()):
                self._known("weather", (*path, index), word, options)

    def _stages(self) -> list[tuple[int, Mapping[str, Any]]]:
        """The stages that are blocks at all, with their indices."""
        stages = self.data.get("stages")
        numbered = enumerate(stages) if isinstance(stages, list) else ()
        return [(index, stage) for index, stage in numbered if isinstance(stage, Mapping)]

    def _rig(self, simulator: Any) -> Rig | None:
        observation = _block(ObservationConfig, self.data.get("observation"))
        if simulator is None or observation is None:
            return None
        return self._asked(("observation", "cameras"), lambda: simulator.rig(observation))

    def _widths(self) -> dict[str, int]:
        if self.encoders is None:
            return {}
        return {name: getattr(self.encoders, name).width for name in self.modalities}

    def _tokens(self, rig: Rig | None) -> dict[str, TokenSpec]:
        tokens: dict[str, TokenSpec] = {}
        chosen = self.chosen.get("spatial")
        if "bev" in self.modalities and chosen is not None and rig is not None:
            spec = self._asked(("spatial",), lambda: chosen.plugin.output_spec(chosen.config, rig))
            if spec is not None:
                tokens["bev"] = spec
        for name in ("vr", "nav"):
            if name in self.modalities and self.encoders is not None:
                tokens[name] = TokenSpec(1, 1, getattr(self.encoders, name).width)
        return tokens

    def _grid(self, rig: Rig | None) -> None:
        """Segmentation is learned on a bird's-eye grid."""
        chosen = self.chosen.get("spatial")
        for index, stage in self._stages():
            if stage.get("kind") != "perception":
                continue
            path: Path = ("stages", index, "kind")
            if "bev" not in self.modalities:
                self._fault(path, UserError("a perception stage needs bev among the modalities"))
            elif chosen is not None and rig is not None:
                name = self.data["spatial"]["name"]
                self._asked(path, lambda name=name: grid_of(chosen.plugin, name, chosen.config, rig))  # type: ignore[misc]

    def _temporal(self, tokens: Mapping[str, TokenSpec]) -> None:
        chosen = self.chosen.get("temporal")
        if chosen is None:
            return
        for width in dict.fromkeys(spec.width for spec in tokens.values()):
            before = len(self.faults)
            self._asked(("temporal",), lambda width=width: chosen.plugin.check(chosen.config, width))  # type: ignore[misc]
            if len(self.faults) > before:
                owners = " and ".join(name for name, spec in tokens.items() if spec.width == width)
                fault = self.faults[-1]
                self.faults[-1] = replace(fault, what=f"{fault.what} (vectors of {owners})")

    def _fused(self, widths: Mapping[str, int]) -> int | None:
        chosen = self.chosen.get("fusion")
        if chosen is None:
            return None
        return self._asked(("fusion",), lambda: chosen.plugin.output_width(chosen.config, widths))

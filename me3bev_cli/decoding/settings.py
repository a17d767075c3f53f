"""What the options of `me3bev decode` mean."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from me3bev_cli.decoding.evaluating import Wanted
from me3bev_cli.decoding.learning import StoppedError
from me3bev_cli.decoding.moments import Episodes, Take, check_logs, live_takes, log_takes
from me3bev_cli.decoding.panel import check_panel
from me3bev_cli.decoding.plan import GRID, U_BEV, Plan
from me3bev_cli.decoding.resnet import parse_pretrained
from me3bev_cli.decoding.results import Asked, add_to_logs, score
from me3bev_cli.decoding.results import compare as compare_policies
from me3bev_cli.decoding.session import (
    Policy,
    begin_anew,
    have_decoders,
    identity_in,
    open_policy,
    opened_mapping,
    scenes_of,
)  # fmt: skip
from me3bev_cli.decoding.store import Decoders
from me3bev_cli.errors import UserError, unknown_name
from me3bev_cli.evaluation.choice import choose_weather
from me3bev_cli.evaluation.maps import parse_densities, parse_maps
from me3bev_cli.output import write_json
from me3bev_cli.pipeline.assemble import configured
from me3bev_cli.pretrained import default_run, find_run, results_home
from me3bev_cli.recipe import Recipe
from me3bev_cli.recording.reader import log_files
from me3bev_cli.training.run import open_run

SOURCES = {U_BEV: (U_BEV,), GRID: (GRID,), "both": (U_BEV, GRID)}
SCORES = "scores.json"
"""In the decoder's folder: the last scores."""
EACH, COMPARED = 4, 8
"""Episodes of each map that are scored, and compared, where nothing else is said."""


@dataclass(frozen=True)
class Settings:
    """The options; None: not given."""

    logs: Path | None = None
    mapping: Path | None = None
    maps: str | None = None
    density: str | None = None
    weather: str | None = None
    episodes: int | None = None
    source: str | None = None
    steps: int | None = None
    batch: int | None = None
    every: int | None = None
    patience: int | None = None
    memory: int | None = None
    pretrained: str | None = None
    untrained: bool | None = None
    overwrite: bool = False
    checkpoint: str | None = None
    seed: int | None = None
    out: Path | None = None
    panel: Path | None = None
    frames: str = "worst"
    mcap: Path | None = None

    def check(self, evaluate: bool, comparing: bool, run: Path | None) -> None:
        """Raises UserError for options that do not go together, before anything is opened."""
        if self.logs is not None:
            for name in ("maps", "density", "weather", "episodes"):
                if getattr(self, name) is not None:
                    what = "the weather they were recorded in" if name == "weather" else f"{name} of their own"
                    raise UserError(f"recorded episodes have {what}", where=f"--{name}", hint="Leave it out or --logs")
        elif self.mcap is not None or self.mapping is not None:
            option = "--mcap" if self.mcap is not None else "--mapping"
            raise UserError("there are no logs", where=option, hint="--logs names them")
        if self.source is not None and self.source not in SOURCES:
            raise unknown_name("source", self.source, SOURCES, where="--source")
        if comparing and (evaluate or run is not None or self.out or self.panel or self.mcap or self.checkpoint):
            raise UserError("it names two runs and compares them, nothing else", where="--compare")
        if not evaluate and not comparing and self.episodes == 1:
            raise UserError("decoding needs at least two episodes: one to learn from, one to score on")
        if self.panel is not None:
            check_panel(self.panel)
        self.wanted()

    def wanted(self) -> Wanted:
        """The frames of the panel.

        Raises:
            UserError: `--frames` is neither worst nor random nor numbers.
        """
        kind, _, count = self.frames.partition(":")
        if kind in ("worst", "random") and (not count or (count.isdecimal() and 0 < int(count) <= 64)):
            return Wanted(kind, int(count or 4), seed=self.seed or 0)  # type: ignore[arg-type]
        numbers = [part.strip() for part in self.frames.split(",")]
        if not all(part.isdecimal() for part in numbers):
            raise UserError(
                f"'{self.frames}' does not say which frames", where="--frames",
                allowed="worst, random, worst:N, random:N, or numbers as 3,17",
            )  # fmt: skip
        return Wanted("chosen", 0, tuple(int(part) for part in numbers))

    def plan(self, policy: Policy, out: Path, evaluate: bool) -> Plan:
        """How the decoder is or was trained: what is given, over the plan of what is there, or over the usual one.

        Args:
            evaluate: maps, density, weather, episodes and logs say what is scored, and not what is learned from.
        """
        recipe, found = policy.recipe, identity_in(out)
        if found is not None:
            plan = Plan.of_identity(found["plan"])
        else:
            place = recipe.simulator
            usual = _weather(None, recipe, "training")
            short = {str(name) for stage in recipe.stages if (name := getattr(stage, "autocast", None)) is not None}
            plan = Plan((place.map,), place.density, usual, autocast=min(short, default=None))
        changes: dict[str, Any] = {
            name: value
            for name in ("steps", "batch", "patience", "memory", "untrained")
            if (value := getattr(self, name)) is not None
        }
        if self.source is not None:
            changes["sources"] = SOURCES[self.source]
        if self.pretrained is not None:
            changes["pretrained"] = parse_pretrained(self.pretrained)
        if not evaluate:
            changes |= self._frames(recipe)
        return replace(plan, **changes)

    def _frames(self, recipe: Recipe) -> dict[str, Any]:
        changes: dict[str, Any] = {
            name: value for name in ("every", "seed", "episodes") if (value := getattr(self, name)) is not None
        }
        if self.logs is not None:
            changes |= {"logs": self.logs.resolve(), "mapping": self.mapping}
        if self.maps is not None:
            changes["maps"] = tuple(_maps(self.maps, recipe))
        if self.density is not None:
            changes["density"] = _density(self.density, recipe)
        if self.weather is not None:
            changes["weather"] = _weather(self.weather, recipe, "training")
        return changes


def _simulator(recipe: Recipe) -> Any:
    cls, config = configured("simulator", recipe.simulator)
    return cls(config)


def _maps(text: str, recipe: Recipe) -> list[str]:
    return parse_maps(text, _simulator(recipe).maps())


def _density(text: str | None, recipe: Recipe) -> str:
    if text is None:
        return recipe.simulator.density
    found = parse_densities(text, _simulator(recipe).densities())
    if len(found) > 1:
        raise UserError("frames are of one density at a time", where="--density")
    return found[0]


def _weather(text: str | None, recipe: Recipe, unset: Any) -> tuple[str, ...]:
    return choose_weather(text, _simulator(recipe), recipe, unset)


def decode(run: Path | None, given: Settings, evaluate: bool, say: Callable[[str], None]) -> dict[str, Any]:
    """Train what is not trained yet, then score and draw: what JSON has.

    Raises:
        UserError: whatever is wrong with run, options or logs.
        KeyboardInterrupt: Ctrl-C; the same command goes on.
    """
    folder = open_run(find_run(run)) if run is not None else default_run()
    out = given.out or results_home(folder) / "decode"
    if given.overwrite:
        begin_anew(out)
    policy = open_policy(folder, given.checkpoint, out)
    plan, decoders = _ready(policy, given, out, evaluate, say)
    player = Episodes(policy.recipe, opened_mapping(plan) if given.mapping is None else _mapping(given.mapping))
    try:
        takes = _scored_takes(policy, plan, given, evaluate)
        if given.mcap is not None:
            for path in add_to_logs(policy, decoders, player, log_takes(log_files(_logs(given))), given.mcap):
                say(f"log: {path}")
        asked = Asked(given.panel, given.wanted(), given.every or plan.every)
        result = score(policy, decoders, player, takes, asked, say)
        write_json(result, str(out / SCORES))
        return result
    finally:
        player.close()


def _ready(
    policy: Policy, given: Settings, out: Path, evaluate: bool, say: Callable[[str], None]
) -> tuple[Plan, Decoders]:
    plan = given.plan(policy, out, evaluate)
    if evaluate and identity_in(out) is None:
        say(f"there is no decoder in {out}: one is trained first")
    try:
        return plan, have_decoders(policy, plan, out, say)
    except StoppedError:
        say("stopped; the same command goes on")
        raise KeyboardInterrupt from None


def _logs(given: Settings) -> Path:
    assert given.logs is not None
    return given.logs


def _mapping(path: Path) -> Any:
    from me3bev_cli.recording.mapping import load_mapping

    return load_mapping(path)


def _scored_takes(policy: Policy, plan: Plan, given: Settings, evaluate: bool) -> Sequence[Take]:
    """The logs that are named, or the held-out ones of those that were learned from, or live episodes."""
    recipe = policy.recipe
    if evaluate and given.logs is not None:
        files = log_files(given.logs)
        check_logs(files, recipe, None if given.mapping is None else _mapping(given.mapping))
        return log_takes(files)
    if not evaluate and plan.logs is not None:
        return scenes_of(policy, plan).held_out
    density = _density(given.density, recipe) if evaluate else plan.density
    weather = _weather(given.weather, recipe, "evaluation")
    if evaluate:
        maps: Sequence[str] = _maps(given.maps or "all", recipe)
        count = len(maps) * (given.episodes or EACH)
    else:
        maps, count = plan.maps, max(2, plan.episodes // 5, len(plan.maps))
    return live_takes(maps, density, weather, count, given.seed or 0, "score")


def compare(runs: Sequence[Path], given: Settings, say: Callable[[str], None]) -> dict[str, Any]:
    """Both runs' latents on the same frames; decoders that lack are trained first.

    Raises:
        UserError: as `decode`; or the runs see other cameras.
    """
    policies, decoders = [], []
    for run in runs:
        folder = open_run(find_run(run))
        out = results_home(folder) / "decode"
        if given.overwrite:
            begin_anew(out)
        policies.append(open_policy(folder, None, out))
        decoders.append(_ready(policies[-1], given, out, True, say)[1])
    recipe = policies[0].recipe
    player = Episodes(recipe, None if given.mapping is None else _mapping(given.mapping))
    if given.logs is not None:
        files = log_files(given.logs)
        check_logs(files, recipe, player.mapping)
        takes: Sequence[Take] = log_takes(files)
    else:
        maps = _maps(given.maps or "all", recipe)
        weather = _weather(given.weather, recipe, "evaluation")
        count = len(maps) * (given.episodes or COMPARED)
        takes = live_takes(maps, _density(given.density, recipe), weather, count, given.seed or 0, "probe")
    try:
        return compare_policies(policies, decoders, player, takes, given.every or 4, say)
    finally:
        player.close()

"""Recipes by name and file: extends, overrides, defaults, round trips."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import plugin_fakes
import pytest
from plugin_fakes import RECIPE

from me3bev_cli.errors import RecipeError
from me3bev_cli.recipe_loading import dump, headline, resolve_recipe, shipped_recipes

Write = Callable[..., str]


def faults(source: str, *overrides: str) -> list[str]:
    with pytest.raises(RecipeError) as caught:
        resolve_recipe(source, overrides)
    return [str(fault) for fault in caught.value.faults]


def test_a_recipe_is_resolved_with_the_plugins_defaults_written_out(recipe: Write) -> None:
    found = resolve_recipe(recipe())
    assert found.name == "mine"
    assert found.spatial is not None
    assert found.spatial.settings == {"trunk": "tiny", "channels": 16}
    assert found.temporal is not None
    assert found.temporal.settings == {"heads": 2, "dropout": 0.1}
    assert found.simulator.map == "T3"
    assert found.simulator.settings == {"vehicles": None, "horizon": 128}
    assert found.stages[0].steps == 1000


def test_a_dumped_recipe_resolves_to_itself(recipe: Write) -> None:
    found = resolve_recipe(recipe(), ["temporal.dropout=null", "seed=7"])
    again = resolve_recipe(recipe(dump(found), "recipe.yaml"))
    assert again == found
    assert again.name == "mine"


def test_the_learning_rate_decays_in_steps(recipe: Write) -> None:
    rate = resolve_recipe(recipe()).stages[0].learning_rate
    assert [rate.at(step) for step in (0, 99, 100, 250)] == [1e-3, 1e-3, 5e-4, 2.5e-4]
    plain = resolve_recipe(recipe(), ["stages.0.learning_rate=3e-4"]).stages[0].learning_rate
    # The file's drop goes with the block that the number replaces.
    assert [plain.at(step) for step in (0, 10**6)] == [3e-4, 3e-4]


def test_extends_merges_blocks_and_replaces_lists(recipe: Write) -> None:
    recipe(RECIPE + "name: base\nseed: 5\n", "base.yaml")
    found = resolve_recipe(
        recipe("extends: base.yaml\nspatial: {trunk: large}\nobservation: {cameras: [front]}\n", "child.yaml")
    )
    assert found.name == "child"
    assert found.seed == 5
    assert found.spatial is not None
    assert found.spatial.settings == {"trunk": "large", "channels": 16}
    assert found.observation.cameras == ("front",)
    assert found.observation.height == 32


def test_another_plugin_or_kind_drops_the_keys_of_the_one_before(recipe: Write) -> None:
    recipe(name="base.yaml")
    found = resolve_recipe(recipe("extends: base.yaml\nspatial: {name: flat}\ncontext: {kind: stream}\n", "child.yaml"))
    assert found.spatial is not None
    assert (found.spatial.name, found.spatial.settings) == ("flat", {"width": 32})
    assert found.context.kind == "stream"
    again = resolve_recipe(recipe("extends: base.yaml\nspatial: {name: grid, trunk: large}\n", "child.yaml"))
    assert again.spatial is not None
    assert again.spatial.settings == {"trunk": "large", "channels": 16}


def test_null_removes_a_key_and_stays_where_null_is_a_value(recipe: Write) -> None:
    recipe(name="base.yaml")
    text = "extends: base.yaml\nspatial: {channels: null}\nobservation: null\ntemporal: null\n"
    # Without its cameras the default six are asked for, which this simulator does not have.
    assert faults(recipe(text, "child.yaml")) == ["child.yaml:3: observation.cameras: there is no camera 'front_left'"]
    found = resolve_recipe(recipe(text.replace("observation: null\n", ""), "child.yaml"))
    assert found.temporal is None
    assert found.spatial is not None
    assert found.spatial.settings["channels"] == 8
    kept = resolve_recipe(recipe("extends: base.yaml\ntemporal: {dropout: null}\n", "child.yaml"))
    assert kept.temporal is not None
    assert kept.temporal.settings == {"heads": 2, "dropout": None}


def test_extends_is_relative_to_the_file_that_says_it(recipe: Write) -> None:
    Path("deep").mkdir()
    recipe(RECIPE, "base.yaml")
    recipe("extends: ../base.yaml\nseed: 1\n", "deep/middle.yaml")
    assert resolve_recipe(recipe("extends: deep/middle.yaml\n", "top.yaml")).seed == 1


def test_a_circle_is_found(recipe: Write) -> None:
    recipe("extends: b.yaml\n", "a.yaml")
    recipe("# b\nextends: a.yaml\n", "b.yaml")
    assert faults("a.yaml") == ["b.yaml:2: extends: a circle: a.yaml -> b.yaml -> a.yaml"]
    assert faults(recipe("extends: self.yaml\n", "self.yaml")) == [
        "self.yaml:1: extends: a circle: self.yaml -> self.yaml"
    ]


def test_a_fault_in_what_is_extended_names_that_file(recipe: Write) -> None:
    recipe(RECIPE.replace("heads: 2", "heds: 2"), "base.yaml")
    assert faults(recipe("extends: base.yaml\nsede: 1\n", "child.yaml")) == [
        "base.yaml:10: temporal.heds: unknown key 'heds'; did you mean 'heads'? Allowed: heads, dropout",
        "child.yaml:2: sede: unknown key 'sede'; did you mean 'seed'? Allowed: name, simulator, weather, observation, "
        "modalities, spatial, encoders, temporal, context, fusion, policy, reward, stages, evaluation, keep_every, "
        "seed, device",
    ]


def test_overrides_reach_every_depth(recipe: Write) -> None:
    found = resolve_recipe(
        recipe(),
        [
            "seed=3",
            "policy.hidden=[8, 8]",
            "stages.0.steps=2e3",
            "temporal.name=unit",
            "temporal.layers=2",
            "encoders={vr: {hidden: []}}",
            "simulator.vehicles=0",
        ],
    )
    assert found.seed == 3
    assert found.policy.hidden == (8, 8)
    assert found.stages[0].steps == 2000
    assert found.temporal is not None
    assert (found.temporal.name, found.temporal.settings) == ("unit", {"layers": 2})
    assert (found.encoders.vr.hidden, found.encoders.vr.width) == ((), 32)
    assert found.simulator.settings["vehicles"] == 0


def test_an_override_gives_back_a_block_that_the_file_leaves_out(recipe: Write) -> None:
    text = RECIPE.replace("temporal: {name: attention, heads: 2}", "temporal: null")
    found = resolve_recipe(recipe(text), ["temporal.name=unit", "policy.distribution=beta"])
    assert found.temporal is not None
    assert found.temporal.name == "unit"
    assert found.policy.distribution == "beta"


def test_faulty_overrides_are_named_as_written(recipe: Write) -> None:
    assert faults(recipe(), "seed", "stages.1.steps=3", "stages.first.steps=3", "sed=1", "stages.0.clip=x", "a=[1") == [
        "--set seed: expected key=value, as in stages.0.steps=5000",
        "--set stages.1.steps=3: 'stages' is a list without '1'. Allowed: 0",
        "--set stages.first.steps=3: 'stages' is a list without 'first'. Allowed: 0",
        "--set a=[1: not YAML: expected ',' or ']', but got '<stream end>'",
        "--set sed=1: sed: unknown key 'sed'; did you mean 'seed'? Allowed: name, simulator, weather, observation, "
        "modalities, spatial, encoders, temporal, context, fusion, policy, reward, stages, evaluation, keep_every, "
        "seed, device",
        "--set stages.0.clip=x: stages.0.clip: expected a number, got 'x'",
    ]


def test_a_stage_changes_the_world(recipe: Write) -> None:
    stage = "  - {kind: ppo, steps: 10, map: T1, density: high, simulator: {vehicles: 2}}\n"
    found = resolve_recipe(recipe(RECIPE + stage))
    first, second = (found.simulator_in(stage) for stage in found.stages)
    assert first == found.simulator
    assert (second.map, second.density, second.settings) == ("T1", "high", {"vehicles": 2, "horizon": 128})


def test_open_sets_of_weather_are_the_simulators_default_one(recipe: Write) -> None:
    found = resolve_recipe(recipe())
    assert (found.weather.training, found.weather.evaluation) == (("clear",), ("clear",))
    assert found.weather_in(found.stages[0]) == ("clear",)
    some = resolve_recipe(recipe(), ["weather.evaluation=[night, fog]"])
    assert (some.weather.training, some.weather.evaluation) == (("clear",), ("night", "fog"))


def test_a_stage_may_have_weather_of_its_own(recipe: Write) -> None:
    second = "  - {kind: ppo, steps: 1000, weather: [night]}\n"
    found = resolve_recipe(recipe(RECIPE + second + "weather: {training: [fog, clear]}\n"))
    assert [found.weather_in(stage) for stage in found.stages] == [("fog", "clear"), ("night",)]


def test_another_simulator_drops_the_weather_of_the_one_before(install: Callable[..., None], recipe: Write) -> None:
    install(*plugin_fakes.every(), plugin_fakes.entry("simulator", "desert", f"{plugin_fakes.MODULE}:Desert"))
    recipe(RECIPE + "weather: {training: [night]}\n", "base.yaml")
    text = "extends: base.yaml\nsimulator: {name: desert, map: T1, density: low}\n"
    assert resolve_recipe(recipe(text, "child.yaml")).weather.training == ("sand",)
    assert resolve_recipe(recipe(text + "weather: {training: [heat]}\n", "child.yaml")).weather.training == ("heat",)
    assert resolve_recipe(recipe("extends: base.yaml\nsimulator: {map: T1}\n", "child.yaml")).weather.training == (
        "night",
    )


def test_shipped_recipes_have_a_headline() -> None:
    assert {"me3bev", "quickstart"} <= set(shipped_recipes())
    for path in shipped_recipes().values():
        assert headline(path), path


@pytest.mark.parametrize("name", sorted(shipped_recipes()))
def test_shipped_recipes_resolve_and_dump(name: str, tmp_path: Path) -> None:
    found = resolve_recipe(name)
    assert found.name == name.replace("/", "-")
    copy = tmp_path / "copy.yaml"
    copy.write_text(dump(found))
    assert resolve_recipe(copy) == found

"""What a user reads when a recipe is wrong: file, line, key, what, what is allowed. All of it at once."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from plugin_fakes import RECIPE, entry, every

from me3bev_cli.api import TokenSpec
from me3bev_cli.errors import RecipeError
from me3bev_cli.recipe import Recipe
from me3bev_cli.recipe_check import check_recipe
from me3bev_cli.recipe_loading import resolve_recipe, shipped_recipes
from me3bev_cli.recipe_stages import PpoStage

Write = Callable[..., str]


def faults(source: str) -> list[str]:
    with pytest.raises(RecipeError) as caught:
        resolve_recipe(source)
    assert str(caught.value) == "\n".join(map(str, caught.value.faults))
    return [str(fault) for fault in caught.value.faults]


def test_every_fault_is_reported_by_line(recipe: Write) -> None:
    text = """\
name: my run
simulator: {name: wrld, map: T3}
observation: {height: 33, cameras: []}
modalities: [bev, lidar]
spatial: {name: grid, trunk: tin, channels: 0}
encoders: {vr: {width: wide}}
temporal: attention
context: {kind: windw}
polcy: {}
stages:
  - {kind: ppo, steps: 1.5, gama: 1, clip: 1}
  - {steps: 5}
  - kind: ppo
    steps: true
    freeze: [spatal]
device: tpu
"""
    stage_keys = ", ".join(PpoStage.model_fields)
    assert faults(recipe(text)) == [
        r"mine.yaml:1: name: 'my run' is not of the right form. Allowed: what matches ^[\w.-]+$",
        "mine.yaml:1: fusion: 'fusion' is missing",
        "mine.yaml:2: simulator.density: 'density' is missing",
        "mine.yaml:2: simulator.name: unknown simulator plugin 'wrld'; did you mean 'world'? Allowed: world",
        "mine.yaml:3: observation.cameras: needs at least 1, has 0",
        "mine.yaml:4: modalities.1: 'lidar' is not among the choices. Allowed: bev, vr, nav",
        "mine.yaml:5: spatial.trunk: 'tin' is not among the choices; did you mean 'tiny'? Allowed: tiny, large",
        "mine.yaml:5: spatial.channels: 0 is out of range. Allowed: >= 1",
        "mine.yaml:6: encoders.vr.width: expected a whole number, got 'wide'",
        "mine.yaml:7: temporal: expected a block of keys, got 'attention'. Write {name: attention}",
        "mine.yaml:8: context.kind: 'windw' is not among the choices; did you mean 'window'? Allowed: window, stream",
        "mine.yaml:9: polcy: unknown key 'polcy'; did you mean 'policy'? Allowed: name, simulator, weather, "
        "observation, modalities, spatial, encoders, temporal, context, fusion, policy, reward, stages, evaluation, "
        "keep_every, seed, device",
        "mine.yaml:11: stages.0.steps: expected a whole number, got 1.5",
        "mine.yaml:11: stages.0.clip: 1 is out of range. Allowed: < 1.0",
        f"mine.yaml:11: stages.0.gama: unknown key 'gama'; did you mean 'gamma'? Allowed: {stage_keys}",
        "mine.yaml:12: stages.1.kind: 'kind' is missing",
        "mine.yaml:14: stages.2.steps: expected a whole number, got true",
        "mine.yaml:15: stages.2.freeze.0: 'spatal' is not among the choices; did you mean 'spatial'? "
        "Allowed: spatial, encoders, temporal, fusion",
        "mine.yaml:16: device: 'tpu' is not among the choices; did you mean 'cpu'? Allowed: auto, cpu, cuda",
    ]


def test_keys_of_a_nested_block_of_a_union(recipe: Write) -> None:
    assert faults(recipe(RECIPE.replace("length: 4", "lenght: 4"))) == [
        "mine.yaml:11: context.lenght: unknown key 'lenght'; did you mean 'length'? Allowed: kind, length"
    ]
    assert faults(recipe(RECIPE.replace("drop: 0.5", "drp: 0.5"))) == [
        "mine.yaml:16: stages.0.learning_rate.drp: unknown key 'drp'; did you mean 'drop'? "
        "Allowed: initial, drop, every"
    ]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("map: T3", "map: T33", "mine.yaml:1: simulator.map: unknown map 'T33'; did you mean 'T3'? Allowed: T1, T3"),
        ("density: low", "density: lo", "mine.yaml:1: simulator.density: unknown density 'lo'; did you mean 'low'?"),
        (
            "observation:",
            "weather: {training: [clear, nigth]}\nobservation:",
            "mine.yaml:2: weather.training.1: unknown weather 'nigth'; did you mean 'night'? Allowed: clear, fog",
        ),
        (
            "observation:",
            "weather:\n  evaluation: []\nobservation:",
            "mine.yaml:3: weather.evaluation: needs at least 1, has 0",
        ),
        (
            "observation:",
            "weather: {evaluation: [fog, clear, fog]}\nobservation:",
            "mine.yaml:2: weather.evaluation: names 'fog' twice",
        ),
        (
            "observation:",
            "weather: {evaluation: night}\nobservation:",
            "mine.yaml:2: weather.evaluation: expected a list, got 'night'",
        ),
        (
            "observation:",
            "weather: {trainning: [fog]}\nobservation:",
            "mine.yaml:2: weather.trainning: unknown key 'trainning'; did you mean 'training'? "
            "Allowed: training, evaluation",
        ),
        (
            "steps: 1000",
            "steps: 1000\n    weather: [fog, claer]",
            "mine.yaml:16: stages.0.weather.1: unknown weather 'claer'; did you mean 'clear'?",
        ),
        ("[front, back]", "[front, side]", "mine.yaml:3: observation.cameras: there is no camera 'side'"),
        ("height: 32", "height: 40", "mine.yaml:6: spatial: image height 40 is not a multiple of 16"),
        ("heads: 2", "heads: 3", "mine.yaml:10: temporal: width 16 is not a multiple of heads 3 (vectors of bev)"),
        ("bev: {width: 32}", "bev: {width: 8}", "mine.yaml:12: fusion: adding needs equal widths"),
        ("steps: 1000", "steps: 1000\n    map: T2", "mine.yaml:16: stages.0.map: unknown map 'T2'"),
        (
            "steps: 1000",
            "steps: 1000\n    simulator:\n      horizon: 0",
            "mine.yaml:17: stages.0.simulator.horizon: 0 is out of range. Allowed: > 0",
        ),
        (
            "steps: 1000",
            "steps: 1000\n    simulator: {horizon: null}",
            "mine.yaml:16: stages.0.simulator.horizon: expected a whole number, got null",
        ),
        (
            "steps: 1000",
            "steps: 1000\n    segment: 12",
            "mine.yaml:14: stages.0: rollout 256 is not a multiple of segment 12",
        ),
        (
            "steps: 1000",
            "steps: 1000\n    minibatch: 4096",
            "mine.yaml:14: stages.0: minibatch 4096 is more than envs x rollout = 1024 frames",
        ),
        ("spatial:\n  name: grid\n  channels: 16\n", "", "mine.yaml:1: modalities hold bev but there is no spatial"),
    ],
)
def test_stages_that_do_not_fit_together(recipe: Write, old: str, new: str, message: str) -> None:
    assert old in RECIPE
    found = faults(recipe(RECIPE.replace(old, new)))
    assert found[0].startswith(message)


def test_both_widths_that_a_temporal_plugin_refuses_are_named(recipe: Write) -> None:
    assert faults(recipe(RECIPE.replace("heads: 2", "heads: 5"))) == [
        "mine.yaml:10: temporal: width 16 is not a multiple of heads 5 (vectors of bev)",
        "mine.yaml:10: temporal: width 32 is not a multiple of heads 5 (vectors of vr and nav)",
    ]


def test_without_images_no_spatial_plugin_is_asked(recipe: Write) -> None:
    text = RECIPE.replace("simulator:", "modalities: [nav]\nsimulator:").replace("height: 32", "height: 40")
    fit = check_recipe(resolve_recipe(recipe(text)))
    assert dict(fit.widths) == {"nav": 32}
    assert set(fit.tokens) == {"nav"}


def test_the_sizes_that_the_stages_agreed_on(recipe: Write) -> None:
    fit = check_recipe(resolve_recipe(recipe()))
    assert fit.tokens["bev"] == TokenSpec(2, 2, 16)
    assert dict(fit.widths) == {"bev": 32, "vr": 32, "nav": 32}
    assert fit.fused == 32
    assert fit.rig.image_size == (32, 64)


def test_a_broken_plugin_stops_only_the_recipe_that_names_it(install: Callable[..., None], recipe: Write) -> None:
    install(*every(), entry("temporal", "broken", "no_such_module_here:Thing", "third-party", "0.3"))
    resolve_recipe(recipe())
    assert faults(recipe(RECIPE.replace("name: attention, heads: 2", "name: broken"))) == [
        "mine.yaml:10: temporal.name: temporal plugin 'broken' of third-party 0.3 does not import: "
        "ModuleNotFoundError: No module named 'no_such_module_here'. `me3bev plugins` lists what works"
    ]


def test_missing_files_list_what_is_shipped(recipe: Write) -> None:
    recipe("", "empty.yaml")
    recipe("- 1\n", "list.yaml")
    shipped = f"Allowed: a file, or one of {', '.join(shipped_recipes())}"
    assert faults("quikstart") == [f"unknown recipe 'quikstart'; did you mean 'quickstart'? {shipped}"]
    assert faults("recipes/quickstart.yaml") == [
        f"there is no file 'recipes/quickstart.yaml'; did you mean 'quickstart'? {shipped}"
    ]
    assert faults("other.yaml") == [f"there is no file 'other.yaml'. {shipped}"]
    assert faults("./") == [f"'./' is not a file. {shipped}"]
    assert faults("empty.yaml") == ["empty.yaml: the file is empty. `me3bev recipe show quickstart` is an example"]
    assert faults("list.yaml") == [
        "list.yaml:1: a recipe is a block of keys. `me3bev recipe show quickstart` is an example"
    ]


def test_what_cannot_be_extended_does_not_hide_the_other_faults(recipe: Write) -> None:
    shipped = f"Allowed: a file, or one of {', '.join(shipped_recipes())}"
    assert faults(recipe("extends: base.yaml\ntemporal: {name: unitt}\n")) == [
        f"mine.yaml:1: extends: there is no file 'base.yaml'. {shipped}",
        "mine.yaml:2: temporal.name: unknown temporal plugin 'unitt'; did you mean 'unit'? Allowed: attention, unit",
    ]
    assert faults(recipe("extends: [a, b]\n")) == ["mine.yaml:1: extends: expected a file or a shipped recipe's name"]


def test_a_recipe_made_in_python_is_checked_by_key(fakes: None) -> None:
    stage = {"kind": "ppo", "steps": 10}
    made = Recipe.model_validate(
        {
            "name": "x",
            "simulator": {"name": "world", "map": "T9", "density": "low"},
            "modalities": ["vr", "nav"],
            "fusion": {"name": "add"},
            "observation": {"cameras": ["front"]},
            "stages": [stage],
        }
    )
    with pytest.raises(RecipeError, match=r"^simulator.map: unknown map 'T9'"):
        check_recipe(made)


def test_bytes_that_are_no_text(recipe: Write) -> None:
    from pathlib import Path

    recipe()
    Path("binary.yaml").write_bytes(b"\xff\xfe\x00")
    assert faults("binary.yaml") == ["binary.yaml: is not text in UTF-8"]

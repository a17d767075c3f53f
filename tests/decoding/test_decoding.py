"""The decoder and its scores."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from fakes import LineSimulator
from typer.testing import CliRunner

from me3bev_cli.api import TokenSpec
from me3bev_cli.decoding.decoder import SemanticDecoder
from me3bev_cli.decoding.frames import Pairs
from me3bev_cli.decoding.panel import panel
from me3bev_cli.decoding.scores import confusion, iou, most_frequent, score_rows
from me3bev_cli.decoding.session import Plan, decode
from me3bev_cli.decoding.training import class_weights, decode_all, train_decoder
from me3bev_cli.errors import LogError, UserError
from me3bev_cli.evaluation.drivers import DriverSpec
from me3bev_cli.evaluation.runner import World
from me3bev_cli.main import app
from me3bev_cli.pipeline.control import Controller
from me3bev_cli.recipe import PluginChoice
from me3bev_cli.recipe_loading import resolve_recipe
from me3bev_cli.recording.collect import Recorder, Take, collect


def test_iou_by_hand() -> None:
    truth = np.array([[1, 1, 6, 0]], np.uint8)
    decoded = np.array([[1, 6, 6, 0]], np.uint8)
    values = iou(confusion(truth, decoded))
    # Road: one hit of two that either has; vehicle: one of two; other: one of one; the rest is in neither.
    assert values[[1, 6, 0]].tolist() == [0.5, 0.5, 1.0]
    assert np.isnan(values[2])


def test_rows_name_their_mask() -> None:
    truth = np.zeros((1, 200, 200), np.uint8)
    decoded = truth.copy()
    decoded[0, 0, 0] = 1
    rows = {(r["mask"], r["class"]): r["iou"] for r in score_rows(truth, decoded, "u_bev")}
    assert rows[("near", "other")] == 1.0
    assert rows[("all", "other")] == pytest.approx(1 - 1 / 40000)
    assert rows[("all", "road")] == 0.0


def test_the_trivial_baseline_is_the_commonest_class_of_a_cell() -> None:
    truth = np.array([[[1]], [[1]], [[6]]], np.uint8)
    assert most_frequent(truth).tolist() == [[1]]


def test_rare_classes_weigh_more() -> None:
    weights = class_weights(np.repeat(np.array([1, 6], np.uint8), [99, 1]))
    assert weights[6] > 5 * weights[1]
    assert weights[0] == 0


def test_the_decoder_learns_a_map_from_its_latent() -> None:
    torch.manual_seed(0)
    generator = np.random.default_rng(0)
    side = generator.integers(0, 2, 12)
    truth = np.zeros((12, 200, 200), np.uint8)
    for n, left in enumerate(side):
        truth[n, :, : 100 if left else 50] = 1
    latents = np.repeat(side.astype(np.float32)[:, None, None] * 2 - 1, 4, 1).repeat(3, 2)
    pairs = Pairs(latents, truth, np.zeros((12, 1, 3, 8, 8), np.uint8))
    decoder = SemanticDecoder(TokenSpec(2, 2, 3))
    train_decoder(decoder, pairs, steps=60, batch=4, seed=0)
    decoded = decode_all(decoder, latents)
    assert iou(confusion(truth, decoded))[1] > 0.9


def test_weights_that_are_not_resnets_are_refused(tmp_path: Path) -> None:
    bad = tmp_path / "weights.pt"
    bad.write_bytes(b"nothing")
    with pytest.raises(UserError, match="does not hold ResNet-18 weights"):
        SemanticDecoder(TokenSpec(2, 2, 3), str(bad))


def test_resnet_weights_are_loaded(tmp_path: Path) -> None:
    from torchvision.models import resnet18

    torch.manual_seed(7)
    source = resnet18(weights=None)
    torch.save(source.state_dict(), tmp_path / "r.pt")
    decoder = SemanticDecoder(TokenSpec(2, 2, 3), str(tmp_path / "r.pt"))
    assert torch.equal(decoder.deep[0][0].conv1.weight, source.layer1[0].conv1.weight)


def test_a_session_scores_and_draws(line_recipe: Path, tmp_path: Path) -> None:
    controller = Controller.untrained(resolve_recipe(line_recipe))
    plan = Plan(maps=["F1", "F2"], density="low", episodes=3, steps=3, batch=2, seed=0)
    result = decode(controller, plan, tmp_path / "out", lambda text: None)
    assert {row["source"] for row in result["rows"]} == {"u_bev", "most_frequent"}
    assert json.loads((tmp_path / "out" / "scores.json").read_text())["frames"] == 3
    assert (tmp_path / "out" / "panel.png").stat().st_size > 1000
    flat = Controller.untrained(resolve_recipe(line_recipe, ["modalities=[vr, nav]"]))
    with pytest.raises(UserError, match="no spatial encoder"):
        decode(flat, plan, tmp_path / "out", lambda text: None)


@pytest.mark.parametrize(
    ("chosen", "expected"), [(None, [("moon",), ("mist", "sun")]), (("mist",), [("mist",), ("mist",)])]
)
def test_it_learns_in_training_weather_and_is_scored_in_evaluation_weather(
    line_recipe: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, chosen: Any, expected: Any
) -> None:
    asked: list[Any] = []
    make_env = LineSimulator.make_env

    def spy(self: LineSimulator, *arguments: Any, **place: Any) -> Any:
        asked.append(place["weather"])
        return make_env(self, *arguments, **place)

    monkeypatch.setattr(LineSimulator, "make_env", spy)
    recipe = resolve_recipe(line_recipe, ["weather={training: [moon], evaluation: [mist, sun]}"])
    plan = Plan(maps=["F1"], density="low", episodes=2, steps=1, batch=2, seed=0, weather=chosen)
    decode(Controller.untrained(recipe), plan, tmp_path / "out", lambda text: None)
    assert asked == expected


def test_the_weather_of_logs_cannot_be_chosen(tmp_path: Path) -> None:
    result = CliRunner().invoke(app, ["decode", "--logs", str(tmp_path), "--weather", "night"])
    assert result.exit_code == 2
    assert "--weather: recorded episodes have the weather they were recorded in" in result.stderr


def test_logs_are_decoded_if_they_hold_what_the_policy_sees(line_recipe: Path, tmp_path: Path) -> None:
    controller = Controller.untrained(resolve_recipe(line_recipe))
    observation = controller.recipe.observation
    takes = [Take("F1", "low", number) for number in range(2)]
    for folder, seen in (("fit", observation), ("other", observation.model_copy(update={"width": 64}))):
        world = World(PluginChoice(name="line"), seen)
        collect(Recorder(world, DriverSpec("autopilot", "autopilot"), 0, tmp_path / folder), takes, workers=0)

    def run(folder: str) -> dict[str, object]:
        plan = Plan(["F1"], "low", episodes=0, steps=2, batch=2, seed=0, logs=tmp_path / folder)
        return decode(controller, plan, tmp_path / "out", lambda text: None)

    assert run("fit")["frames"] == 3
    with pytest.raises(LogError, match=r"holds images \(2, 3, 16, 64\), the policy 'line' sees \(2, 3, 16, 32\)"):
        run("other")


def test_a_panel_holds_cameras_and_maps() -> None:
    images = np.zeros((6, 3, 16, 44), np.uint8)
    picture = panel(images, [np.zeros((200, 200), np.uint8)] * 2)
    assert picture.shape[0] == 256
    assert picture.dtype == np.uint8

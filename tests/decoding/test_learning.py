"""A decoder's training: it learns, is stopped, goes on and is refused what it is not."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from me3bev_cli.decoding.decoder import LatentSpec, SemanticDecoder
from me3bev_cli.decoding.latents import Probe, Read, Reader
from me3bev_cli.decoding.learning import Scenes, StoppedError, Training, score_frames
from me3bev_cli.decoding.moments import UNKNOWN, Episodes, Moment, Take
from me3bev_cli.decoding.plan import Plan
from me3bev_cli.decoding.pool import Batch, Kept, Pool, kept
from me3bev_cli.decoding.session import Policy, have_decoders, open_policy
from me3bev_cli.decoding.store import DECODER, TRAINING, load_decoders
from me3bev_cli.errors import CheckpointError, UserError
from me3bev_cli.pipeline.transfer import to_tensors

from .conftest import MakeRun

PLAN = Plan(("F1", "F2"), "low", ("sun",), episodes=5, steps=6, batch=2, check=2, patience=50)


def _say(text: str) -> None:
    pass


def _frame(level: float, truth: np.ndarray[Any, Any]) -> Kept:
    moment = Moment(np.zeros((1, 3, 8, 8), np.uint8), truth, np.ones((200, 200), bool), UNKNOWN, 0.0)
    return kept(moment, Read({"u_bev": np.full((3, 2, 2), level, np.float16)}))


def test_a_decoder_learns_a_map_from_its_latent() -> None:
    torch.manual_seed(0)
    left, right = np.zeros((200, 200), np.uint8), np.zeros((200, 200), np.uint8)
    left[:, :100], right[:, 100:] = 1, 1
    frames = [_frame(-1.0, left), _frame(1.0, right)]
    decoder = SemanticDecoder(LatentSpec(3, 2, 2))
    optimizer = torch.optim.Adam(decoder.parameters(), 2e-3)
    batch = Batch.of(frames, torch.device("cpu"))
    for _ in range(15):
        loss = torch.nn.functional.cross_entropy(decoder(batch.latents["u_bev"]), batch.truth)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    decoder.train()  # Statistics of two frames alone are not what evaluation would use.
    found = decoder(batch.latents["u_bev"]).argmax(1)
    assert (found == batch.truth).float().mean() > 0.9


def test_a_pool_keeps_the_newest_rounds_that_fit() -> None:
    frame = _frame(0.0, np.zeros((200, 200), np.uint8))
    pool = Pool(5 * frame.bytes)
    for number in range(4):
        pool.add(number, [frame, frame])
    assert pool.numbers == [2, 3]
    assert len(pool) == 4
    pool.add(4, [frame] * 9)
    assert pool.numbers == [4]


def test_frames_of_unknown_sight_count_wholly() -> None:
    moment = Moment(np.zeros((1, 3, 8, 8), np.uint8), np.full((200, 200), 6, np.uint8), None, UNKNOWN, 0.0)
    batch = Batch.of([kept(moment, Read())], torch.device("cpu"))
    assert batch.seen.all()
    assert (batch.truth == 6).all()
    assert score_frames({}, [], torch.device("cpu")) == {}


@pytest.mark.parametrize("context", ["{kind: window, length: 4}", "stream"])
def test_a_latent_is_what_the_policy_has(make_run_of: MakeRun, tmp_path: Path, context: str) -> None:
    run = make_run_of(*(["context={kind: stream}"] if context == "stream" else []))
    policy = open_policy(run, None, tmp_path / "none")
    player, take = Episodes(policy.recipe), Take("a", "F1", "sun", "low", 5)
    reader = Reader([Probe("u_bev", policy.network, "u_bev")])
    read = {step: latents["u_bev"] for step, _, latents in reader.read(player.play(take), 3)}
    env = policy.recipe and player._environment(take)
    observation, _ = env.reset(seed=5)
    network, state, starts = policy.network, policy.network.initial_state(1), torch.ones(1, dtype=torch.bool)
    for step in range(12):
        batch = to_tensors({key: value[None] for key, value in observation.items()}, network.device)
        with torch.inference_mode():
            latents, state = network.latents(batch, state, starts)
        starts = torch.zeros_like(starts)
        if step % 3 == 0:
            own = latents["bev"][0].T.reshape(8, 2, 2).numpy()
            assert np.allclose(read[step].astype(np.float32), own, atol=2e-3)
        observation = env.step(env.unwrapped.autopilot())[0]
    assert list(read) == [0, 3, 6, 9]


def _weights(out: Path) -> dict[str, torch.Tensor]:
    modules = load_decoders(out, torch.device("cpu")).modules
    return {f"{name}.{key}": value for name, own in modules.items() for key, value in own.state_dict().items()}


# Without memory for all frames, episodes are drawn again, and older rounds leave the pool.
@pytest.mark.parametrize(("memory", "stop_at"), [(1000, 4), (0, 5)])
def test_a_stopped_training_goes_on_exactly(
    make_run_of: MakeRun, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, memory: int, stop_at: int
) -> None:
    policy = open_policy(make_run_of(), None, tmp_path / "whole")
    plan = dataclasses.replace(PLAN, episodes=6, memory=memory, untrained=False)
    have_decoders(policy, plan, tmp_path / "whole", _say)
    assert not (tmp_path / "whole" / TRAINING).exists()
    learn = Training._learn

    def stopping(self: Training, chosen: Any) -> float:
        self.stop.asked = self.step + 1 >= stop_at
        return learn(self, chosen)

    with monkeypatch.context() as patch:
        patch.setattr(Training, "_learn", stopping)
        with pytest.raises(StoppedError):
            have_decoders(policy, plan, tmp_path / "stopped", _say)
    assert not (tmp_path / "stopped" / DECODER).exists()
    have_decoders(policy, plan, tmp_path / "stopped", _say)
    whole, stopped = _weights(tmp_path / "whole"), _weights(tmp_path / "stopped")
    assert all(torch.equal(value, stopped[key]) for key, value in whole.items())


def test_training_ends_when_scores_no_longer_rise(
    make_run_of: MakeRun, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("me3bev_cli.decoding.learning.BETTER", 1.0)
    policy = open_policy(make_run_of(), None, tmp_path / "out")
    plan = dataclasses.replace(PLAN, steps=100, check=1, patience=3, untrained=False)
    decoders = have_decoders(policy, plan, tmp_path / "out", _say)
    assert decoders.about["steps"] == 4
    assert decoders.about["ended"] == "no better score in 3 rounds"


def test_another_plan_or_policy_does_not_go_on(make_run_of: MakeRun, tmp_path: Path) -> None:
    policy = open_policy(make_run_of(), None, tmp_path / "out")
    plan = dataclasses.replace(PLAN, steps=2, untrained=False)
    have_decoders(policy, plan, tmp_path / "out", _say)
    with pytest.raises(UserError, match=r"holds a decoder of another plan: steps 2, not 9.*--overwrite"):
        have_decoders(policy, dataclasses.replace(plan, steps=9), tmp_path / "out", _say)
    other = Policy(policy.run, policy.network, policy.recipe, policy.identity | {"weights": "others"})
    with pytest.raises(CheckpointError, match="is of step_000000064, or of other weights"):
        have_decoders(other, plan, tmp_path / "out", _say)
    (tmp_path / "out" / DECODER).write_bytes(b"broken")
    with pytest.raises(CheckpointError, match=r"is damaged.*--overwrite"):
        have_decoders(policy, plan, tmp_path / "out", _say)


def test_a_full_disk_is_told(make_run_of: MakeRun, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    policy = open_policy(make_run_of(), None, tmp_path / "out")

    def full(*_: Any) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("me3bev_cli.files.os.replace", full)
    with pytest.raises(UserError, match=r"training.pt: cannot be written: No space left on device"):
        have_decoders(policy, PLAN, tmp_path / "out", _say)
    assert not list((tmp_path / "out").iterdir())


def test_held_out_episodes_are_never_learned_from(make_run_of: MakeRun, tmp_path: Path) -> None:
    from me3bev_cli.decoding.session import scenes_of

    policy = open_policy(make_run_of(), None, tmp_path / "out")
    scenes: Scenes = scenes_of(policy, PLAN)
    assert (len(scenes.learned), len(scenes.held_out)) == (4, 1)
    assert not {take.seed for take in scenes.learned} & {take.seed for take in scenes.held_out}

"""Alarms: each says what happened, keeps the last good checkpoint, and the run goes on or says how to."""

from __future__ import annotations

import errno
import json
import os
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from fakes import LineEnv
from typer.testing import CliRunner

from me3bev_cli.main import app
from me3bev_cli.parallel_envs import ParallelEnvs
from me3bev_cli.recipe_alarms import Alarms
from me3bev_cli.recipe_loading import dump, resolve_recipe
from me3bev_cli.stopping import Stop
from me3bev_cli.training import folders
from me3bev_cli.training.alarms import (
    AstrayError,
    DiskError,
    NonFiniteError,
    Watch,
    guard_gradients,
)
from me3bev_cli.training.best import SCORE, read_best
from me3bev_cli.training.checkpoint import (
    Progress,
    checkpoints,
    clear_leftovers,
    find_checkpoint,
    load_progress,
    save_best,
)
from me3bev_cli.training.curve import read_metrics
from me3bev_cli.training.display import Display
from me3bev_cli.training.kill_check import same_weights
from me3bev_cli.training.run import make_run
from me3bev_cli.training.trainer import Trainer


def trainer(path: Path, run: Path, *overrides: str) -> Trainer:
    recipe = resolve_recipe(path, overrides)
    if not run.exists():
        make_run(run, dump(recipe))
    return Trainer(recipe, run, Display(sum(s.steps for s in recipe.stages), len(recipe.stages)), Stop())


def alarms(run: Path) -> list[dict[str, Any]]:
    path = run / "alarms.jsonl"
    return [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []


def test_a_gradient_that_is_not_finite_never_reaches_the_weights(tmp_path: Path) -> None:
    module = torch.nn.Linear(2, 2)
    optimizer = torch.optim.Adam(module.parameters())
    guard_gradients(optimizer, module, tmp_path)
    module(torch.ones(1, 2)).sum().backward()
    optimizer.step()
    before = {key: value.clone() for key, value in module.state_dict().items()}
    assert module.bias.grad is not None
    module.bias.grad[1] = torch.inf
    with pytest.raises(NonFiniteError, match=r"1 parameters, first 'bias'.*lower learning_rate"):
        optimizer.step()
    assert all(torch.equal(before[key], value) for key, value in module.state_dict().items())


def test_a_loss_that_is_not_finite_stops_the_run(line_recipe: Path, tmp_path: Path) -> None:
    """The squared error of such returns is beyond the largest float."""
    run = tmp_path / "run"
    arguments = ["train", str(line_recipe), "--out", str(run), "--set", "stages.0.reward_scale=1e30"]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 2
    assert "loss of the last update is inf; the update is not kept" in result.stderr
    assert f"me3bev train --resume {run}" in result.stderr
    assert load_progress(find_checkpoint(run)).total_steps == 0
    # The recipe is mended, and the run goes on.
    text = (run / "recipe.yaml").read_text()
    (run / "recipe.yaml").write_text(text.replace("reward_scale: 1.0e+30", "reward_scale: 1.0"))
    assert CliRunner().invoke(app, ["train", "--resume", str(run)]).exit_code == 0


@pytest.mark.parametrize(
    ("what", "message"), [("reward", "reward nan in environment"), ("road", "output is not finite")]
)
def test_what_the_simulator_gives_must_be_finite(
    line_recipe: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, what: str, message: str
) -> None:
    step = LineEnv.step

    def broken(env: LineEnv, action: Any) -> Any:
        observation, reward, *rest = step(env, action)
        if env.steps == 9 and what == "road":
            observation["road"][2] = np.nan
        return observation, np.nan if env.steps == 9 and what == "reward" else reward, *rest

    monkeypatch.setattr(LineEnv, "step", broken)
    with pytest.raises(NonFiniteError, match=message):
        trainer(line_recipe, tmp_path / "run").train()


def test_kl_and_entropy_are_watched(tmp_path: Path) -> None:
    told: list[str] = []
    watch = Watch(Alarms(), 0.02, tmp_path, lambda kind, text: told.append(kind))
    for kl, entropy in [(0.3, 1.0), (0.3, 1.0), (0.1, 1.0), (0.3, 1.0), (0.3, 1.0), (0.3, -7.0), (0.3, -7.0)]:
        watch.update(kl, entropy)
    assert told == ["kl"]
    other = Watch(Alarms(), 0.02, tmp_path, lambda kind, text: told.append(kind))
    other.restore(watch.state())
    other.update(None, -7.0)
    assert told == ["kl", "entropy"]
    strict = Watch(Alarms(stop=True, updates=1), None, tmp_path, lambda *_: None)
    strict.update(0.29, 0.0)
    with pytest.raises(AstrayError, match=r"KL was over 0.3 in 1 updates in a row, last 0.4. Going on unchanged"):
        strict.update(0.4, 0.0)


def test_an_alarm_is_told_logged_and_counted(
    line_recipe: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = tmp_path / "run"
    trainer(line_recipe, run, "stages.0.alarms={entropy: 9.0, updates: 2}").train()
    assert "warning: the policy's entropy was below 9 in 2 updates in a row" in capsys.readouterr().err
    assert [(row["steps"], row["alarm"]) for row in alarms(run)] == [(64, "entropy")]
    assert [row.get("entropy_alarms") for row in read_metrics(run)] == [None, None, 1, None, None, None]


def test_losing_workers_changes_nothing_in_the_result(
    line_recipe: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    short = "stages.0.steps=96"
    trainer(line_recipe, tmp_path / "undisturbed", short).train()
    send, sent = ParallelEnvs.step_async, [0]
    fate = {20: signal.SIGKILL, 40: signal.SIGSTOP}

    def disturbed(envs: ParallelEnvs, actions: Any) -> None:
        sent[0] += 1
        if sent[0] in fate:
            os.kill(envs._pool.workers[1].process.pid or 0, fate[sent[0]])
        send(envs, actions)

    monkeypatch.setattr(ParallelEnvs, "step_async", disturbed)
    run = tmp_path / "run"
    trainer(line_recipe, run, short, "stages.0.workers=2", "stages.0.worker_timeout=3").train()
    said = [row["text"] for row in alarms(run)]
    # More on a machine that is so busy that it answers late, which changes nothing either.
    assert any("killed by SIGKILL" in text for text in said)
    assert any("gave no answer for 3 s" in text for text in said)
    assert sum(row.get("worker_alarms", 0) for row in read_metrics(run)) == len(said)
    assert same_weights(tmp_path / "undisturbed", run)


def full(real: Callable[..., Any], after: int) -> Callable[..., Any]:
    """A function of the system that finds the disk full after so many calls."""
    count = [0]

    def function(*args: Any, **kwargs: Any) -> Any:
        count[0] += 1
        if count[0] > after:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return real(*args, **kwargs)

    return function


def test_a_full_disk_keeps_the_last_checkpoint(
    line_recipe: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = tmp_path / "run"
    with monkeypatch.context() as patch:
        # A checkpoint has four files: the third one of the second checkpoint does not fit.
        patch.setattr(folders, "_write", full(folders._write, 6))
        result = CliRunner().invoke(app, ["train", str(line_recipe), "--out", str(run)])
    assert result.exit_code == 2
    assert "step_000000128: cannot be written: No space left on device" in result.stderr
    assert f"The last good checkpoint is step_000000064. Make room, then go on with: me3bev train --resume {run}" in (
        result.stderr
    )
    assert [path.name for path in (run / "checkpoints").iterdir()] == ["step_000000064"]
    assert CliRunner().invoke(app, ["train", "--resume", str(run)]).exit_code == 0


def test_a_full_disk_keeps_the_best_so_far(line_recipe: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    one = trainer(line_recipe, tmp_path / "run")
    first = save_best(one.run, one.network, one.recipe, Progress(total_steps=10), {SCORE: 1.0})
    with monkeypatch.context() as patch:
        patch.setattr(folders, "_write", full(folders._write, 2))
        with pytest.raises(DiskError, match="best_000000020: cannot be written"):
            save_best(one.run, one.network, one.recipe, Progress(total_steps=20), {SCORE: 2.0})
    assert list(first.parent.iterdir()) == [first]
    assert read_best(one.run) == {"steps": 10, SCORE: 1.0}
    second = save_best(one.run, one.network, one.recipe, Progress(total_steps=20), {SCORE: 2.0})
    assert list(first.parent.iterdir()) == [second]


def test_a_log_that_cannot_be_written_stops_the_run(line_recipe: Path, tmp_path: Path) -> None:
    if not Path("/dev/full").exists():
        pytest.skip("the system has no device that is always full")
    run = tmp_path / "run"
    one = trainer(line_recipe, run)
    (run / "metrics.jsonl").unlink()
    (run / "metrics.jsonl").symlink_to("/dev/full")
    with pytest.raises(DiskError, match=r"metrics.jsonl: cannot be written.*There is no checkpoint yet"):
        one.train()


def test_torch_tells_what_the_file_told(tmp_path: Path) -> None:
    if not Path("/dev/full").exists():
        pytest.skip("the system has no device that is always full")
    with pytest.raises(OSError, match="No space left") as error:
        folders._write(Path("/dev/full"), lambda file: torch.save({"a": torch.zeros(100_000)}, file))
    assert error.value.errno == errno.ENOSPC


def test_a_damaged_checkpoint_is_set_aside(
    line_recipe: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    whole, run = tmp_path / "whole", tmp_path / "run"
    trainer(line_recipe, whole).train()
    trainer(line_recipe, run).train()
    newest = checkpoints(run)[-1]
    data = (newest / "trainer.pt").read_bytes()
    (newest / "trainer.pt").write_bytes(data[: len(data) // 2])
    again = trainer(line_recipe, run)
    again.resume()
    assert again.progress.total_steps == 128
    assert "trainer.pt is missing or damaged" in capsys.readouterr().err
    assert [row["alarm"] for row in alarms(run)] == ["checkpoint"]
    again.train()
    assert same_weights(whole, run)
    assert {path.name for path in (run / "checkpoints").iterdir()} == {
        "step_000000064", "step_000000128", "step_000000192", "damaged_step_000000192",
    }  # fmt: skip


def test_leftovers_of_a_process_that_died(tmp_path: Path) -> None:
    folder = tmp_path / "checkpoints"
    for name in (".step_3.part", ".step_2.old", ".step_1.old", "step_1"):
        (folder / name).mkdir(parents=True)
        (folder / name / "progress.json").write_text(name)
    assert [path.name for path in checkpoints(tmp_path)] == ["step_1"]
    clear_leftovers(tmp_path)
    assert sorted(path.name for path in folder.iterdir()) == ["step_1", "step_2"]
    assert (folder / "step_2" / "progress.json").read_text() == ".step_2.old"

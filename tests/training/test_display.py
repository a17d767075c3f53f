"""What training shows: in a pipe, in a terminal, for any kind of stage."""

from __future__ import annotations

import io
import os
import pty
import re
from typing import Any

import pytest

from me3bev_cli.training.display import Display
from me3bev_cli.training.pace import Pace, clock

PLAN = [("perception", 1000), ("ppo", 4000), ("ppo", 4000)]


def row(stage: int = 0, stage_steps: int = 100, steps: int | None = None, **more: Any) -> dict[str, Any]:
    kind = PLAN[stage][0]
    done = sum(number for _, number in PLAN[:stage])
    steps = done + stage_steps if steps is None else steps
    standing = {"stage": stage, "kind": kind, "steps": steps, "stage_steps": stage_steps, "episodes": 3}
    return standing | more


EVALUATED = {
    "eval_score": 41.25, "eval_collision_rate": 0.5, "eval_completion": 0.625, "eval_success": 0.25,
    "eval_reward_per_step": 1.0, "eval_episodes": 8, "eval_seconds": 3.2,
}  # fmt: skip


class Time:
    def __init__(self) -> None:
        self.value = 50.0

    def __call__(self) -> float:
        return self.value


def test_time_left_comes_from_the_present_stage() -> None:
    time = Time()
    pace = Pace(PLAN, now=time)
    assert pace.left(row(0, 0)) == "?"
    time.value += 10
    pace.see(row(0, 500), updated=True)
    assert pace.rate == 50
    # 500 steps of this kind are left; how long another kind takes is not known.
    assert pace.left(row(0, 500)) == "0:10 and 2 more stages"
    time.value += 10
    pace.see(row(0, 1000), updated=True)
    time.value += 100
    pace.see(row(1, 100), updated=True)
    # The next stage runs at 1 step/s: 3,900 of its own and 4,000 of the one after it.
    assert pace.rate == 1
    assert pace.left(row(1, 100)) == clock(7900) == "2:11:40"


def test_the_rate_follows_the_last_updates() -> None:
    time = Time()
    pace = Pace([("ppo", 10_000)], now=time)
    for update in range(1, 30):
        time.value += 10 if update < 10 else 1
        pace.see({"stage": 0, "stage_steps": 10 * update, "steps": 10 * update}, updated=True)
    assert pace.rate == pytest.approx(10)


def test_earlier_sittings_do_not_count() -> None:
    time = Time()
    pace = Pace([("ppo", 1000)], now=time)
    pace.begin(600)
    time.value += 2
    pace.see({"stage": 0, "stage_steps": 700, "steps": 700}, updated=True)
    assert pace.rate == 50


def test_plain_lines_for_every_kind_of_stage() -> None:
    stream = io.StringIO()
    display = Display(9000, 3, stream=stream, plan=PLAN)
    display.step(lambda: pytest.fail("asked for a line that nobody sees"))
    display.say("reward: the paper's")
    display.update(row(0, 100, loss=0.51234, iou_vehicle=0.25, learning_rate=1e-3))
    display.update(
        row(1, 64, reward_per_step=1.234, collision_rate=0.5, route_completion=None, kl=0.0123, value_loss=3)
    )
    display.update(row(1, 64, **EVALUATED))
    display.update(row(1, 128, **EVALUATED | {"eval_score": 40.0}))
    display.close()
    lines = stream.getvalue().splitlines()
    assert "\x1b" not in stream.getvalue()
    assert lines[0] == "reward: the paper's"
    assert lines[1].startswith("stage 1/3 perception  100/9,000 steps")
    assert lines[1].endswith("loss 0.512  iou vehicle 0.250")
    assert lines[2].endswith("reward/step 1.23  collisions 0.50  completion -  kl 0.0123")
    assert lines[3] == (
        "evaluation at 1,064 steps  driving score 41.2  collisions 0.50  completion 0.62  success 0.25"
        "  (8 episodes in 3 s)  best so far"
    )
    assert lines[4].endswith("(8 episodes in 3 s)")
    assert display.best == (41.25, 1064)


def test_the_best_of_earlier_sittings_counts() -> None:
    stream = io.StringIO()
    display = Display(9000, 3, stream=stream, plan=PLAN)
    display.begin(500, {"steps": 400, "eval_score": 50.0})
    display.update(row(1, 64, **EVALUATED))
    assert "best so far" not in stream.getvalue()


def in_terminal(monkeypatch: pytest.MonkeyPatch, term: str) -> str:
    """What a display writes to a pseudo-terminal of 80 columns."""
    monkeypatch.setenv("TERM", term)
    monkeypatch.setenv("COLUMNS", "80")
    master, slave = pty.openpty()
    with open(slave, "w") as stream:
        display = Display(9000, 3, stream=stream, plan=PLAN)
        display.LIVE_EVERY = -1.0
        display.say("begins")
        display.update(row(1, 64, reward_per_step=1.234, collision_rate=0.5, kl=0.0123))
        display.update(row(1, 64, **EVALUATED))
        display.step(lambda: row(1, 100, reward_per_step=1.5, collision_rate=None))
        display.say("a warning [not markup]")
        display.update(row(2, 10, reward_per_step=1.75))
        display.close()
        stream.write("end\n")
    text = b""
    try:
        while b"end\r\n" not in text:
            text += os.read(master, 65_536)
    finally:
        os.close(master)
    return text.decode()


def test_a_table_in_a_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    raw = in_terminal(monkeypatch, "xterm")
    text = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", raw)
    assert raw.count("\x1b[?25l") == raw.count("\x1b[?25h") == 1, "the cursor comes back"
    assert "a warning [not markup]" in text
    live = text[text.index("a warning") :]
    # Values that a step does not know stay those of the last update.
    shown = text[: text.index("a warning")]
    assert re.search(r"collisions\s+0\.50", shown)
    assert re.search(r"reward/step\s+1\.50", shown)
    assert re.search(r"best evaluation\s+41\.2 at 1,064", live)
    assert re.search(r"stage\s+3/3 ppo\s+steps\s+5,010/9,000", live)
    # The last line of a stage that is over stays to be read.
    assert re.search(r"stage 2/3 ppo  1,064/9,000 steps .*reward/step 1.23", text)
    assert max(len(line) for line in text.splitlines() if "evaluation at" not in line and "steps  " not in line) <= 80


def test_what_is_not_measured_at_every_update_stays(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TERM", "xterm")
    master, slave = pty.openpty()
    with open(slave, "w") as stream:
        display = Display(9000, 3, stream=stream, plan=PLAN)
        display.update(row(0, 100, loss=0.5, seen_road=0.75))
        display.update(row(0, 200, loss=0.25))
        display.close()
        assert display.last["seen_road"] == 0.75
        assert display.last["loss"] == 0.25
        display.update(row(1, 64, reward_per_step=1.0))
        display.close()
    assert "seen_road" not in display.last
    os.close(master)


def test_a_dumb_terminal_gets_plain_lines(monkeypatch: pytest.MonkeyPatch) -> None:
    text = in_terminal(monkeypatch, "dumb")
    assert "\x1b" not in text
    assert "stage 2/3 ppo" in text

"""Kills a training run at random moments, goes on each time, and compares the end with an undisturbed run's.

A check for developers: `python -m me3bev_cli.training.kill_check small --kills 10 --set stages.0.steps=6144`.
"""

from __future__ import annotations

import json
import multiprocessing
import os
import random
import signal
import sys
import tempfile
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Annotated, Any

import typer

STARTING, COLLECTING, UPDATING, SAVING, BETWEEN = "starting", "collecting", "updating", "saving", "between"
WALL_CLOCK = ("steps_per_second", "eval_seconds")
"""Keys of a row that may differ."""
HEAVY = ("torch._dynamo", "matplotlib.figure", "matplotlib.backends.backend_agg")


def train_and_report(arguments: Sequence[str], report: Connection, log: Path, prepare: Callable[[], None]) -> None:
    """`me3bev train` in this process, telling through a pipe what it is at; what it prints goes to a file."""
    with open(log, "a") as file:
        os.dup2(file.fileno(), 1)
        os.dup2(file.fileno(), 2)
    prepare()
    from me3bev_cli.main import app
    from me3bev_cli.training import trainer
    from me3bev_cli.training.sequence_ppo import SequencePPO

    phases = [STARTING]

    def told(owner: Any, name: str, phase: str) -> None:
        function = getattr(owner, name)

        def reporting(*args: Any, **kwargs: Any) -> Any:
            phases.append(phase)
            report.send(phase)
            try:
                return function(*args, **kwargs)
            finally:
                phases.pop()
                report.send(phases[-1] if len(phases) > 1 else BETWEEN)

        setattr(owner, name, reporting)

    report.send(STARTING)
    told(SequencePPO, "collect_rollouts", COLLECTING)
    told(SequencePPO, "train", UPDATING)
    told(trainer, "save_checkpoint", SAVING)
    app(["train", *arguments])


@dataclass
class Moment:
    """When to kill: so many seconds after the run has come to a phase for the nth time."""

    phase: str
    nth: int
    delay: float


@dataclass
class Outcome:
    """What the check found."""

    kills: list[str] = field(default_factory=list)
    """The phase in which each kill came."""
    same_weights: bool = False
    same_rows: bool = False


def _say(text: str) -> None:
    print(text, flush=True)


class KillCheck:
    """Runs the check.

    Args:
        recipe: a recipe file or the name of a shipped one.
        overrides: `KEY=VALUE` as for `me3bev train --set`.
        folder: where runs and logs are kept.
        seed: of the moments.
        prepare: called first in each training process; can be pickled.
        say: called with what happens.
    """

    def __init__(
        self,
        recipe: str,
        overrides: Sequence[str],
        folder: Path,
        seed: int,
        prepare: Callable[[], None],
        say: Callable[[str], None] = _say,
    ) -> None:
        self.recipe, self.overrides, self.folder, self.prepare, self.say = recipe, overrides, folder, prepare, say
        self.random = random.Random(seed)
        method = "forkserver" if "forkserver" in multiprocessing.get_all_start_methods() else "spawn"
        self.context: Any = multiprocessing.get_context(method)
        if method == "forkserver":
            # Each sitting begins with torch and the trainer loaded.
            self.context.set_forkserver_preload([*HEAVY, "me3bev_cli.main", "me3bev_cli.training.ppo_stage"])
        self.lasted: dict[str, list[float]] = defaultdict(list)
        """Seconds that each phase took, as far as it was seen to its end."""

    def run(self, kills: int) -> Outcome:
        """Train once without and once with so many kills."""
        outcome = Outcome()
        begin = [self.recipe, *(f"--set={override}" for override in self.overrides)]
        whole, killed = self.folder / "whole", self.folder / "killed"
        begun = time.monotonic()
        self._sit([*begin, "--out", str(whole)], None)
        self._must_be_done(whole)
        self.say(f"undisturbed: {time.monotonic() - begun:.1f} s")
        phases = [COLLECTING, UPDATING, SAVING, STARTING]
        for number in range(kills):
            if number % len(phases) == 0:
                self.random.shuffle(phases)
            there = (killed / "metrics.jsonl").exists()
            phase = COLLECTING if not there and phases[number % 4] == STARTING else phases[number % 4]
            end = self._sit(["--resume", str(killed)] if there else [*begin, "--out", str(killed)], self._moment(phase))
            if end is None:
                self.say(f"the run was finished before kill {number + 1}")
                break
            outcome.kills.append(end)
            self.say(f"kill {number + 1}: {end}; {_standing(killed)}")
        if (killed / "metrics.jsonl").exists() and not (killed / "summary.json").exists():
            self._sit(["--resume", str(killed)], None)
        self._must_be_done(killed)
        outcome.same_weights = same_weights(whole, killed)
        outcome.same_rows = rows(whole) == rows(killed)
        return outcome

    def _moment(self, phase: str) -> Moment:
        usual = sorted(self.lasted[phase] or [0.5])
        nth = 1 if phase == STARTING else self.random.choice((1, 1, 1, 2))
        return Moment(phase, nth, self.random.uniform(0, usual[len(usual) // 2]))

    def _sit(self, arguments: Sequence[str], moment: Moment | None) -> str | None:
        """Train; the phase in which the process was killed, None when it has come to its end."""
        here, there = self.context.Pipe(duplex=False)
        log = self.folder / "sittings.log"
        process = self.context.Process(target=train_and_report, args=(list(arguments), there, log, self.prepare))
        process.start()
        there.close()
        try:
            return self._watch(process, here, moment)
        finally:
            process.kill()
            process.join()

    def _watch(self, process: Any, told: Connection, moment: Moment | None) -> str | None:
        """Follow a sitting; kill it when its moment has come."""
        phase, since, seen = STARTING, time.monotonic(), Counter[str]()
        while True:
            try:
                now_at = told.recv()
            except EOFError:
                process.join()
                return None
            self.lasted[phase].append(time.monotonic() - since)
            phase, since = now_at, time.monotonic()
            seen[phase] += 1
            if moment is not None and phase == moment.phase and seen[phase] == moment.nth:
                time.sleep(moment.delay)
                process.kill()
                process.join()
                with suppress(EOFError):
                    while told.poll():
                        phase = told.recv()
                return phase if process.exitcode == -signal.SIGKILL else None

    def _must_be_done(self, run: Path) -> None:
        if not (run / "summary.json").exists():
            raise RuntimeError(f"training failed:\n{(self.folder / 'sittings.log').read_text()[-4000:]}")


def _standing(run: Path) -> str:
    """What is on the disk of a run that was killed."""
    folder = run / "checkpoints"
    names = sorted(path.name for path in folder.iterdir()) if folder.is_dir() else []
    whole = [name for name in names if name.startswith("step_")]
    part = [name for name in names if name.startswith(".")]
    return f"newest checkpoint {whole[-1] if whole else 'none'}" + (f", left over {', '.join(part)}" if part else "")


def rows(run: Path) -> list[dict[str, Any]]:
    """The log without what depends on the clock."""
    lines = [json.loads(line) for line in (run / "metrics.jsonl").read_text().splitlines()]
    return [{key: value for key, value in row.items() if key not in WALL_CLOCK} for row in lines]


def same_weights(one: Path, other: Path) -> bool:
    """Whether the newest checkpoints of two runs hold the same bits."""
    import torch
    from safetensors.torch import load_file

    from me3bev_cli.training.checkpoint import WEIGHTS, find_checkpoint

    a, b = (load_file(find_checkpoint(run) / WEIGHTS) for run in (one, other))
    return a.keys() == b.keys() and all(torch.equal(a[key], b[key]) for key in a)


def _nothing() -> None:
    pass


def main(
    recipe: str,
    kills: Annotated[int, typer.Option(min=1)] = 10,
    overrides: Annotated[list[str] | None, typer.Option("--set", metavar="KEY=VALUE")] = None,
    seed: int = 0,
    folder: Annotated[Path | None, typer.Option(help="Default: a temporary one.")] = None,
) -> None:
    """Kill a training run at random moments and compare its end with an undisturbed run's."""
    place = folder or Path(tempfile.mkdtemp(prefix="me3bev-kill-"))
    place.mkdir(parents=True, exist_ok=True)
    outcome = KillCheck(recipe, overrides or [], place, seed, _nothing).run(kills)
    counts = ", ".join(f"{count} while {phase}" for phase, count in Counter(outcome.kills).items())
    print(f"{len(outcome.kills)} kills: {counts}")
    for name, same in (("final weights", outcome.same_weights), ("log", outcome.same_rows)):
        print(f"{name}: {'the same' if same else 'DIFFERENT'}")
    sys.exit(0 if outcome.same_weights and outcome.same_rows else 1)


if __name__ == "__main__":
    typer.run(main)

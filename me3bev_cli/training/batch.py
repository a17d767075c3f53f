"""A batch: several runs, one after another or some at a time, each in a process of its own.

Run folders are made before the first run begins, so that the folder alone says what there is to do: the same command,
or `me3bev train --resume FOLDER`, goes on with what is not finished. No torch here.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import IO

from me3bev_cli.errors import RunError, UserError
from me3bev_cli.recipe import Recipe
from me3bev_cli.recipe_loading import dump, resolve_recipe
from me3bev_cli.stopping import Stop
from me3bev_cli.training.listing import describe, find_runs, finished
from me3bev_cli.training.run import is_run, make_run, runs_root
from me3bev_cli.workers import THREAD_VARIABLES

COMMAND = (sys.executable, "-m", "me3bev_cli")
"""Starts me3bev."""
PATIENCE = 20.0
"""Seconds that runs are given to write their checkpoints before they are asked once more."""
ENDS_WELL = (0, 130, -signal.SIGINT)
"""Exit codes of runs that are finished, or stopped as they were asked to, even before they had begun to listen."""
LOOK_EVERY = 0.1
TELL_EVERY = 60.0
"""Seconds between two words on runs that train beside each other and show nothing themselves."""


def parse_seeds(text: str) -> list[int]:
    """`0,1,2` or `0-4` -> seeds, each once.

    Raises:
        UserError: it is neither.
    """
    seeds: list[int] = []
    for part in text.split(","):
        first, dash, last = part.strip().partition("-")
        if not first.isdecimal() or (dash and not (last.isdecimal() and int(last) >= int(first))):
            raise UserError(f"'{text}' names no seeds", where="--seeds", allowed="as 0,1,2 or 0-4")
        seeds.extend(range(int(first), int(last or first) + 1))
    return list(dict.fromkeys(seeds))


def prepare(
    recipes: Sequence[str],
    seeds: str | None,
    overrides: Sequence[str],
    out: Path | None,
    perception: Path | None = None,
) -> list[Path]:
    """The run folders NAME-seedK of a batch, made where they are not there yet.

    Args:
        recipes: files or shipped names.
        seeds: as `parse_seeds` takes them; None: each recipe's own.
        out: where; None: the folder of runs.
        perception: a run from which those whose recipes begin with perception take what it teaches.

    Raises:
        UserError: a recipe is wrong, two have the same name, or a folder holds a run of another recipe.
    """
    chosen = parse_seeds(seeds) if seeds is not None else None
    planned: dict[Path, Recipe] = {}
    for source in recipes:
        extra = [[f"seed={seed}"] for seed in chosen] if chosen is not None else [[]]
        for more in extra:
            recipe = resolve_recipe(source, [*overrides, *more])
            run = (out or runs_root()) / f"{recipe.name}-seed{recipe.seed}"
            if run in planned:
                raise UserError(f"two runs would be named {run.name}", hint="Give the recipes names of their own")
            planned[run] = recipe
    for run, recipe in planned.items():
        if is_run(run) and (run / "recipe.yaml").read_text() != dump(recipe):
            raise RunError(f"{run} is a run of another recipe", hint="--out FOLDER keeps this batch apart")
        if not is_run(run) and run.exists() and any(run.iterdir()):
            raise RunError(f"{run} exists and is no run", hint="--out FOLDER keeps this batch apart")
    _make({run: recipe for run, recipe in planned.items() if not is_run(run)}, perception)
    return list(planned)


def _make(planned: Mapping[Path, Recipe], perception: Path | None) -> None:
    """Make run folders; none if one of them cannot begin with the perception of another run."""
    if perception is None:
        for run, recipe in planned.items():
            make_run(run, dump(recipe))
        return
    from me3bev_cli.training.takeover import begin_run, check_takeover

    looking = {run: recipe for run, recipe in planned.items() if recipe.stages[0].kind == "perception"}
    for recipe in looking.values():
        check_takeover(recipe, perception)
    for run, recipe in planned.items():
        begin_run(recipe, run, perception if run in looking else None)


def unfinished(folder: Path) -> list[Path]:
    """The runs of a batch's folder, in the order of their names; empty when there is none.

    Raises:
        RunError: there is no such folder.
    """
    if not folder.is_dir():
        raise RunError(f"there is no run at {folder}", hint="`me3bev runs` lists them")
    return sorted(find_runs(folder))


class Batch:
    """Trains runs.

    Args:
        runs: run folders; those that are finished are left alone.
        parallel: how many at a time. Each is given its share of the cores, and of those as many threads, environment
            workers included.
        threads: for the network of each run; None: its share of the cores.
    """

    def __init__(self, runs: Sequence[Path], parallel: int, threads: int | None = None) -> None:
        self.waiting = deque(run for run in runs if not finished(run))
        self.skipped = len(runs) - len(self.waiting)
        self.count = len(self.waiting)
        self.slots = shares(min(parallel, max(1, self.count)))
        self.alone = len(self.slots) == 1
        self.threads = threads
        self.busy: dict[int, tuple[Path, subprocess.Popen[bytes]]] = {}
        self.failed: list[Path] = []
        self.told = time.monotonic()

    def train(self, stop: Stop) -> list[Path]:
        """Train every run to its end, or until a stop is asked for; returns those that failed.

        A run that fails does not stop the others. A stop is passed on: each run writes a checkpoint.
        """
        say(f"{self.count} runs to train, {len(self.slots)} at a time; {self.skipped} finished already")
        try:
            while (self.waiting and not stop.asked) or self.busy:
                for slot in range(len(self.slots)):
                    if slot not in self.busy and self.waiting and not stop.asked:
                        self._start(slot)
                if stop.asked:
                    self._interrupt()
                self._look()
                self._tell()
                time.sleep(LOOK_EVERY)
        finally:
            for _, process in self.busy.values():
                process.kill()
                process.wait()
        return self.failed

    def _start(self, slot: int) -> None:
        run = self.waiting.popleft()
        command = [*COMMAND, "train", "--resume", str(run)]
        command += ["--threads", str(self.threads)] if self.threads is not None else []
        log = None if self.alone else run / "output.txt"
        say(f"training {run}" + (f" (output: {log})" if log else ""))
        with _confined(self.slots[slot]), _appending(log) as output:
            # A group of its own: Ctrl-C reaches it once, through this process.
            process = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=output,
                env=self._environment(slot),
                process_group=0,
            )
        self.busy[slot] = (run, process)

    def _environment(self, slot: int) -> dict[str, str]:
        threads = str(self.threads or len(self.slots[slot]))
        return os.environ | ({} if self.alone and self.threads is None else dict.fromkeys(THREAD_VARIABLES, threads))

    def _look(self) -> None:
        """Take note of the runs that have ended."""
        for slot, (run, process) in list(self.busy.items()):
            code = process.poll()
            if code is None:
                continue
            del self.busy[slot]
            well = code in ENDS_WELL
            if not well:
                self.failed.append(run)
            entry = describe(run)
            reason = "" if well else f" with exit code {code}"
            say(f"{run}: {'failed' if reason else entry.state}{reason} at step {entry.steps:,} of {entry.total:,}")

    def _tell(self) -> None:
        """Now and then, how far the runs are; one that is alone shows it itself."""
        if self.alone or time.monotonic() - self.told < TELL_EVERY:
            return
        self.told = time.monotonic()
        for run, _ in self.busy.values():
            entry = describe(run)
            reward = "" if entry.reward_per_step is None else f", reward/step {entry.reward_per_step:.2f}"
            say(f"{run}: stage {entry.stage}, step {entry.steps:,} of {entry.total:,}{reward}")

    def _interrupt(self) -> None:
        """Ask every run to stop, once more when they take long; then no longer ask."""
        for wait in (PATIENCE, PATIENCE):
            for _, process in self.busy.values():
                if process.poll() is None:
                    process.send_signal(signal.SIGINT)
            end = time.monotonic() + wait
            while any(process.poll() is None for _, process in self.busy.values()) and time.monotonic() < end:
                time.sleep(LOOK_EVERY)
        for _, process in self.busy.values():
            if process.poll() is None:
                process.kill()
                process.wait()


def shares(parts: int) -> list[set[int]]:
    """The processors that may be used, dealt out to so many runs; where they are too few, runs share one."""
    here = getattr(os, "sched_getaffinity", None)
    cores = sorted(here(0)) if here is not None else list(range(os.cpu_count() or 1))
    if parts >= len(cores):
        return [{cores[part % len(cores)]} for part in range(parts)]
    return [set(cores[part * len(cores) // parts : (part + 1) * len(cores) // parts]) for part in range(parts)]


@contextmanager
def _confined(cores: set[int]) -> Iterator[None]:
    """Processes that are started inside use these processors only, as far as the system can tell them so."""
    if not hasattr(os, "sched_setaffinity"):
        yield
        return
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, cores)
    try:
        yield
    finally:
        os.sched_setaffinity(0, before)


@contextmanager
def _appending(path: Path | None) -> Iterator[IO[bytes] | None]:
    """A file to append to; None, which stands for this process's own output, without a path."""
    if path is None:
        yield None
        return
    with open(path, "ab") as file:
        yield file


def say(text: str) -> None:
    """A line for people."""
    print(text, file=sys.stderr, flush=True)

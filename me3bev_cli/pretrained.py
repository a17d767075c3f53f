"""The policy in the box: a trained `small/me3bev` that comes with the package, as a run folder that is only read.

Its card, beside the weights, says what it was made from and what it can do. Nothing here needs torch.
"""

from __future__ import annotations

import sys
from importlib.resources import files
from pathlib import Path

from me3bev_cli.training.run import is_run, newest_run, runs_root

NAME = "pretrained"


def box() -> Path:
    """The run folder of the shipped policy."""
    return Path(str(files("me3bev_recipes"))) / "weights" / NAME


def is_boxed(run: Path) -> bool:
    """Whether a run or checkpoint folder is the shipped policy's."""
    return run.resolve().is_relative_to(box().resolve())


def results_home(run: Path) -> Path:
    """Where what a run is measured by is kept: with the run; for the shipped one among the runs."""
    return runs_root() / NAME if is_boxed(run) else run


def named(run: Path) -> str:
    """A run as a user would name it."""
    return NAME if is_boxed(run) else str(run)


def find_run(name: str | Path) -> Path:
    """The run that a user names: the shipped policy's for its name, unless there is a run of that name here."""
    path = Path(name)
    return box() if str(name) == NAME and not is_run(path) else path


def run_path(name: str) -> Path | None:
    """The folder that a name stands for: itself, a run's of that name, the shipped policy's; None without any."""
    for path in (Path(name), runs_root() / name):
        if path.is_dir() and (name != NAME or is_run(path)):
            return path
    return box() if name == NAME else None


def default_run() -> Path:
    """What drives when no run is named: the newest run, or the shipped policy where there is none; says which."""
    newest = newest_run()
    if newest is None:
        _say(f"no run is named, and there is none under {runs_root()}: this is the shipped policy, `{NAME}`")
        return box()
    _say(f"no run is named: this is the newest, {newest}; `{NAME}` is the shipped policy")
    return newest


def _say(text: str) -> None:
    print(f"me3bev: {text}", file=sys.stderr, flush=True)

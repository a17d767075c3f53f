"""Run folders: where a training keeps what it makes.

runs/NAME-DATE-TIME/
    recipe.yaml      as resolved
    versions.json    of me3bev and of what it builds on
    metrics.jsonl    one line per update
    tensorboard/
    checkpoints/
    reward.png       reward per step against environment steps
    summary.json     when it is finished
"""

from __future__ import annotations

import os
import time
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING

from me3bev_cli.errors import RunError
from me3bev_cli.files import atomic_write_text

if TYPE_CHECKING:
    from me3bev_cli.recipe import Recipe

PACKAGES = ("me3bev", "torch", "stable-baselines3", "gymnasium", "highway-env", "numpy", "numba")


def runs_root() -> Path:
    """Where runs are kept: `runs` below the current folder, or the folder that ME3BEV_RUNS names."""
    return Path(os.environ.get("ME3BEV_RUNS", "runs"))


def is_run(path: Path) -> bool:
    """Whether a folder is a run."""
    return (path / "recipe.yaml").is_file() and (path / "metrics.jsonl").exists()


def newest_run(root: Path | None = None) -> Path | None:
    """The run whose log was written last, or None."""
    root = root or runs_root()
    runs = [path for path in root.iterdir() if is_run(path)] if root.is_dir() else []
    return max(runs, key=lambda path: (path / "metrics.jsonl").stat().st_mtime_ns, default=None)


def require_newest_run() -> Path:
    """The newest run.

    Raises:
        RunError: there is none.
    """
    newest = newest_run()
    if newest is None:
        raise RunError(f"there is no run under {runs_root()}", hint="`me3bev train RECIPE` makes one, or name it")
    return newest


def open_run(path: str | Path) -> Path:
    """The run folder at `path`.

    Raises:
        RunError: it is not there or is no run.
    """
    run = Path(path)
    if not is_run(run):
        newest = newest_run()
        hint = f"The newest run is {newest}" if newest else "`me3bev train RECIPE` makes one"
        raise RunError(f"{run} is not a run folder", hint=hint)
    return run


def choose_run(recipe: Recipe, out: Path | None = None) -> Path:
    """Where a new run will be kept: `out`, or a folder named by recipe and time that is not there yet.

    Raises:
        RunError: `out` exists and is not empty.
    """
    if out is not None:
        if out.exists() and (not out.is_dir() or any(out.iterdir())):
            raise RunError(f"{out} exists and is not empty", hint=f"`me3bev train --resume {out}` goes on with it")
        return out
    stem = f"{recipe.name}-{time.strftime('%Y%m%d-%H%M%S')}"
    run, count = runs_root() / stem, 1
    while run.exists():
        count += 1
        run = runs_root() / f"{stem}-{count}"
    return run


def make_run(run: Path, text: str) -> None:
    """Make the folder of a new run; `text` is the resolved recipe."""
    run.mkdir(parents=True, exist_ok=True)
    atomic_write_text(run / "recipe.yaml", text)
    (run / "metrics.jsonl").touch()


def versions() -> dict[str, str]:
    """Versions of what a result depends on."""
    found = {}
    for name in PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "not installed"
    return found

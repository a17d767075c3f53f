"""Run folders: where a training keeps what it makes.

runs/NAME-DATE-TIME/
    recipe.yaml      as resolved
    versions.json    of me3bev and of what it builds on, the machine, the seed
    metrics.jsonl    one line per update and per evaluation
    alarms.jsonl     what went wrong on the way, if anything
    tensorboard/
    checkpoints/     step_N: the newest, and one of every so many; best_N: the best by periodic evaluation
    reward.png       reward per step against environment steps
    summary.json     when it is finished

Nothing here needs torch.
"""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

from me3bev_cli.errors import RunError
from me3bev_cli.files import atomic_write_text

if TYPE_CHECKING:
    from me3bev_cli.recipe import Recipe

LOCK = ".training"
"""Of a run folder: held by the process that trains it."""

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


@contextmanager
def training_in(run: Path) -> Iterator[None]:
    """Hold a run while it is trained: nobody else trains it, and `is_training` says so. A dead process holds nothing.

    Raises:
        RunError: it is being trained already.
    """
    with open(run / LOCK, "a") as file:
        for attempt in range(5):
            if _lock(file):
                break
            time.sleep(0.1 * attempt)  # `is_training` may be asking.
        else:
            raise RunError(f"{run} is being trained by another process", hint="`me3bev runs` shows how far it is")
        yield


def is_training(run: Path) -> bool:
    """Whether a process of this machine trains a run at this moment."""
    try:
        with open(run / LOCK) as file:
            return not _lock(file)
    except OSError:
        return False


def _lock(file: IO[str]) -> bool:
    """Take a lock that ends with the file's last holder; False when another has it, True where there are none."""
    try:
        import fcntl
    except ImportError:
        return True
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return False
    return True


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


def provenance(recipe: Recipe) -> dict[str, Any]:
    """What else decided a run's figures, beside its recipe: versions, machine, and the seed that all others come from.

    Seeds of episodes, of actions and of minibatches are derived from it (`seeding.derive_seed`).
    """
    from me3bev_cli.bench.machine import machine

    here = machine()
    return {"versions": versions() | {"python": here.pop("python")}, "machine": here, "seed": recipe.seed}

"""An evaluation's folder: what it is for, and whether another command may go on in it.

OUT/
    evaluation.json   what decides the episodes, written before the first one
    episodes/METHOD/  one log per episode, each written when it is finished: metrics can be computed from them again
    results.json      what was evaluated, how each metric is defined, the rows; comparisons and published rows if asked
    results.csv, .md, .tex, .png
    snapshot.npz      what the cameras saw at one instant of the first episode
    timing.json       where the time went, per sitting; all other files are the same whenever they are made
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from me3bev_cli.errors import UserError
from me3bev_cli.evaluation.maps import shorten
from me3bev_cli.files import atomic_write_text

JSON, CSV, PICTURE, EPISODES = "results.json", "results.csv", "results.png", "episodes"
MARKDOWN, LATEX, MANIFEST, TIMING = "results.md", "results.tex", "evaluation.json", "timing.json"
SNAPSHOT = "snapshot.npz"
FORMAT = 1
"""Of the manifest."""
ADVICE = "Choose another --out, or --overwrite begins anew"


@dataclass(frozen=True)
class Manifest:
    """What an evaluation's folder is for."""

    maps: tuple[str, ...]
    densities: tuple[str, ...]
    episodes: int
    methods: Mapping[str, Mapping[str, Any]]
    """Label -> identity, in the order of the tables."""

    def refuse(self, earlier: Manifest, out: Path) -> None:
        """Raises UserError unless everything that `earlier` holds belongs to this evaluation too."""
        for label, identity in earlier.methods.items():
            mine = self.methods.get(label)
            if mine is None:
                raise _another(out, f"it has the driver '{label}', which is not asked for")
            for key in dict.fromkeys((*identity, *mine)):
                if identity.get(key) != mine.get(key):
                    raise _another(out, f"the {key.replace('_', ' ')} of '{label}' {_change(identity, mine, key)}")
        for what, old, new in (("maps", earlier.maps, self.maps), ("densities", earlier.densities, self.densities)):
            if not set(old) <= set(new):
                raise _another(out, f"its {what} are {shorten(old)}, not {shorten(new)}")
        if earlier.episodes > self.episodes:
            raise _another(out, f"it has {earlier.episodes} episodes per map and density, not {self.episodes}")


def _another(out: Path, difference: str) -> UserError:
    return UserError(f"{out} holds another evaluation: {difference}", where="--out", hint=ADVICE)


def _change(old: Mapping[str, Any], new: Mapping[str, Any], key: str) -> str:
    if key in ("seed", "checkpoint", "device", "simulator", "driver"):
        return f"is {old.get(key)}, not {new.get(key)}"
    return "differs"


def prepare_folder(out: Path, manifest: Manifest, overwrite: bool) -> None:
    """Make the folder this evaluation's own; what it holds of it already is kept.

    Raises:
        UserError: it holds something else, or cannot be written.
    """
    check_folder(out, manifest, overwrite)
    if overwrite and out.is_dir():
        clear(out)
    text = json.dumps({"format": FORMAT, **asdict(manifest)}, indent=2, ensure_ascii=False) + "\n"
    atomic_write_text(out / MANIFEST, text)


def check_folder(out: Path, manifest: Manifest, overwrite: bool) -> None:
    """Raises UserError when the folder holds something that this evaluation would mix with or lose."""
    if out.exists() and not out.is_dir():
        raise UserError(f"{out} is not a folder", where="--out")
    if not out.is_dir() or not any(out.iterdir()):
        return
    if not (out / MANIFEST).is_file():
        if not (out / JSON).is_file():
            raise UserError(f"{out} exists and holds something other than an evaluation", where="--out")
        if not overwrite:
            raise _another(out, "an older version made it, which did not say what decided its episodes")
    elif not overwrite:
        manifest.refuse(read_manifest(out), out)


def read_manifest(out: Path) -> Manifest:
    """What a folder is for.

    Raises:
        UserError: the manifest is damaged.
    """
    path = out / MANIFEST
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
        if data["format"] != FORMAT:
            raise UserError("a newer version of me3bev made this evaluation", where=str(path), hint=ADVICE)
        methods = {str(label): dict(found) for label, found in data["methods"].items()}
        return Manifest(tuple(data["maps"]), tuple(data["densities"]), int(data["episodes"]), methods)
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise UserError(f"is damaged ({type(error).__name__}: {error})", where=str(path), hint=ADVICE) from error


def clear(out: Path) -> None:
    """Remove what evaluations write, and nothing else."""
    try:
        shutil.rmtree(out / EPISODES, ignore_errors=True)
        for name in (JSON, CSV, PICTURE, MARKDOWN, LATEX, MANIFEST, TIMING, SNAPSHOT):
            (out / name).unlink(missing_ok=True)
    except OSError as error:
        raise UserError(f"cannot be removed: {error.strerror}", where=str(out)) from error


def discard_empty(out: Path) -> None:
    """Take back a folder in which no episode was finished, so that it does not stand in the way of the next try."""
    logs = out / EPISODES
    if (out / JSON).exists() or (logs.is_dir() and any(path.is_file() for path in logs.rglob("*"))):
        return
    clear(out)
    with suppress(OSError):  # It holds something else.
        out.rmdir()
        out.parent.rmdir()

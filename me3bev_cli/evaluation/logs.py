"""Folders of episode logs: those of an evaluation, and MCAP recordings."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from me3bev_cli.errors import LogError
from me3bev_cli.evaluation.episode import Episode, load
from me3bev_cli.evaluation.folder import SNAPSHOT

SUFFIXES = (".npz", ".mcap")


@dataclass
class Found:
    """What the logs hold, and which of them hold nothing any more."""

    episodes: list[Episode] = field(default_factory=list)
    lost: list[str] = field(default_factory=list)
    """A sentence for each log that cannot be read."""


def log_files(folder: Path) -> list[Path]:
    """The logs in a folder and below it; hidden ones are being written, and an evaluation's picture is none.

    Raises:
        LogError: the folder is not there, or holds none.
    """
    if folder.is_file() and folder.suffix in SUFFIXES:
        return [folder]
    if not folder.is_dir():
        raise LogError("there is no such folder of logs", where=str(folder))
    found = [path for suffix in SUFFIXES for path in folder.rglob(f"[!.]*{suffix}") if path.is_file()]
    files = sorted(path for path in found if path.name != SNAPSHOT)
    if not files:
        hint = "`me3bev eval` and `me3bev collect` write them"
        raise LogError("the folder holds no log", where=str(folder), allowed=", ".join(SUFFIXES), hint=hint)
    return files


def read_folders(folders: Sequence[Path]) -> Found:
    """Every episode of the logs, by driver, density, map and index. What is whole is taken, what is not is named.

    Raises:
        LogError: a folder holds no log, none of the logs is whole, or two of them hold the same episode.
    """
    found = Found()
    first: dict[tuple[str, str, str, str, int, int], Path] = {}
    files = [path for folder in folders for path in log_files(folder)]
    for path in files:
        try:
            episode = read_log(path)
        except LogError as error:
            found.lost.append(str(error))
            continue
        key = (episode.driver, episode.density, episode.map, episode.weather, episode.index, episode.seed)
        if key in first:
            raise LogError(f"holds the same episode as {first[key]}", where=str(path), hint="Name one of them")
        first[key] = path
        found.episodes.append(episode)
    if not found.episodes:
        raise LogError(f"none of the {len(files)} logs is whole; the first: {found.lost[0]}")
    return found


def read_log(path: Path) -> Episode:
    """The episode of one log, of either kind.

    Raises:
        LogError: it is damaged, or its drive was cut off.
    """
    if path.suffix == ".npz":
        return load(path)
    from me3bev_cli.recording.logfile import LogWarning
    from me3bev_cli.recording.reader import read_episode

    with warnings.catch_warnings():
        warnings.simplefilter("error", LogWarning)
        try:
            return read_episode(path)
        except LogWarning as warning:
            # The reader would take what is left of it, but half a drive is no episode.
            raise LogError(str(warning), where=str(path)) from None


def kept(folder: Path, label: str) -> Found:
    """What an evaluation has of one method so far; nothing is there before its first episode is finished."""
    found = Found()
    for path in sorted((folder / label).glob("[!.]*.npz")):
        try:
            found.episodes.append(load(path))
        except LogError as error:
            found.lost.append(str(error))
    return found

"""MCAP episodes back into steps."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from me3bev_cli.api import StepRecord
from me3bev_cli.errors import LogError
from me3bev_cli.evaluation.episode import STEP_DTYPE, Episode, from_records
from me3bev_cli.recording.frames import FrameLog
from me3bev_cli.recording.logfile import LogFile
from me3bev_cli.recording.writer import METADATA, OUTCOME

OBSERVATION = ("images", "road", "vehicle", "navigation")
RECORD = ("state", "reward", "speed", "infractions")


@dataclass(frozen=True, eq=False)
class Step:
    """One recorded step. Images (C, 3, H, W) are in the order in which the file names its cameras."""

    observation: dict[str, NDArray[Any]]
    action: NDArray[np.float32]
    record: dict[str, Any]
    bev: NDArray[np.uint8]


def episode_files(folder: Path) -> list[Path]:
    """The MCAP files of a folder, by name.

    Raises:
        LogError: the folder is not there or holds none.
    """
    if not folder.is_dir():
        what = "this is a file, not a folder" if folder.exists() else "there is no such folder"
        raise LogError(what, where=str(folder), hint="`me3bev collect --out DIR` records logs")
    files = sorted(folder.glob("*.mcap"))
    if not files:
        raise LogError(f"{folder} holds no MCAP file", hint="`me3bev collect --out DIR` records some")
    return files


def log_files(place: Path) -> list[Path]:
    """The logs that a path means: a file itself, or those of a folder.

    Raises:
        LogError: there are none.
    """
    return [place] if place.is_file() else episode_files(place)


def read_metadata(path: Path) -> dict[str, str]:
    """What `collect` wrote about the episode.

    Raises:
        LogError: the file is damaged.
    """
    return LogFile(path).metadata.get(METADATA, {})


def read_steps(path: Path) -> Iterator[Step]:
    """The episode's steps, in order. Of a file that is cut off, those in its whole chunks, with a LogWarning.

    Raises:
        LogError: the file is damaged, or it lacks a topic (the message names it).
    """
    log = FrameLog(path, (*OBSERVATION, "action", *RECORD, "bev"))
    for number in range(len(log)):
        frame = log.frame(number)
        observation = {key: frame[key] for key in OBSERVATION}
        yield Step(observation, frame["action"], record_of(frame), frame["bev"])


def record_of(frame: dict[str, Any]) -> dict[str, Any]:
    """The StepRecord of a frame that has the parts `RECORD`."""
    return {**frame["state"], **frame["infractions"], "reward": frame["reward"], "speed": frame["speed"]}


def read_records(path: Path) -> tuple[list[StepRecord], FrameLog]:
    """What the environment reported of each step, without decoding an image, and the log.

    Raises:
        LogError: as `read_steps`.
    """
    log = FrameLog(path, RECORD)
    records: list[Any] = [record_of(log.frame(number)) for number in range(len(log))]
    return records, log


def read_episode(path: Path) -> Episode:
    """The drive in a log as evaluations keep it, so that every metric can be computed from it again.

    Raises:
        LogError: as `read_steps`; or the log was not made by `me3bev collect`, or its records have other fields.
    """
    records, log = read_records(path)
    about, outcome = log.metadata, log.file.metadata.get(OUTCOME, {})
    try:
        given: dict[str, Any] = {
            "map": about["map"],
            "density": about["density"],
            "weather": about["weather"],
            "seed": int(about["seed"]),
            "index": int(about["index"]),
            "driver": about["driver"],
        }
    except (KeyError, ValueError) as error:
        raise LogError(
            f"the log does not say which episode it is ({error})", where=str(path), hint="`me3bev collect` writes it"
        ) from None
    lacking = sorted(set(STEP_DTYPE.names or ()) - set(records[0]))
    if lacking:
        raise LogError(f"the log's records lack {', '.join(lacking)}", where=str(path), hint="Record it again")
    # Nobody knows how a drive went on whose file is cut off.
    ended: Any = outcome.get("ended") or ("collision" if records[-1]["collision"] else "stopped")
    return from_records(records, ended=ended, **given)

"""MCAP episodes back into arrays."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.Grid_pb2 import Grid
from google.protobuf.message import DecodeError
from mcap.exceptions import McapError
from mcap.reader import make_reader
from numpy.typing import NDArray

from me3bev_cli.errors import LogError
from me3bev_cli.recording.messages import grid_array, image_array
from me3bev_cli.recording.writer import BEV_TOPIC, STEP_TOPIC


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
    files = sorted(folder.glob("*.mcap")) if folder.is_dir() else []
    if not files:
        raise LogError(f"{folder} holds no MCAP file", hint="`me3bev collect --out DIR` records some")
    return files


def read_metadata(path: Path) -> dict[str, str]:
    """What `collect` wrote about the episode.

    Raises:
        LogError: the file is damaged.
    """
    with open(path, "rb") as file:
        try:
            found = [dict(m.metadata) for m in make_reader(file).iter_metadata() if m.name == "me3bev"]
        except (McapError, EOFError, ValueError) as error:
            raise LogError(f"{path} is damaged or truncated ({error})") from error
    return found[0] if found else {}


def read_steps(path: Path) -> Iterator[Step]:
    """The episode's steps, in order.

    Raises:
        LogError: the file is damaged, or it lacks a topic (the message names it).
    """
    frame: dict[str, Any] = {}
    images: dict[str, NDArray[np.uint8]] = {}
    any_step = False
    with open(path, "rb") as file:
        try:
            for schema, channel, message in make_reader(file).iter_messages(log_time_order=False):
                if schema is not None and schema.name == "foxglove.CompressedImage":
                    images[channel.topic] = image_array(CompressedImage.FromString(message.data))
                elif channel.topic == BEV_TOPIC:
                    frame["bev"] = grid_array(Grid.FromString(message.data))
                elif channel.topic == STEP_TOPIC:
                    any_step = True
                    yield _step(path, json.loads(message.data), images, frame)
                    images, frame = {}, {}
        except (McapError, EOFError, ValueError, DecodeError) as error:
            raise LogError(f"{path} is damaged or truncated ({error})") from error
    if not any_step:
        raise LogError(f"{path} has no topic {STEP_TOPIC}", hint="`me3bev collect` writes it")


def _step(path: Path, data: dict[str, Any], images: dict[str, Any], frame: dict[str, Any]) -> Step:
    if not images or "bev" not in frame:
        missing = BEV_TOPIC if images else "/camera/NAME/image"
        raise LogError(f"{path} has no topic {missing} before a {STEP_TOPIC}", hint="`me3bev collect` writes it")
    observation = {key: np.array(data[key], np.float32) for key in ("road", "vehicle", "navigation")}
    observation["images"] = np.stack(list(images.values()))
    record = {key: math.nan if value is None else value for key, value in data["record"].items()}
    return Step(observation, np.array(data["action"], np.float32), record, frame["bev"])

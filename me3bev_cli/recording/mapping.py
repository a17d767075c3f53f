"""Which topic of a log holds what: as `collect` names them, or as a YAML file says."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from me3bev_cli.errors import LogError
from me3bev_cli.recording import topics

SINGLE: dict[str, Any] = {
    "bev": topics.BEV,
    "pose": topics.TRANSFORM,
    **topics.VECTORS,
    "action": topics.ACTION,
    "reward": topics.REWARD,
    "speed": topics.SPEED,
    "infractions": topics.INFRACTIONS,
    "state": topics.STATE,
    "actors": topics.ACTORS,
}
"""Part of a frame -> topic, for parts of one message."""
PER_CAMERA = {"images": topics.image_topic, "depth": topics.depth_topic, "semantics": topics.semantics_topic}
"""Part of a frame -> topic of a camera, for parts of one message for each camera."""


class TopicMapping(BaseModel):
    """Topics of a log that was not made by `me3bev collect`. Whatever is not named is not read.

    The messages have Foxglove's schemas in protobuf: images `foxglove.CompressedImage` or `foxglove.RawImage`,
    calibration `foxglove.CameraCalibration`, `bev` `foxglove.Grid`, depth and semantics `foxglove.RawImage`.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    cameras: dict[str, str] = Field(min_length=1, description="camera -> topic of its images, in order")
    calibration: dict[str, str] = Field(default={}, description="camera -> topic of its calibration")
    mounts: dict[str, str] = Field(default={}, description="camera -> topic of its transform to the ego")
    depth: dict[str, str] = Field(default={}, description="camera -> topic of its depth")
    semantics: dict[str, str] = Field(default={}, description="camera -> topic of its pixels' classes")
    bev: str | None = Field(default=None, description="topic of the semantic map")
    pose: str | None = Field(default=None, description="topic of the ego's transform")
    road: str | None = Field(default=None, description="topic of R")
    vehicle: str | None = Field(default=None, description="topic of V")
    navigation: str | None = Field(default=None, description="topic of N")
    action: str | None = Field(default=None, description="topic of the action")
    reward: str | None = None
    speed: str | None = None
    infractions: str | None = None
    state: str | None = None
    actors: str | None = None
    tolerance: float = Field(default=0.05, ge=0, description="seconds by which what belongs to one frame may lie apart")

    def topics_of(self, part: str) -> list[str]:
        """The topics of a part of a frame, one for each camera or a single one; none when it is not mapped."""
        if part in PER_CAMERA:
            named = self.cameras if part == "images" else getattr(self, part)
            return [named[camera] for camera in self.cameras if camera in named]
        topic = getattr(self, part)
        return [] if topic is None else [topic]


def own_mapping(present: Iterable[str], metadata: Mapping[str, str]) -> TopicMapping:
    """How `collect` names topics, for a file that has the topics `present`."""
    found = [topic for topic in present if topic.startswith("/camera/") and topic.endswith("/image")]
    names = [topic.split("/")[2] for topic in found if topic.count("/") == 3]
    order = [name for name in metadata.get("cameras", "").split(",") if name] or names or ["NAME"]
    return TopicMapping(
        cameras={name: topics.image_topic(name) for name in order},
        calibration={name: topics.calibration_topic(name) for name in order},
        mounts={name: topics.mount_topic(name) for name in order},
        depth={name: topics.depth_topic(name) for name in order},
        semantics={name: topics.semantics_topic(name) for name in order},
        **SINGLE,
    )


def load_mapping(path: Path) -> TopicMapping:
    """The mapping in a YAML file.

    Raises:
        LogError: it is missing, no YAML, or says something else.
    """
    try:
        data: Any = yaml.safe_load(path.read_text("utf-8"))
    except OSError as error:
        raise LogError(f"cannot be read: {error.strerror}", where=str(path)) from None
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise LogError(f"this is no YAML ({' '.join(str(error).split())})", where=str(path)) from None
    if not isinstance(data, dict):
        raise LogError("a mapping of topics is made of keys", where=str(path), allowed=", ".join(_keys()))
    try:
        return TopicMapping(**{str(key): value for key, value in data.items()})
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"])
        raise LogError(f"{key}: {first['msg'].lower()}", where=str(path), allowed=", ".join(_keys())) from None


def _keys() -> list[str]:
    return list(TopicMapping.model_fields)

"""Cameras of logs: what a log says about them, and whether several agree."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from google.protobuf.message import DecodeError
from numpy.typing import NDArray

from me3bev_cli.errors import LogError
from me3bev_cli.recording.frames import FrameLog


@dataclass(frozen=True, eq=False)
class LoggedCamera:
    """One camera as a log describes it."""

    name: str
    width: int
    height: int
    intrinsics: NDArray[np.float64]
    """(3, 3) camera frame -> pixels."""
    to_ego: NDArray[np.float64] | None
    """(4, 4) camera frame -> ego frame, if the log says."""

    def differs(self, other: LoggedCamera) -> str | None:
        """What is not alike, or None."""
        if self.name != other.name:
            return f"camera '{self.name}' instead of '{other.name}'"
        if (self.width, self.height) != (other.width, other.height):
            return f"{self.name}: {self.width} x {self.height} pixels instead of {other.width} x {other.height}"
        if not np.allclose(self.intrinsics, other.intrinsics, atol=1e-6):
            return f"{self.name}: other intrinsics"
        if self.to_ego is None or other.to_ego is None:
            return None if self.to_ego is other.to_ego else f"{self.name}: a mount in one of them only"
        return None if np.allclose(self.to_ego, other.to_ego, atol=1e-6) else f"{self.name}: mounted elsewhere"


def rotation_matrix(q: Any) -> NDArray[np.float64]:
    """(3, 3) of a quaternion message; zeros count as no rotation."""
    x, y, z, w = q.x, q.y, q.z, q.w
    size = x * x + y * y + z * z + w * w
    if size == 0:
        return np.eye(3)
    s = 2 / size
    return np.array(
        [
            [1 - s * (y * y + z * z), s * (x * y - z * w), s * (x * z + y * w)],
            [s * (x * y + z * w), 1 - s * (x * x + z * z), s * (y * z - x * w)],
            [s * (x * z - y * w), s * (y * z + x * w), 1 - s * (x * x + y * y)],
        ]
    )


def cameras_of(log: FrameLog) -> list[LoggedCamera]:
    """The cameras whose calibration the log holds, in order.

    Raises:
        LogError: a calibration cannot be read, or changes within the log.
    """
    found = []
    for camera in log.cameras:
        calibrations = _messages(log, log.mapping.calibration.get(camera), CameraCalibration)
        if not calibrations:
            continue
        mounts = _messages(log, log.mapping.mounts.get(camera), FrameTransform)
        cameras = [_camera(camera, c, mounts[0] if mounts else None) for c in calibrations]
        for later in cameras[1:]:
            if (change := later.differs(cameras[0])) is not None:
                raise LogError(f"the calibration changes within the log ({change})", where=str(log.path))
        found.append(cameras[0])
    return found


def _camera(name: str, calibration: Any, mount: Any) -> LoggedCamera:
    matrix = np.array(calibration.K, np.float64).reshape(3, 3) if len(calibration.K) == 9 else np.zeros((3, 3))
    to_ego = None
    if mount is not None:
        to_ego = np.eye(4)
        to_ego[:3, :3] = rotation_matrix(mount.rotation)
        to_ego[:3, 3] = mount.translation.x, mount.translation.y, mount.translation.z
    return LoggedCamera(name, calibration.width, calibration.height, matrix, to_ego)


def _messages(log: FrameLog, topic: str | None, kind: Any) -> list[Any]:
    """The messages of a topic; none where it is not there."""
    if topic is None or topic not in log.file.channels:
        return []
    schema = log.file.schema(topic)
    if schema is None or schema.name != kind.DESCRIPTOR.full_name:
        name = schema.name if schema else "no schema"
        raise LogError(f"topic {topic} holds {name}", where=str(log.path), allowed=kind.DESCRIPTOR.full_name)
    try:
        return [kind.FromString(log.file.message(place)) for place in log.file.entries([topic])[topic].places]
    except DecodeError as error:
        raise log.file.damaged(f"topic {topic}: {error}") from error


def refuse_mixed(logs: Sequence[FrameLog]) -> None:
    """Raises LogError unless all logs have the same cameras with the same calibration, as far as they tell."""
    first: tuple[FrameLog, list[LoggedCamera]] | None = None
    for log in logs:
        cameras = cameras_of(log)
        log.close()
        if first is None:
            first = log, cameras
            continue
        difference = _difference(cameras, first[1], log.cameras, first[0].cameras)
        if difference is not None:
            raise LogError(
                f"calibrations are mixed: {difference} in {first[0].path}",
                where=str(log.path),
                hint="Keep logs of one rig in a folder of their own",
            )


def _difference(
    cameras: Sequence[LoggedCamera], others: Sequence[LoggedCamera], names: Sequence[str], other_names: Sequence[str]
) -> str | None:
    if tuple(names) != tuple(other_names):
        return f"cameras {', '.join(names)} instead of {', '.join(other_names)}"
    if len(cameras) != len(others):
        return f"{len(cameras)} cameras are calibrated instead of {len(others)}"
    return next((found for a, b in zip(cameras, others, strict=True) if (found := a.differs(b)) is not None), None)

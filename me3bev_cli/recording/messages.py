"""What a log holds, as Foxglove's protobuf messages, and back.

Frames: `map` (world), `ego` (x forward, y left, on the ground), `camera_NAME` (x right, y down, z ahead).
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any

import cv2
import numpy as np
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.Grid_pb2 import Grid
from foxglove_schemas_protobuf.PackedElementField_pb2 import PackedElementField
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from google.protobuf.timestamp_pb2 import Timestamp
from numpy.typing import NDArray

from me3bev_cli.api import Camera
from me3bev_cli.errors import LogError

NANOSECONDS = 1_000_000_000
_PNG = (cv2.IMWRITE_PNG_COMPRESSION, 1)


def stamp(nanoseconds: int) -> Timestamp:
    """A protobuf time."""
    return Timestamp(seconds=nanoseconds // NANOSECONDS, nanos=nanoseconds % NANOSECONDS)


@lru_cache(maxsize=8)
def _room(height: int, width: int) -> NDArray[np.uint8]:
    return np.empty((height, width, 3), np.uint8)


def image_message(image: NDArray[np.uint8], camera: str, time: int, quality: int) -> CompressedImage:
    """An RGB image (3, H, W) as JPEG of the given quality, or as lossless PNG when `quality` is 0."""
    # Channel by channel: many times faster than turning the array over. And always into the same memory.
    bgr = cv2.merge((image[2], image[1], image[0]), _room(*image.shape[1:]))
    suffix, options = ("png", _PNG) if quality == 0 else ("jpeg", (cv2.IMWRITE_JPEG_QUALITY, quality))
    ok, data = cv2.imencode(f".{suffix}", bgr, options)
    if not ok:
        raise RuntimeError(f"OpenCV could not encode a {suffix} image of shape {bgr.shape}")
    return CompressedImage(timestamp=stamp(time), frame_id=f"camera_{camera}", data=data.tobytes(), format=suffix)


def decode_image(data: Any, out: NDArray[np.uint8] | None = None) -> NDArray[np.uint8]:
    """The RGB image (3, H, W) in a JPEG or PNG file's bytes, in `out` if it has that shape.

    Raises:
        LogError: it cannot be decoded.
    """
    bgr = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR) if len(data) else None
    if bgr is None:
        raise LogError("an image cannot be decoded", allowed="jpeg, png")
    height, width = bgr.shape[:2]
    if out is None or out.shape != (3, height, width):
        out = np.empty((3, height, width), np.uint8)
    cv2.split(bgr, [out[2], out[1], out[0]])  # Writes into the planes.
    return out


def image_array(message: Any) -> NDArray[np.uint8]:
    """The RGB image (3, H, W) of a CompressedImage.

    Raises:
        LogError: it cannot be decoded.
    """
    return decode_image(message.data)


def calibration_message(camera: Camera, time: int) -> CameraCalibration:
    """Intrinsics of one camera."""
    flat = [value for row in camera.intrinsics() for value in row]
    projection = [value for row in camera.intrinsics() for value in (*row, 0.0)]
    return CameraCalibration(
        timestamp=stamp(time),
        frame_id=f"camera_{camera.name}",
        width=camera.width,
        height=camera.height,
        K=flat,
        R=[1.0, 0, 0, 0, 1.0, 0, 0, 0, 1.0],
        P=projection,
    )


def _quaternion(rotation: NDArray[np.float64]) -> tuple[float, float, float, float]:
    """A rotation matrix (3, 3) as (x, y, z, w)."""
    m = rotation
    # Shepperd's method: divide by the largest of the four components.
    four = np.array([m[0, 0], m[1, 1], m[2, 2], m.trace()])
    i = int(four.argmax())
    if i == 3:
        q = [m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1], 1 + four[3]]
    else:
        j, k = (i + 1) % 3, (i + 2) % 3
        q = [0.0] * 4
        q[i] = 1 + 2 * m[i, i] - four[3]
        q[j], q[k] = m[j, i] + m[i, j], m[k, i] + m[i, k]
        q[3] = m[k, j] - m[j, k]
    x, y, z, w = np.array(q) / np.linalg.norm(q)
    return float(x), float(y), float(z), float(w)


def camera_transform(camera: Camera, time: int) -> FrameTransform:
    """Where a camera sits on the ego."""
    matrix = np.array(camera.camera_to_ego())
    message = FrameTransform(timestamp=stamp(time), parent_frame_id="ego", child_frame_id=f"camera_{camera.name}")
    message.translation.x, message.translation.y, message.translation.z = matrix[:3, 3]
    message.rotation.x, message.rotation.y, message.rotation.z, message.rotation.w = _quaternion(matrix[:3, :3])
    return message


def ego_transform(x: float, y: float, heading: float, time: int) -> FrameTransform:
    """Where the ego is in the world."""
    message = FrameTransform(timestamp=stamp(time), parent_frame_id="map", child_frame_id="ego")
    message.translation.x, message.translation.y = x, y
    message.rotation.z, message.rotation.w = math.sin(heading / 2), math.cos(heading / 2)
    return message


def grid_message(classes: NDArray[np.uint8], cell: float, time: int) -> Grid:
    """The semantic BEV (rows from far to near, columns from left to right) as a grid in the ego frame.

    Foxglove's grid has its origin at a corner with x along columns and y along rows: the columns here follow the
    ego's x and the rows its y, so the array is turned.
    """
    rows, columns = classes.shape
    turned = np.ascontiguousarray(classes[::-1, ::-1].T)
    message = Grid(timestamp=stamp(time), frame_id="ego", column_count=rows, row_stride=rows, cell_stride=1)
    message.pose.position.x, message.pose.position.y = -rows * cell / 2, -columns * cell / 2
    message.pose.orientation.w = 1.0
    message.cell_size.x = message.cell_size.y = cell
    message.fields.append(PackedElementField(name="class", offset=0, type=PackedElementField.UINT8))
    message.data = turned.tobytes()
    return message


def grid_array(message: Any) -> NDArray[np.uint8]:
    """The inverse of `grid_message`.

    Raises:
        LogError: the grid is not one of single bytes.
    """
    fields, stride = message.fields, message.row_stride
    if message.cell_stride != 1 or len(fields) != 1 or fields[0].type != PackedElementField.UINT8:
        raise LogError("a foxglove.Grid does not hold one class (uint8) per cell")
    if stride != message.column_count or not stride or len(message.data) % stride:
        raise LogError(f"a foxglove.Grid of {message.column_count} columns has {len(message.data)} bytes")
    flat = np.frombuffer(message.data, np.uint8).reshape(-1, stride)
    return np.ascontiguousarray(flat.T[::-1, ::-1])


def raw_message(image: NDArray[Any], camera: str, time: int) -> RawImage:
    """An array (H, W) as it is: float32 (depth, metres; inf where nothing is) or uint8 (classes)."""
    height, width = image.shape
    encoding = {np.dtype(np.float32): "32FC1", np.dtype(np.uint8): "mono8"}[image.dtype]
    return RawImage(
        timestamp=stamp(time),
        frame_id=f"camera_{camera}",
        width=width,
        height=height,
        encoding=encoding,
        step=width * image.itemsize,
        data=np.ascontiguousarray(image).tobytes(),
    )


def raw_array(message: Any) -> NDArray[Any]:
    """The inverse of `raw_message`.

    Raises:
        LogError: another encoding.
    """
    kinds = {"32FC1": "<f4", "mono8": "u1", "8UC1": "u1"}
    kind = np.dtype(kinds[message.encoding]) if message.encoding in kinds else None
    if kind is None or message.step != message.width * kind.itemsize:
        raise LogError(f"a foxglove.RawImage is encoded as '{message.encoding}'", allowed="32FC1, mono8")
    if len(message.data) != message.height * message.step:
        raise LogError(f"a foxglove.RawImage of {message.width} x {message.height} has {len(message.data)} bytes")
    return np.frombuffer(message.data, kind).reshape(message.height, message.width)

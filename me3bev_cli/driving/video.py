"""Video files that players and browsers open: H.264 in mp4 (or VP9 in webm), whole or not there."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from fractions import Fraction
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from me3bev_cli.errors import UserError

Picture = NDArray[np.uint8]

RATE = 10
"""Frames per second: real time."""
KEY_EVERY = 20
"""A player can jump to every so many frames."""
BYTES_PER_FRAME = 100_000
"""Room that a frame may need, for the look at the disk beforehand: about twice what driving takes."""


class Format(NamedTuple):
    """How a kind of file is encoded."""

    container: str
    codecs: tuple[str, ...]
    """The first that FFmpeg was built with is taken."""
    options: dict[str, str]
    """Of the codec."""
    container_options: dict[str, str]


FORMATS = {
    # The index goes to the front, so that a browser shows the first frame before it has the last.
    ".mp4": Format(
        "mp4", ("libx264", "libopenh264"), {"crf": "20", "preset": "veryfast"}, {"movflags": "+faststart"}
    ),
    ".webm": Format(
        "webm", ("libvpx-vp9",), {"crf": "30", "b": "0", "deadline": "realtime", "cpu-used": "6", "row-mt": "1"}, {}
    ),
}  # fmt: skip
BT709 = 1
"""FFmpeg's number for HD video's colours; unsaid, players guess."""


def check_target(path: Path, frames: int = 0) -> None:
    """See that a video of about `frames` frames can be written, before anything is driven for it.

    Raises:
        UserError: an unknown suffix, a folder in the way, no permission, or no room.
    """
    if path.suffix.lower() not in FORMATS:
        what = f"a video cannot be '{path.suffix}'" if path.suffix else "the video's name has no suffix"
        raise UserError(what, where=str(path), allowed=", ".join(FORMATS))
    if path.is_dir():
        raise UserError("cannot be written: it is a folder", where=str(path), hint="Name a file in it")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(prefix=f".{path.stem}.", dir=path.parent):
            free = shutil.disk_usage(path.parent).free
    except OSError as error:
        raise _unwritable(path, error) from error
    need = max(1, frames) * BYTES_PER_FRAME
    if free < need:
        raise UserError(
            f"cannot be written: {free / 1e6:.1f} MB are free, {frames} frames may need {need / 1e6:.0f} MB",
            where=str(path),
        )


class Encoder(Protocol):
    """Takes frames one by one."""

    note: str
    """What the user should know of it, or nothing."""

    def add(self, picture: Picture) -> None:
        """One more frame (H, W, 3) r, g, b."""
        ...

    def close(self) -> None:
        """The last frame has been added."""
        ...


class Video:
    """A video in the making, under a temporary name in the same folder."""

    def __init__(self, path: Path, encoder: Encoder) -> None:
        self.path, self.encoder, self.frames = path, encoder, 0

    def add(self, picture: Picture, times: int = 1) -> None:
        """Append a frame, several times to hold it.

        Raises:
            UserError: the system refuses, as when the disk is full.
        """
        for _ in range(times):
            try:
                self.encoder.add(picture)
            except OSError as error:
                raise _unwritable(self.path, error) from error
            self.frames += 1


@contextmanager
def video_file(path: Path, width: int, height: int, options: Mapping[str, str] | None = None) -> Iterator[Video]:
    """A video to be filled inside the block; at its end it gets its name, unless it holds no frame or an error left it.

    Args:
        width, height: of every frame, even numbers of pixels.
        options: of the codec, in place of the format's.

    Raises:
        UserError: as `check_target`, and when the system refuses later.
    """
    check_target(path)
    handle, name = tempfile.mkstemp(prefix=f".{path.stem}.", suffix=path.suffix.lower(), dir=path.parent)
    os.close(handle)
    temporary = Path(name)
    try:
        video = Video(path, _encoder(temporary, width, height, options or {}))
        try:
            yield video
        finally:
            _close(video)
        if video.frames:
            umask = os.umask(0)
            os.umask(umask)
            temporary.chmod(0o666 & ~umask)
            temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


def _close(video: Video) -> None:
    try:
        video.encoder.close()
    except OSError as error:
        raise _unwritable(video.path, error) from error


def _unwritable(path: Path, error: OSError) -> UserError:
    return UserError(f"cannot be written: {error.strerror or error}", where=str(path))


def _encoder(path: Path, width: int, height: int, options: Mapping[str, str]) -> Encoder:
    form = FORMATS[path.suffix]
    form = form._replace(options={**form.options, **options})
    codec = next((name for name in form.codecs if has_codec(name)), None)
    if codec is not None:
        return FFmpegEncoder(path, form, codec, width, height)
    if path.suffix != ".mp4":
        raise UserError(f"FFmpeg has no encoder for '{path.suffix}' here", where="--video", allowed=".mp4")
    return OpenCVEncoder(path, width, height)


def has_codec(name: str) -> bool:
    """Whether PyAV is there and its FFmpeg has an encoder."""
    try:
        import av

        av.Codec(name, "w")
    except (ImportError, ValueError):
        return False
    return True


class FFmpegEncoder:
    """PyAV's encoders."""

    note = ""

    def __init__(self, path: Path, form: Format, codec: str, width: int, height: int) -> None:
        import av

        self.container = av.open(str(path), "w", format=form.container, options=form.container_options)
        stream: Any = self.container.add_stream(codec, rate=RATE, options=form.options)
        stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
        context = stream.codec_context
        context.gop_size, context.time_base = KEY_EVERY, Fraction(1, RATE)
        context.colorspace = context.color_primaries = context.color_trc = BT709
        context.color_range = 1  # The narrow one, as nearly all video has.
        self.stream, self.count = stream, 0

    def add(self, picture: Picture) -> None:
        """One more frame."""
        from av import VideoFrame

        frame: Any = VideoFrame.from_ndarray(np.ascontiguousarray(picture), format="rgb24")
        frame = frame.reformat(format="yuv420p", dst_colorspace=BT709)
        frame.pts, frame.time_base = self.count, Fraction(1, RATE)
        self.count += 1
        self.container.mux(self.stream.encode(frame))

    def close(self) -> None:
        """Write what is still in the encoder, and the index."""
        try:
            if self.count:
                self.container.mux(self.stream.encode(None))
        finally:
            self.container.close()


class OpenCVEncoder:
    """What is left where FFmpeg has no encoder for H.264."""

    note = "PyAV has no H.264 encoder here: this is MPEG-4 part 2, which most players open and browsers do not"

    def __init__(self, path: Path, width: int, height: int) -> None:
        self.writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), RATE, (width, height))
        if not self.writer.isOpened():
            raise UserError("no encoder for video is installed", hint="`pip install av` brings one")

    def add(self, picture: Picture) -> None:
        """One more frame."""
        self.writer.write(np.ascontiguousarray(picture[:, :, ::-1]))

    def close(self) -> None:
        """Write the index."""
        self.writer.release()

"""`FrameLog`: the frames of one log by number; only what is asked for is read and decoded."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from google.protobuf.message import DecodeError
from numpy.typing import NDArray

from me3bev_cli.errors import LogError
from me3bev_cli.recording.decode import FORMS, check_schema, parse
from me3bev_cli.recording.logfile import LogFile, LogWarning
from me3bev_cli.recording.mapping import PER_CAMERA, SINGLE, TopicMapping, own_mapping
from me3bev_cli.recording.writer import METADATA

PARTS = (*PER_CAMERA, *SINGLE)
"""What a frame may have."""
TRAINING_PARTS = ("images", "bev", "road", "vehicle", "navigation", "action", "reward", "speed")
"""What a frame has when nothing else is asked for, of a log of ours."""


class FrameLog:
    """The frames of a log: one for each image of the first camera that has all its other parts.

    Args:
        path: the file.
        parts: of `PARTS`; by default `TRAINING_PARTS`, or what the mapping names of them.
        mapping: topics of a log that is not ours.

    Raises:
        LogError: the file is damaged, or it lacks topics or holds other messages in them; the text says which.
    """

    def __init__(self, path: Path, parts: Sequence[str] | None = None, mapping: TopicMapping | None = None) -> None:
        self.file = LogFile(path)
        self.metadata = self.file.metadata.get(METADATA, {})
        self.mapping = mapping or own_mapping(self.file.channels, self.metadata)
        self.cameras = tuple(self.mapping.cameras)
        if parts is None:
            parts = [part for part in TRAINING_PARTS if mapping is None or self.mapping.topics_of(part)]
        self.parts = tuple(parts)
        self._topics = {part: self._topics_of(part, mapping is not None) for part in self.parts}
        self.times, self._places = self._align()
        self.note = f"{self.file.note}; {len(self)} frames are there" if self.file.note else None
        """What is missing of a log that is cut off."""
        if self.note is not None:
            warnings.warn(self.note, LogWarning, stacklevel=2)

    @property
    def path(self) -> Path:
        """Of the file."""
        return self.file.path

    def __len__(self) -> int:
        return len(self.times)

    def _topics_of(self, part: str, mapped: bool) -> list[str]:
        if part not in PARTS:
            raise LogError(f"a frame has no part '{part}'", allowed=", ".join(PARTS))
        topics = self.mapping.topics_of(part)
        wanted = len(self.cameras) if part in PER_CAMERA else 1
        if len(topics) < wanted:
            raise LogError(f"the mapping names {len(topics)} of {wanted} topics for `{part}`", where=str(self.path))
        missing = [topic for topic in topics if topic not in self.file.channels]
        if missing and self.file.note:
            raise LogError(f"{self.file.note}; no frame is there")
        if missing:
            hint = "Another name can be given in a mapping" if not mapped else "The mapping names topics of another log"
            there = ", ".join(sorted(self.file.channels)) or "none"
            raise LogError(
                f"the log has no topic {', '.join(missing)}, needed for `{part}`. It has: {there}",
                where=str(self.path),
                hint=hint,
            )
        for topic in topics:
            channel = self.file.channels[topic]
            check_schema(part, topic, self.file.schema(topic), channel.message_encoding, str(self.path))
        return topics

    def _align(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """(times (N,), places (N, K, 2)) of the frames, for the K topics of all parts in turn."""
        reference = self._topics.get("images", self.mapping.topics_of("images"))[0]
        if reference not in self.file.channels:
            reference = next(iter(self._topics.values()))[0]
        topics = [topic for part in self.parts for topic in self._topics[part]]
        entries = self.file.entries([reference, *topics])
        times = entries[reference].times
        chosen, whole = [], np.ones(len(times), bool)
        for topic in topics:
            others = entries[topic]
            if np.array_equal(others.times, times):
                chosen.append(others.places)
                continue
            nearest, apart = _nearest(others.times, times)
            whole &= apart <= self.mapping.tolerance * 1e9
            chosen.append(others.places[nearest] if len(others.times) else np.zeros((len(times), 2), np.int64))
        places = np.stack(chosen, axis=1) if chosen else np.zeros((len(times), 0, 2), np.int64)
        if not whole.any() and self.file.note:
            raise LogError(f"{self.file.note}; no frame is there")
        if not whole.any():
            raise LogError(
                "the log holds no whole frame" + (f" of {', '.join(topics)}" if len(times) else ""),
                where=str(self.path),
            )
        return times[whole], places[whole]

    def frame(self, number: int) -> dict[str, Any]:
        """The parts of a frame: `images` (C, 3, H, W), `depth` and `semantics` (C, H, W), `bev` (X, Y), vectors,
        `pose` (x, y, heading), `reward` and `speed` as numbers, `infractions` and `state` as dicts, `actors` (A, 7).

        Raises:
            LogError: something of it is damaged.
        """
        places, start, frame = self._places[number], 0, {}
        for part in self.parts:
            topics = self._topics[part]
            frame[part] = self._part(part, topics, places[start : start + len(topics)])
            start += len(topics)
        return frame

    def _part(self, part: str, topics: Sequence[str], places: NDArray[np.int64]) -> Any:
        if part not in PER_CAMERA:
            return self._decoded(part, topics[0], places[0])
        first = self._decoded(part, topics[0], places[0])
        # Each image is decoded to where it belongs: copying them together takes half as long again.
        together = np.empty((len(topics), *first.shape), first.dtype)
        together[0] = first
        for out, topic, place in zip(together[1:], topics[1:], places[1:], strict=True):
            value = self._decoded(part, topic, place, out)
            if value.shape != first.shape:
                sizes = " and ".join(f"{v.shape[-2]} x {v.shape[-1]}" for v in (first, value))
                raise LogError(f"the cameras' `{part}` have several sizes: {sizes}", where=str(self.path))
            if value is not out:
                out[...] = value
        return together

    def _decoded(self, part: str, topic: str, place: NDArray[np.int64], out: NDArray[Any] | None = None) -> Any:
        schema = self.file.schema(topic)
        assert schema is not None
        try:
            return FORMS[part].decode(parse(schema, self.file.message(place)), out)
        except (DecodeError, AttributeError, KeyError, TypeError) as error:
            raise self.file.damaged(f"topic {topic}: {error}") from error
        except LogError as error:
            if error.where is None:
                raise LogError(f"topic {topic}: {error.what}", where=str(self.path), allowed=error.allowed) from None
            raise

    def close(self) -> None:
        """Close the file until the next read."""
        self.file.close()


def _nearest(times: NDArray[np.int64], wanted: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """(index, distance) of the nearest of `times` for each of `wanted`."""
    if not len(times):
        return np.zeros(len(wanted), np.int64), np.full(len(wanted), np.iinfo(np.int64).max)
    after = np.clip(np.searchsorted(times, wanted), 0, len(times) - 1)
    before = np.maximum(after - 1, 0)
    closer = np.abs(times[before] - wanted) < np.abs(times[after] - wanted)
    index = np.where(closer, before, after)
    return index, np.abs(times[index] - wanted)

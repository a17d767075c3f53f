"""Logs of the line world, small and lossless."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from fakes import LineSimulator
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from mcap.writer import CompressionType, Writer
from mcap_protobuf.schema import register_schema

from me3bev_cli.api import ObservationConfig
from me3bev_cli.evaluation.drivers import Autopilot, DriverSpec
from me3bev_cli.evaluation.runner import World
from me3bev_cli.recording.collect import record
from me3bev_cli.recording.messages import image_message
from me3bev_cli.recording.writer import EpisodeWriter, Options

AUTOPILOT = DriverSpec("autopilot", "autopilot")
OBSERVATION = ObservationConfig(height=16, width=32, cameras=("front", "back"))


class LineWorld(World):
    """A world that worker processes know, too: there the line is no plugin."""

    def open(self) -> LineSimulator:  # type: ignore[override]
        return LineSimulator(None)


def write_log(path: Path, seed: int = 0, observation: ObservationConfig = OBSERVATION, lens: float = 1.0) -> Path:
    """An episode of 12 steps; `lens` changes the cameras' focal lengths."""
    simulator = LineSimulator(None)
    env = simulator.make_env(observation, map="F1", density="low")
    about = {"map": "F1", "density": "low", "weather": "sun", "seed": str(seed), "index": "0", "driver": "autopilot"}
    rig = simulator.rig(observation)
    rig = rig.model_copy(update={"cameras": tuple(c.model_copy(update={"fx": c.fx * lens}) for c in rig.cameras)})
    path.parent.mkdir(parents=True, exist_ok=True)
    with EpisodeWriter(path, rig, about, Options(quality=0)) as writer:
        record(env, Autopilot(), writer, env.reset(seed=seed)[0])
    return path


def write_foreign(
    path: Path,
    topics: tuple[str, ...] = ("/left", "/right"),
    late: float = 0.0,
    compression: CompressionType = CompressionType.LZ4,
    **options: bool,
) -> np.ndarray:
    """A log by the library's own writer: ten frames, 0.5 s apart, the last camera `late` seconds; its images."""
    images = np.random.default_rng(0).integers(0, 256, (10, len(topics), 3, 8, 12), np.uint8)
    with open(path, "wb") as file:
        writer = Writer(file, chunk_size=4000, compression=compression, **options)
        writer.start()
        schema = register_schema(writer, CompressedImage)
        channels = [writer.register_channel(topic, "protobuf", schema) for topic in topics]
        for number, frame in enumerate(images):
            for channel, image in zip(channels, frame, strict=True):
                time = round((5 + 0.5 * number + late * (channel == channels[-1])) * 1e9)
                data = image_message(image, "x", time, 0).SerializeToString()
                writer.add_message(channel, time, data, time)
        writer.finish()
    return images

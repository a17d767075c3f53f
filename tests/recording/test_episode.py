"""What is written to an MCAP file is what is read back, and existing viewers' schemas are used."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from fakes import LineSimulator
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from mcap.reader import NonSeekingReader, make_reader

from me3bev_cli.api import CAMERA_NAMES, Camera, ObservationConfig
from me3bev_cli.errors import LogError
from me3bev_cli.evaluation.drivers import Autopilot, DriverSpec
from me3bev_cli.evaluation.episode import from_records
from me3bev_cli.evaluation.runner import World, drive
from me3bev_cli.recipe import PluginChoice
from me3bev_cli.recording import messages
from me3bev_cli.recording.collect import Recorder, Take, collect, record
from me3bev_cli.recording.frames import FrameLog
from me3bev_cli.recording.reader import episode_files, read_episode, read_metadata, read_steps
from me3bev_cli.recording.scene import actors_data, boxes_array
from me3bev_cli.recording.writer import EpisodeWriter, Options

OBSERVATION = ObservationConfig(height=16, width=32)
AUTOPILOT = DriverSpec("autopilot", "autopilot")


ABOUT = {"map": "F1", "density": "low", "weather": "sun", "seed": "5", "index": "0", "driver": "autopilot"}
LOSSLESS = Options(quality=0)


def write(folder: Path, options: Options = LOSSLESS) -> Path:
    simulator = LineSimulator(None)
    env = simulator.make_env(OBSERVATION, map="F1", density="low")
    path = Take("F1", "low", 0).path(folder)
    with EpisodeWriter(path, simulator.rig(OBSERVATION), ABOUT, options, env.route_line()) as writer:
        record(env, Autopilot(), writer, env.reset(seed=5)[0])
    return path


def test_a_lossless_episode_comes_back_as_it_was(tmp_path: Path) -> None:
    path = write(tmp_path)
    env = LineSimulator(None).make_env(OBSERVATION, map="F1", density="low")
    observation, _ = env.reset(seed=5)
    steps = list(read_steps(path))
    assert len(steps) == 12
    for step in steps:
        np.testing.assert_array_equal(step.observation["images"], observation["images"])
        np.testing.assert_array_equal(step.bev, env.bev_semantics())
        np.testing.assert_allclose(step.observation["vehicle"], observation["vehicle"])
        observation, _, _, _, info = env.step(step.action)
        assert step.record["x"] == info["record"]["x"]
        assert math.isnan(step.record["traffic_speed"])
    assert read_metadata(path) == ABOUT | {"cameras": ",".join(CAMERA_NAMES)}
    assert [p.name for p in tmp_path.iterdir()] == [path.name]


def test_topics_and_schemas(tmp_path: Path) -> None:
    with open(write(tmp_path, Options(depth=True, semantics=True)), "rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    found = {c.topic: summary.schemas[c.schema_id].name for c in summary.channels.values()}
    assert found["/camera/front/image"] == "foxglove.CompressedImage"
    assert found["/camera/back/calibration"] == "foxglove.CameraCalibration"
    assert found["/camera/back/transform"] == found["/tf"] == "foxglove.FrameTransform"
    assert found["/camera/back/depth"] == found["/camera/back/semantics"] == "foxglove.RawImage"
    assert found["/bev/truth"] == "foxglove.Grid"
    assert found["/scene/actors"] == found["/scene/route"] == "foxglove.SceneUpdate"
    assert {found[f"/observation/{name}"] for name in ("road", "vehicle", "navigation")} == {"me3bev.Vector"}
    ours = ("action", "reward", "speed", "infractions", "state")
    assert [found[f"/{name}"].split(".")[0] for name in ours] == ["me3bev"] * 5
    assert all(schema.encoding == "protobuf" and schema.data for schema in summary.schemas.values())
    assert summary.statistics is not None
    assert summary.statistics.message_count == 12 * (1 + 6 * 3 + 2 + 3 + 5) + 13
    assert len(summary.metadata_indexes) == 2
    assert {index.compression for index in summary.chunk_indexes} == {"zstd"}
    assert len([topic for topic in found if topic.endswith("/image")]) == len(CAMERA_NAMES)


def test_the_library_agrees_with_every_checksum_and_index(tmp_path: Path) -> None:
    path = write(tmp_path)
    with open(path, "rb") as file:
        by_index = list(make_reader(file, validate_crcs=True).iter_messages(log_time_order=False))
    with open(path, "rb") as file:
        in_turn = list(NonSeekingReader(file, validate_crcs=True).iter_messages(log_time_order=False))
    assert by_index == in_turn
    assert len(by_index) == 12 * (1 + 6 + 2 + 3 + 5) + 13


def test_metrics_can_be_computed_from_a_log(tmp_path: Path) -> None:
    path = write(tmp_path)
    env = LineSimulator(None).make_env(OBSERVATION, map="F1", density="low")
    driven = drive(env, Autopilot(), 5)
    episode = read_episode(path)
    wanted = from_records(
        driven.records, map="F1", density="low", weather="sun", seed=5, index=0, driver="autopilot", ended="timeout"
    )
    assert {k: v for k, v in vars(episode).items() if k != "steps"} == {
        k: v for k, v in vars(wanted).items() if k != "steps"
    }
    assert episode.steps.tobytes() == wanted.steps.tobytes()


def test_actors_are_boxes_in_the_world(tmp_path: Path) -> None:
    env = LineSimulator(None).make_env(OBSERVATION, map="F1", density="low")
    env.reset(seed=5)
    actors = env.actors()
    message = SceneUpdate.FromString(actors_data(actors, (0.0, 0.0), 1_500_000_000))
    (entity,) = message.entities
    assert (entity.frame_id, entity.timestamp.seconds, entity.timestamp.nanos) == ("map", 1, 500_000_000)
    assert entity.cubes[0].pose.position.z == 0.75  # the middle of a box 1.5 m high
    np.testing.assert_allclose(boxes_array(message), actors.boxes, atol=1e-12)
    assert (entity.cubes[1].color.r, entity.cubes[1].color.b) == (0.94, 0.27)
    far = SceneUpdate.FromString(actors_data(actors, (105.0, 0.0), 0))
    np.testing.assert_allclose(boxes_array(far), actors.boxes[:1], atol=1e-12)
    assert not SceneUpdate.FromString(actors_data(actors, (1e4, 0.0), 0)).entities[0].cubes


def test_depth_and_semantics_come_back(tmp_path: Path) -> None:
    log = FrameLog(write(tmp_path, Options(depth=True, semantics=True)), ("depth", "semantics", "pose", "actors"))
    env = LineSimulator(None).make_env(OBSERVATION, map="F1", density="low")
    env.reset(seed=5)
    frame, (depth, classes) = log.frame(0), env.camera_truth()
    np.testing.assert_array_equal(frame["depth"], depth)
    np.testing.assert_array_equal(frame["semantics"], classes)
    np.testing.assert_array_equal(frame["pose"], env.pose())
    np.testing.assert_allclose(frame["actors"], env.actors().boxes, atol=1e-12)


def test_a_camera_looking_left_is_turned_left() -> None:
    camera = Camera(
        name="left", width=4, height=4, fx=1, fy=1, cx=2, cy=2, position=(1.0, 0.5, 1.7), yaw=math.pi / 2, pitch=0.1
    )
    message = messages.camera_transform(camera, 0)
    q = message.rotation
    w, v = q.w, np.array([q.x, q.y, q.z])

    def rotate(p: np.ndarray) -> np.ndarray:
        return p + 2 * np.cross(v, np.cross(v, p) + w * p)

    matrix = np.array(camera.camera_to_ego())[:3, :3]
    for axis in np.eye(3):
        np.testing.assert_allclose(rotate(axis), matrix @ axis, atol=1e-9)
    # The optical axis of a camera turned left by 90 degrees and up by 0.1 rad.
    np.testing.assert_allclose(rotate(np.array([0.0, 0.0, 1.0])), [0, math.cos(0.1), math.sin(0.1)], atol=1e-9)


def test_the_grid_lies_in_the_ego_frame() -> None:
    classes = np.zeros((200, 200), np.uint8)
    classes[0, 0] = 6  # farthest ahead, farthest left
    message = messages.grid_message(classes, 0.5, 0)
    cells = np.frombuffer(message.data, np.uint8).reshape(-1, message.row_stride)
    row, column = np.argwhere(cells == 6)[0]
    x = message.pose.position.x + (column + 0.5) * message.cell_size.x
    y = message.pose.position.y + (row + 0.5) * message.cell_size.y
    assert (x, y) == (49.75, 49.75)
    np.testing.assert_array_equal(messages.grid_array(message), classes)


def test_damaged_logs_are_named(tmp_path: Path) -> None:
    with pytest.raises(LogError, match="holds no MCAP file"):
        episode_files(tmp_path)
    path = write(tmp_path)
    path.write_bytes(b"\0" * 100)
    with pytest.raises(LogError, match="this is no MCAP file"):
        list(read_steps(path))


def test_a_failed_episode_leaves_no_file(tmp_path: Path) -> None:
    simulator = LineSimulator(None)
    env = simulator.make_env(OBSERVATION, map="F1", density="low")

    class Broken(Autopilot):
        def act(self, observation: object, env: object) -> np.ndarray:  # type: ignore[override]
            raise RuntimeError("driver broke")

    with (
        pytest.raises(RuntimeError, match="driver broke"),
        EpisodeWriter(tmp_path / "a.mcap", simulator.rig(OBSERVATION), {}) as writer,
    ):
        record(env, Broken(), writer, env.reset(seed=1)[0])
    assert not list(tmp_path.iterdir())


def test_a_collection_goes_on_where_it_was_cut_off(line_plugins: None, tmp_path: Path) -> None:
    world = World(PluginChoice(name="line"), OBSERVATION)
    recorder = Recorder(world, AUTOPILOT, 0, tmp_path)
    takes = [Take(place, "low", index) for place in ("F1", "F2") for index in range(2)]
    assert collect(recorder, takes, workers=0) == 4
    kept = takes[1].path(tmp_path).read_bytes()
    takes[0].path(tmp_path).unlink()
    (tmp_path / ".F1-low-00000.mcap.part").write_bytes(b"half")
    assert collect(recorder, takes, workers=0) == 1
    assert takes[1].path(tmp_path).read_bytes() == kept
    assert not list(tmp_path.glob(".*"))
    assert read_metadata(takes[3].path(tmp_path))["map"] == "F2"


def test_each_file_says_which_weather_it_has(line_plugins: None, tmp_path: Path) -> None:
    takes = [Take("F1", "low", index) for index in range(8)]
    found = []
    for folder, weather in (("sun", None), ("several", ("moon", "mist"))):
        world = World(PluginChoice(name="line"), OBSERVATION, weather)
        collect(Recorder(world, AUTOPILOT, 0, tmp_path / folder), takes, workers=0)
        found.append([read_metadata(take.path(tmp_path / folder)) for take in takes])
    assert {one["weather"] for one in found[0]} == {"sun"}
    assert {one["weather"] for one in found[1]} == {"moon", "mist"}
    # The same drives: only the weather differs.
    assert [one["seed"] for one in found[0]] == [one["seed"] for one in found[1]]


def test_collections_are_not_mixed(line_plugins: None, tmp_path: Path) -> None:
    world = World(PluginChoice(name="line"), OBSERVATION, ("moon",))
    takes = [Take("F1", "low", 0)]
    assert collect(Recorder(world, AUTOPILOT, 0, tmp_path), takes, workers=0) == 1
    assert collect(Recorder(world, AUTOPILOT, 0, tmp_path), takes, workers=0) == 0
    for recorder, message in (
        (
            Recorder(replace(world, weather=("sun",)), AUTOPILOT, 0, tmp_path),
            "its weather_set is 'moon', not 'sun'",
        ),
        (Recorder(world, DriverSpec("idle", "idle"), 0, tmp_path), "its driver is 'autopilot', not 'idle'"),
        (Recorder(world, AUTOPILOT, 1, tmp_path), "its seed is"),
    ):
        with pytest.raises(LogError, match=f"F1-low-00000.mcap belongs to another collection: {message}"):
            collect(recorder, takes, workers=0)
    takes[0].path(tmp_path).write_bytes(b"")
    with pytest.raises(LogError, match="the log is empty"):
        collect(Recorder(world, AUTOPILOT, 0, tmp_path), takes, workers=0)

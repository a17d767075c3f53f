"""Cost of logs: `python -m me3bev_cli.bench.logs [--json FILE]`.

In one process with one thread, taking turns: the environment driven by the autopilot with nothing recorded; the same
episodes recorded as `me3bev collect` does; what of that the encoder of images and the simulator's truth take; reading
the recorded frames in turn, and at random. Rates are per second of processor time, which other processes do not
take away; the wall clock's are beside them.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from me3bev_cli.errors import UserError
from me3bev_cli.output import write_json
from me3bev_cli.workers import THREAD_VARIABLES

TARGETS = {"collect_ratio": 0.8, "frames_per_s": 300.0, "random_ms": 15.0}
"""Wanted at least; `random_ms` at most."""
SAMPLES = 40
"""Frames of an episode at which the encoder and the truth are timed, and frames that are sought at random."""

Times = dict[str, list[tuple[float, float, int]]]
"""Name -> (processor seconds, wall seconds, how many) of each turn."""


def timed(times: Times, name: str, call: Callable[[], int]) -> None:
    """Note what a call takes; it says how many things it did."""
    clock, wall = time.process_time(), time.perf_counter()
    count = call()
    times.setdefault(name, []).append((time.process_time() - clock, time.perf_counter() - wall, count))


def measure(recorder: Any, place: str, density: str, rounds: int) -> dict[str, Any]:
    """All figures.

    Args:
        recorder: a `recording.collect.Recorder` into an empty folder: the world, who drives, what is recorded.
        rounds: episodes, each of which is driven twice.
    """
    import cv2
    import torch

    from me3bev_cli.recording.collect import Take

    cv2.setNumThreads(1)
    torch.set_num_threads(1)
    times: Times = {}
    drive(recorder, Take(place, density, rounds), {})
    recorder(Take(place, density, rounds))
    Take(place, density, rounds).path(recorder.folder).unlink()
    for number in range(rounds):
        take = Take(place, density, number)
        drive(recorder, take, times)
        timed(times, "collect", lambda take=take: recorder(take))  # type: ignore[misc]
        read(take.path(recorder.folder), number, times)
    recorder.close()
    size = sum(path.stat().st_size for path in recorder.folder.glob("*.mcap"))
    return _figures(times, size / sum(count for *_, count in times["collect"]), recorder)


def drive(recorder: Any, take: Any, times: Times) -> None:
    """An episode of which nothing is recorded; the encoder and the truth at some of its frames, timed apart."""
    from me3bev_cli.recording.collect import truth
    from me3bev_cli.recording.messages import image_message

    env, driver, seed = recorder.environment(take.place, take.density), recorder.driver(), recorder.episode_seed(take)
    quality = recorder.options.quality
    kept: list[Any] = []

    def episode() -> int:
        seen, _ = env.reset(seed=seed)
        driver.begin(env, seed)
        steps, over = 0, False
        while not over:
            if len(kept) < SAMPLES:
                kept.append(seen["images"])
            seen, _, terminated, truncated, _ = env.step(driver.act(seen, env))
            steps, over = steps + 1, terminated or truncated
        return steps

    def encode() -> int:
        for images in kept:
            for image in images:
                image_message(image, "front", 0, quality)
        return len(kept)

    def look() -> int:
        for _ in kept:
            truth(env, recorder.options)
        return len(kept)

    timed(times, "environment", episode)
    timed(times, "encode", encode)
    timed(times, "truth", look)


def read(path: Path, seed: int, times: Times) -> None:
    """All frames of a log in turn, with truth; then some at random, each through a file that was just opened."""
    from me3bev_cli.recording.dataset import LogDataset

    def in_turn() -> int:
        dataset = LogDataset(path)
        for index in range(len(dataset)):
            _ = dataset[index]
        return len(dataset)

    timed(times, "read", in_turn)
    dataset = LogDataset(path)
    for index in np.random.default_rng(seed).integers(0, len(dataset), SAMPLES):
        dataset.logs[0].close()

        def seek(index: int = int(index)) -> int:
            _ = dataset[index]
            return 1

        timed(times, "random", seek)


def _figures(times: Times, bytes_per_step: float, recorder: Any) -> dict[str, Any]:
    from me3bev_cli.bench.machine import machine

    def rate(name: str, clock: int) -> float:
        return sum(turn[2] for turn in times[name]) / sum(turn[clock] for turn in times[name])

    ratios = [
        (plain[0] / plain[2]) / (logged[0] / logged[2])
        for plain, logged in zip(times["environment"], times["collect"], strict=True)
    ]
    observation = recorder.world.observation
    seeks = np.array([turn[1] for turn in times["random"]])
    return {
        "environment_steps_per_s": rate("environment", 0),
        "collect_steps_per_s": rate("collect", 0),
        "collect_ratio": float(np.median(ratios)),
        "collect_ratio_spread": [float(q) for q in np.quantile(ratios, (0.25, 0.75))],
        "collect_ratio_wall": rate("collect", 1) / rate("environment", 1),
        "encode_ms": 1e3 / rate("encode", 0),
        "truth_ms": 1e3 / rate("truth", 0),
        "ratio_if_encoding_were_all": 1 / (1 + rate("environment", 0) / rate("encode", 0)),
        "bytes_per_step": bytes_per_step,
        "frames_per_s": rate("read", 0),
        "frames_per_s_wall": rate("read", 1),
        "random_ms": 1e3 * float(np.median(seeks)),
        "random_p95_ms": 1e3 * float(np.quantile(seeks, 0.95)),
        "targets": TARGETS,
        "setup": {
            "driver": recorder.spec.label,
            "rounds": len(times["collect"]),
            "cameras": len(observation.cameras),
            "height": observation.height,
            "width": observation.width,
            "machine": machine(),
        },
    }


ROWS = (
    ("environment, steps/s", "environment_steps_per_s", ".0f"),
    ("collecting, steps/s", "collect_steps_per_s", ".0f"),
    ("collecting / environment", "collect_ratio", ".2f"),
    ("the same by the wall clock", "collect_ratio_wall", ".2f"),
    ("the same if only images were encoded", "ratio_if_encoding_were_all", ".2f"),
    ("encoding the images of a step, ms", "encode_ms", ".2f"),
    ("the truth of a step, ms", "truth_ms", ".2f"),
    ("bytes per step", "bytes_per_step", ",.0f"),
    ("reading frames with truth, frames/s", "frames_per_s", ".0f"),
    ("the same by the wall clock", "frames_per_s_wall", ".0f"),
    ("a frame at random, ms by the wall clock", "random_ms", ".1f"),
    ("95th percentile", "random_p95_ms", ".1f"),
)
"""Label, key, format."""


def report(figures: Mapping[str, Any]) -> str:
    """The figures as text, beside what is wanted."""
    setup = figures["setup"]
    lines = [
        f"{setup['cameras']} JPEG images of {setup['height']} x {setup['width']}; {setup['rounds']} episodes, driver: "
        f"{setup['driver']}",
        f"one thread of {setup['machine']['processor']}, load {setup['machine']['load']}; per second of processor time",
        "",
    ]
    for label, key, form in ROWS:
        sign = "at most" if key == "random_ms" else "at least"
        wanted = f"   wanted {sign} {TARGETS[key]:g}" if key in TARGETS else ""
        lines.append(f"{label:<42}{figures[key]:>12{form}}{wanted}")
    return "\n".join(lines)


def _in_process(arguments: Sequence[str]) -> dict[str, Any]:
    """The figures from a process of one thread."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "result.json"
        command = [sys.executable, "-m", "me3bev_cli.bench.logs", *arguments, "--here", "--json", str(path)]
        environment = os.environ | dict.fromkeys(THREAD_VARIABLES, "1")
        done = subprocess.run(command, env=environment, check=False)
        if done.returncode:
            raise SystemExit(done.returncode)
        found: dict[str, Any] = json.loads(path.read_text())
    return found


def _measured(given: argparse.Namespace) -> dict[str, Any]:
    """The figures, from the options. Raises UserError for what is not there."""
    from me3bev_cli.evaluation.choice import choose_cells, choose_driver, reference_or_run
    from me3bev_cli.recording.collect import Recorder

    name, run = reference_or_run(given.driver)
    spec, recipe = choose_driver(run, "last", name, given.recipe, "cpu")
    cells = choose_cells(recipe, given.map, given.density, None, "training")
    with tempfile.TemporaryDirectory() as folder:
        recorder = Recorder(cells.world, spec, 0, Path(folder))
        return measure(recorder, cells.maps[0], cells.densities[0], given.rounds)


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure, print, and write the figures where `--json` says."""
    parser = argparse.ArgumentParser(
        prog="python -m me3bev_cli.bench.logs", description=(__doc__ or "").splitlines()[0]
    )
    parser.add_argument("--json", metavar="FILE", help="write the figures here, - for stdout")
    parser.add_argument(
        "--driver", default="autopilot", help="autopilot, idle, untrained or a run (default: %(default)s)"
    )
    parser.add_argument("--recipe", help="observation and world of a driver that is no run")
    parser.add_argument("--map", default="T3", help="(default: %(default)s)")
    parser.add_argument("--density", default="low", help="(default: %(default)s)")
    parser.add_argument("--rounds", type=int, default=8, help="episodes (default: %(default)s)")
    parser.add_argument("--here", action="store_true", help=argparse.SUPPRESS)
    given = parser.parse_args(arguments)
    try:
        figures = _measured(given) if given.here else _in_process(arguments or sys.argv[1:])
    except UserError as error:
        print(f"{parser.prog}: {error}", file=sys.stderr)
        return 2
    if given.json is not None:
        write_json(figures, given.json)
    if not given.here:
        print(report(figures), file=sys.stderr if given.json == "-" else sys.stdout)
    return 0


if __name__ == "__main__":
    sys.exit(main())

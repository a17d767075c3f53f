"""Speed of the temporal modules: `python -m me3bev_cli.bench.temporal [--json FILE]`.

One thread, medians of callables that take turns within one process. Compared are one streaming step of three Mamba
modalities, forward and backward of a block over 64 sequences of 16 frames, and one step after a long context with a
step after a short one and with a transformer that reads the long window anew. The peer is mambapy, where it is
installed (`pip install 'me3bev[bench]'`).

The measuring process is given a memory allocator that keeps what it has freed (glibc's own settings), since page
faults would otherwise double the times of training, of all contestants alike.
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

from me3bev_cli.output import write_json
from me3bev_cli.workers import THREAD_VARIABLES

ALLOCATOR = {
    "MALLOC_MMAP_THRESHOLD_": "1000000000",
    "MALLOC_TRIM_THRESHOLD_": "2000000000",
    "MALLOC_TOP_PAD_": "67108864",
}
SHORT, LONG = 4, 1024
"""Frames of the two contexts."""
STEPS_PER_TURN = 20
TURNS_PER_ROUND = 5
"""Of steps, which are much shorter than a training pass."""
WARMUP = 2

Times = dict[str, list[float]]

RATIOS = {
    "step_native_ratio": ("step", "mambapy", "native", "streaming step, three modalities: mambapy / native", 7.0),
    "step_torch_ratio": ("step", "mambapy", "torch", "streaming step, three modalities: mambapy / torch", 2.0),
    "train_native_ratio": ("train", "mambapy", "native", "forward + backward, 64 x 16: mambapy / native", 7.0),
    "train_torch_ratio": ("train", "mambapy", "torch", "forward + backward, 64 x 16: mambapy / torch", 2.0),
    "window_ratio": (
        "context",
        "transformer_window",
        "step_long",
        "transformer's window of 1024 / Mamba's step",
        100.0,
    ),
    "context_ratio": ("context", "step_long", "step_short", "step after 1024 frames / after 4 (at most)", 1.05),
    "products_ratio": ("step", "native", "products", "streaming step, native / its products of matrices alone", None),
}
"""Key -> group, what is divided by what, the text, and what is wanted: at least, for `context_ratio` at most."""


def take_turns(contestants: Mapping[str, Callable[[], Any]], times: Times, repeats: int) -> None:
    """Each in turn, `repeats` calls at a time, seconds per call; another begins each time.

    Where calls are short, one more goes before, so that none pays for what the caches held of its predecessor.
    """
    names = list(contestants)
    done = len(times.setdefault(names[0], []))
    for name in (*names[done % len(names) :], *names[: done % len(names)]):
        if repeats > 1:
            contestants[name]()
        begun = time.perf_counter()
        for _ in range(repeats):
            contestants[name]()
        times.setdefault(name, []).append((time.perf_counter() - begun) / repeats)


def ratios(times: Mapping[str, Times]) -> dict[str, float]:
    """Each of `RATIOS` whose two were measured: the median over the turns of their quotient in one turn.

    What did not take turns with each other (a window and the steps) is compared by its medians.
    """
    found = {}
    for key, (group, above, below, _, _) in RATIOS.items():
        if {above, below} <= times[group].keys():
            slow, fast = times[group][above], times[group][below]
            if len(slow) == len(fast):
                found[key] = _median([a / b for a, b in zip(slow, fast, strict=True)])
            else:
                found[key] = _median(slow) / _median(fast)
    return found


def _median(values: Sequence[float]) -> float:
    from statistics import median

    return median(values)


def measure(width: int, rounds: int) -> dict[str, Any]:
    """All figures, in this process, as `--json` writes them."""
    import torch

    from me3bev_cli.bench.machine import machine
    from me3bev_cli.bench.temporal_contestants import contexts, steps, trainings

    torch.set_num_threads(1)
    streams, batches, long = steps(width), trainings(width), contexts(width, SHORT, LONG)
    window = {"transformer_window": long.pop("transformer_window")}
    times: dict[str, Times] = {}
    for turn in range(WARMUP + rounds):
        if turn in (0, WARMUP):
            times = {"step": {}, "train": {}, "context": {}}
        for _ in range(TURNS_PER_ROUND):
            take_turns(streams, times["step"], STEPS_PER_TURN)
            take_turns(long, times["context"], STEPS_PER_TURN)
        take_turns(batches, times["train"], 1)
        take_turns(window, times["context"], 1)
    return {
        "ratios": ratios(times),
        "targets": {key: row[4] for key, row in RATIOS.items()},
        "median_ms": {
            group: {name: 1000 * _median(values) for name, values in by_name.items()}
            for group, by_name in times.items()
        },
        "setup": {
            "width": width,
            "rounds": rounds,
            "threads": torch.get_num_threads(),
            "torch": torch.__version__,
            "machine": machine(),
        },
    }


def report(result: Mapping[str, Any]) -> str:
    """The figures as text, each ratio beside what is wanted."""
    setup = result["setup"]
    lines = [f"{setup['machine']['processor']}, 1 thread, float32, width {setup['width']}, torch {setup['torch']}", ""]
    for group, title in (("step", "one step of three modalities"), ("train", "64 x 16"), ("context", "one module")):
        cells = ", ".join(f"{name} {value:.3f}" for name, value in result["median_ms"][group].items())
        lines.append(f"{title}, ms: {cells}")
    lines.append("")
    for key, (_, _, _, text, target) in RATIOS.items():
        if key in result["ratios"]:
            wanted = "" if target is None else f"wanted {target:g}"
            lines.append(f"{text:<66} {result['ratios'][key]:9.2f}   {wanted}".rstrip())
    if "mambapy" not in result["median_ms"]["step"]:
        lines.append("mambapy is not installed: pip install 'me3bev[bench]' to compare with it")
    return "\n".join(lines)


def _in_process(width: int, rounds: int) -> dict[str, Any]:
    """`measure` in a process of one thread with the allocator's settings, which are read when it starts."""
    environment = os.environ | ALLOCATOR | dict.fromkeys(THREAD_VARIABLES, "1")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "result.json"
        command = [sys.executable, "-m", "me3bev_cli.bench.temporal", "--here", "--json", str(path)]
        subprocess.run([*command, "--width", str(width), "--rounds", str(rounds)], env=environment, check=True)
        found: dict[str, Any] = json.loads(path.read_text())
    return found


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure, print, and write the figures where `--json` says."""
    parser = argparse.ArgumentParser(prog="python -m me3bev_cli.bench.temporal", description=__doc__.splitlines()[0])
    parser.add_argument("--json", metavar="FILE", help="write the figures here, - for stdout")
    parser.add_argument("--width", type=int, default=256, help="numbers per vector (default: %(default)s)")
    parser.add_argument("--rounds", type=int, default=15, help="turns of each (default: %(default)s)")
    parser.add_argument("--here", action="store_true", help=argparse.SUPPRESS)
    given = parser.parse_args(arguments)
    result = (measure if given.here else _in_process)(given.width, given.rounds)
    if given.json is not None:
        write_json(result, given.json)
    if not given.here:
        print(report(result))
    return 0


if __name__ == "__main__":
    sys.exit(main())

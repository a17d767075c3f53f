"""Speed of the way from images to the bird's-eye grid: `python -m me3bev_cli.bench.spatial [--json FILE]`.

Three questions, each answered within one process by callables that take turns, call by call:

- the splat alone (depth and context to grid) against the published cumulative sum (`bench/cumulative_sum.py`);
- one step of the policy, from uint8 images to a decision, each frame encoded once, against the same network that
  encodes its window's frames anew at every step and splats them by that cumulative sum (in one batch or one by one,
  whichever is faster);
- one step against the floor that its floating-point operations have at the measured rate of matrix products, with the
  recipe's trunk and with a ResNet.

Beside them: what bf16 and the order in memory change, in time and in the outputs.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import torch

from me3bev_cli.bench.machine import machine
from me3bev_cli.bench.machine_ceilings import Ceilings
from me3bev_cli.bench.spatial_contestants import Encoders, Splats, Steps
from me3bev_cli.errors import UserError
from me3bev_cli.output import write_json
from me3bev_cli.recipe_loading import resolve_recipe

TARGETS = {"splat_ratio": 15.0, "step_ratio": 3.5, "resnet_floor_ratio": 2.0}
"""What is wanted: at least, and for `resnet_floor_ratio` at most."""
WARMUP = 2
SPLATS = 5
"""Turns of the splats in each round; they are short."""

Callables = Mapping[str, Callable[[], Any]]
Times = dict[str, list[float]]


def take_turns(contestants: Callables, times: Times, turns: int = 1) -> None:
    """Call each in turn and note its seconds; another begins each time."""
    names = list(contestants)
    for _ in range(turns):
        done = len(times.setdefault(names[0], []))
        for name in (*names[done % len(names) :], *names[: done % len(names)]):
            begun = time.perf_counter()
            contestants[name]()
            times.setdefault(name, []).append(time.perf_counter() - begun)


def measure(recipe: str, sets: Sequence[str], resnet: str, rounds: int) -> dict[str, Any]:
    """All figures of a recipe, as `--json` writes them.

    Args:
        recipe: name or file; its spatial plugin must have a splat.
        sets: changes of it, as `key=value`.
        resnet: the trunk that is put in place of the recipe's for the floor.
        rounds: timed turns of each.
    """
    chosen, other = (resolve_recipe(recipe, [*sets, *more]) for more in ([], [f"spatial.trunk={resnet}"]))
    steps, splats = Steps(chosen, other), Splats(chosen)
    encoders = Encoders({"recipe": chosen, "resnet": other})
    ceilings = Ceilings(torch.device("cpu"), torch.float32)
    groups: list[tuple[Callables, int]] = [
        (splats.forward, SPLATS),
        (splats.backward, 1),
        (steps.contestants, 1),
        (encoders.contestants, 1),
    ]
    times: Times = {}
    for number in range(WARMUP + rounds):
        if number == WARMUP:
            times.clear()
        for contestants, turns in groups:
            take_turns(contestants, times, turns)
        ceilings.sample()
        _show(number + 1, WARMUP + rounds)
    report = _figures(times, steps.flops, ceilings)
    return report | {
        "encoder_parts": encoders.parts(),
        "bf16_error": encoders.errors(),
        "setup": {
            "recipe": chosen.name,
            "resnet": resnet,
            "sets": list(sets),
            "threads": torch.get_num_threads(),
            "rounds": rounds,
            "torch": torch.__version__,
            "machine": machine(),
        },
        "ceilings": ceilings.report(),
        "targets": TARGETS,
    }


def _figures(times: Times, flops: Mapping[str, int], ceilings: Ceilings) -> dict[str, Any]:
    """Medians in milliseconds, and ratios of those that took turns: their quartiles, and that of the fastest turns."""
    ways = ("step_encoding_anew", "step_encoding_anew_singly")
    anew = min(ways, key=lambda way: float(np.median(times[way])))
    pairs = {
        "splat_ratio": ("splat_cumulative_sum", "splat"),
        "splat_sorted_ratio": ("splat_cumulative_sum_sorted", "splat"),
        "splat_backward_ratio": ("splat_cumulative_sum_backward", "splat_backward"),
        "step_ratio": (anew, "step"),
        "bf16_ratio": ("encode_recipe", "encode_recipe_bf16"),
        "resnet_bf16_ratio": ("encode_resnet", "encode_resnet_bf16"),
        "channels_last_ratio": ("encode_recipe_plain_order", "encode_recipe"),
        "resnet_channels_last_ratio": ("encode_resnet_plain_order", "encode_resnet"),
    }
    ratios = {key: np.array(times[slow]) / np.array(times[fast]) for key, (slow, fast) in pairs.items()}
    floors = {name: 1000 * count / ceilings.flops_per_s for name, count in flops.items()}
    medians = {name: 1000 * float(np.median(values)) for name, values in times.items()}
    least = {name: 1000 * min(values) for name, values in times.items()}
    # Where others use the machine, medians of several threads measure the waiting for each other as well.
    fastest = {key: least[slow] / least[fast] for key, (slow, fast) in pairs.items()} | {
        key: least[name] * max(ceilings.multiply) / flops[name] / 1000
        for key, name in (("floor_ratio", "step"), ("resnet_floor_ratio", "step_resnet"))
    }
    return {
        **{key: float(np.median(values)) for key, values in ratios.items()},
        "floor_ratio": medians["step"] / floors["step"],
        "resnet_floor_ratio": medians["step_resnet"] / floors["step_resnet"],
        "floor_ms": floors,
        "flops": dict(flops),
        "median_ms": medians,
        "least_ms": least,
        "fastest": fastest,
        "spread": {key: [float(q) for q in np.percentile(values, [25, 75])] for key, values in ratios.items()},
    }


def _show(done: int, total: int) -> None:
    """A counter on stderr, in a terminal only."""
    if sys.stderr.isatty():
        sys.stderr.write(f"\rround {done}/{total}" + ("\r\x1b[2K" if done == total else ""))
        sys.stderr.flush()


def lines(report: Mapping[str, Any]) -> list[str]:
    """The report for people."""
    median, setup = report["median_ms"], report["setup"]

    def row(text: str, key: str, wanted: str = "") -> str:
        low, high = report["spread"].get(key, (None, None))
        spread = f"({low:.1f}-{high:.1f})" if low is not None else ""
        return f"{text:58} {report[key]:6.2f} {spread:13} {report['fastest'][key]:6.2f}{wanted}"

    parts = "; ".join(
        f"{name}: {', '.join(f'{part} {flops / 1e9:.2f}' for part, flops in found.items())}"
        for name, found in report["encoder_parts"].items()
    )
    errors = "; ".join(
        f"{name}: {', '.join(f'{output} {error:.3%}' for output, error in found.items())}"
        for name, found in report["bf16_error"].items()
    )
    return [
        f"recipe {setup['recipe']}, {setup['threads']} threads, batch 1, {setup['rounds']} rounds of turns, "
        f"torch {setup['torch']}; ratios: medians (quartiles) over the turns, and of the fastest turns",
        row("splat: cumulative sum / ours", "splat_ratio", "   wanted: 15 or more"),
        row("splat: cumulative sum over points sorted before / ours", "splat_sorted_ratio"),
        row("splat, forward and backward: cumulative sum / ours", "splat_backward_ratio"),
        row("step: encoding the window anew / once", "step_ratio", "   wanted: 3.5 or more"),
        row("step / floor of its operations", "floor_ratio"),
        row(f"step with {setup['resnet']} / floor", "resnet_floor_ratio", "   wanted: 2 or less"),
        row("encoder: fp32 / bf16", "bf16_ratio"),
        row(f"encoder with {setup['resnet']}: fp32 / bf16", "resnet_bf16_ratio"),
        row("encoder: plain order / channels last", "channels_last_ratio"),
        row(f"encoder with {setup['resnet']}: plain order / channels last", "resnet_channels_last_ratio"),
        "medians, ms: " + ", ".join(f"{name} {value:.2f}" for name, value in median.items()),
        f"GFLOP of the parts: {parts}",
        f"error of bf16 against fp32: {errors}",
    ]


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure and print; 2 for a mistake of the user."""
    parser = argparse.ArgumentParser(
        prog="python -m me3bev_cli.bench.spatial", description="Time the splat, the step and the encoders."
    )
    parser.add_argument("--recipe", default="me3bev", help="name or file")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="change the recipe")
    parser.add_argument("--resnet", default="resnet18", help="trunk for the floor")
    parser.add_argument("--rounds", type=int, default=15)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--json", metavar="FILE|-")
    options = parser.parse_args(arguments)
    before = torch.get_num_threads()
    torch.set_num_threads(options.threads)
    try:
        report = measure(options.recipe, options.set, options.resnet, options.rounds)
    except UserError as error:
        sys.stderr.write(f"{error}\n")
        return 2
    finally:
        torch.set_num_threads(before)
    (sys.stderr if options.json == "-" else sys.stdout).write("\n".join(lines(report)) + "\n")
    if options.json:
        write_json(report, options.json)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())

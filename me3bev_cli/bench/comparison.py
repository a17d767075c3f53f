"""`make comparison`: the paper's comparison from nothing, in parts that each go on where they were stopped.

Every part is a `me3bev` command that a user could type; before the first one there is a word on how long all of them
take, from what they took on the machine of `COSTS`. No torch here.
"""

from __future__ import annotations

import argparse
import json
import os
import shlex
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from me3bev_cli.bench.comparison_results import write_results
from me3bev_cli.evaluation.folder import JSON
from me3bev_cli.training.batch import COMMAND
from me3bev_cli.training.listing import finished
from me3bev_cli.training.pace import clock
from me3bev_cli.training.run import runs_root

FIRST = "small/me3bev"
"""Whose eyes all those have that look from above."""
BASELINE = "small/e2e_cla"
FLAT = (BASELINE, "small/me3bev_without_ssa")
LOOKING = (
    "small/me3bev_without_tafm",
    "small/me3bev_gru",
    "small/me3bev_lstm",
    "small/me3bev_transformer",
)
SCRATCH = ("scratch/me3bev", "scratch/me3bev_without_tafm", "scratch/e2e_cla", "scratch/me3bev_without_ssa")

CELLS, REFERENCES = 14, 4
"""Maps x densities; drivers that nobody trained."""
COSTS = {
    "perception": 3900.0,
    "looking": 1800.0,
    "flat": 3700.0,
    "looking from scratch": 2250.0,
    "flat from scratch": 5300.0,
    "episode": 1.9,
    "flat episode": 0.5,
}
"""Seconds of one core of a shared Xeon (from scratch: EPYC) with AVX-512: of a perception stage, of those after it,
of a recipe that has none, both again by PPO alone, of an episode."""


@dataclass(frozen=True)
class Part:
    """One command and what it takes."""

    name: str
    words: tuple[str, ...]
    """After `me3bev`."""
    makes: tuple[Path, ...]
    """Runs, or files that are there when it is finished."""
    seconds: float
    """On the cores that it uses."""
    made_from: tuple[Path, ...] = ()
    """Files; when one of them is newer than what was made, it is made again."""
    episodes: int | None = None
    """What an evaluation drove of each map and density."""

    @property
    def done(self) -> bool:
        """Whether everything that it makes is there, as it is asked for."""
        there = all(path.is_file() or (path.is_dir() and finished(path)) for path in self.makes)
        return there and not self._outdated()

    def _outdated(self) -> bool:
        if self.episodes is not None:
            return any(json.loads(path.read_text(encoding="utf-8"))["episodes"] != self.episodes for path in self.makes)
        sources = [path.stat().st_mtime_ns for path in self.made_from if path.is_file()]
        return any(path.stat().st_mtime_ns < max(sources, default=0) for path in self.makes)

    @property
    def command(self) -> str:
        """As a user would type it."""
        return shlex.join(("me3bev", *self.words))


def run_of(out: Path, recipe: str, seed: int = 0) -> Path:
    """Where `me3bev train --seeds` keeps a run of a shipped recipe."""
    return out / f"{recipe.replace('/', '-')}-seed{seed}"


def parts(out: Path, cores: int, episodes: int = 100) -> list[Part]:
    """Everything, in order.

    Args:
        out: where runs and evaluations are kept.
        cores: how many runs are trained beside each other, and evaluated by.
        episodes: for each map and density.
    """
    first = [run_of(out, name) for name in (FIRST, *FLAT, *LOOKING)]
    second = [run_of(out, name, 1) for name in (FIRST, BASELINE)]
    scratch = [run_of(out, name) for name in SCRATCH]
    return [
        *_trainings(out, cores),
        _evaluation("the table", out / "eval", [*first, *second], run_of(out, BASELINE), cores, episodes),
        _evaluation("the table from scratch", out / "eval-scratch", scratch, scratch[2], cores, episodes),
        _convergence(out, "convergence", [*first, *second]),
        _convergence(out, "convergence-scratch", scratch),
        _latency(out, first),
        _page(out),
    ]


def _trainings(out: Path, cores: int) -> list[Part]:
    perception, looking, flat = COSTS["perception"], COSTS["looking"], COSTS["flat"]
    eyes = ("--perception", str(run_of(out, FIRST)))

    def train(name: str, recipes: Sequence[str], seed: int, seconds: float, *more: str) -> Part:
        words = ("train", *recipes, "--seeds", str(seed), *more, "--out", str(out))
        return Part(name, words, tuple(run_of(out, recipe, seed) for recipe in recipes), seconds)

    alone = 2 * (COSTS["flat from scratch"] + COSTS["looking from scratch"])
    beside = ("--threads", "1", "--parallel", str(cores))
    others, twice = (*FLAT, *LOOKING), (FIRST, BASELINE)
    shared = len(FLAT) * flat + len(LOOKING) * looking
    return [
        # Alone it has all threads, which perception gains from and the rest hardly; said, since OMP_NUM_THREADS is 1.
        train("perception and the first policy", (FIRST,), 0, perception / cores + looking, "--threads", str(cores)),
        train("the other methods", others, 0, shared / cores, *eyes, *beside),
        train("the second seed", twice, 1, max(perception + looking, flat), *beside),
        train("ppo from scratch", SCRATCH, 0, alone / cores, *eyes, *beside),
    ]


def _evaluation(name: str, place: Path, runs: Sequence[Path], baseline: Path, cores: int, episodes: int) -> Part:
    flat = sum(any(kind.partition("/")[2] in run.name for kind in FLAT) for run in runs)
    each = flat * COSTS["flat episode"] + (len(runs) - flat) * COSTS["episode"] + REFERENCES * COSTS["flat episode"]
    named = [word for run in runs for word in ("--run", str(run))]
    words = (
        "eval", *named, "--reference", "all", "--baseline", str(baseline), "--paper", "--maps", "T1-T7",
        "--density", "low,high", "--episodes", str(episodes), "--workers", str(cores), "--out", str(place),
    )  # fmt: skip
    return Part(name, words, (place / JSON,), CELLS * episodes * each / cores, episodes=episodes)


def _convergence(out: Path, name: str, runs: Sequence[Path]) -> Part:
    picture, figures = out / f"{name}.png", out / f"{name}.json"
    words = ("plot", *map(str, runs), "--out", str(picture), "--json", str(figures))
    return Part(name, words, (picture, figures), 20)


def _latency(out: Path, runs: Sequence[Path]) -> Part:
    target = out / "latency.json"
    words = ("bench-latency", *map(str, runs), "--threads", "1", "--json", str(target))
    return Part("latency", words, (target,), 150)


def _page(out: Path) -> Part:
    shown, latency = out / "eval", out / "latency.json"
    words = ("report", str(shown), "--latency", str(latency), "--out", str(out / "report"))
    return Part("the page", words, (out / "report" / "index.html",), 600, made_from=(shown / JSON, latency))


def plan_text(planned: Sequence[Part], cores: int) -> str:
    """What there is to do and how long it takes."""
    lines = [f"the comparison, in {len(planned)} parts, on {cores} cores like those of the record (h:mm:ss or m:ss):"]
    for part in planned:
        time = "done" if part.done else f"about {clock(part.seconds)}"
        lines.append(f"  {part.name}: {time}\n    {part.command}")
    left = sum(part.seconds for part in planned if not part.done)
    lines.append(f"left: about {clock(left)}; Ctrl-C stops, the same command goes on")
    return "\n".join(lines)


def main(arguments: Sequence[str] | None = None) -> int:
    """Say how long it takes, run what is not done, write the figures; the exit code."""
    parser = argparse.ArgumentParser(prog="python -m me3bev_cli.bench.comparison", description=__doc__)
    parser.add_argument("--out", type=Path, default=runs_root() / "comparison", help="where runs and evaluations go")
    parser.add_argument("--results", type=Path, help="write the figures, small, into this folder")
    parser.add_argument("--episodes", type=int, default=100, help="for each map and density")
    parser.add_argument("--plan", action="store_true", help="only say what there is to do")
    given = parser.parse_args(arguments)
    cores = os.cpu_count() or 1
    planned = parts(given.out, cores, given.episodes)
    print(plan_text(planned, cores), flush=True)
    if given.plan:
        return 0
    for part in planned:
        if part.done:
            continue
        print(f"\n{part.name}: {part.command}", flush=True)
        try:
            code = subprocess.run((*COMMAND, *part.words), env=os.environ | {"OMP_NUM_THREADS": "1"}).returncode
        except KeyboardInterrupt:
            code = 130
        if code:
            print(f"me3bev: stopped in '{part.name}'; the same command goes on", file=sys.stderr)
            return code
    for path in write_results(given.out, given.results or given.out, {part.name: part.command for part in planned}):
        print(f"wrote {path}")
    return 0


if __name__ == "__main__":
    sys.exit(main())

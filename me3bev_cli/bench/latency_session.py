"""`me3bev bench-latency` from its options to its figures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import torch

from me3bev_cli.bench.latency import Effort, measure
from me3bev_cli.bench.latency_network import Conditions
from me3bev_cli.bench.latency_progress import LatencyProgress
from me3bev_cli.bench.latency_rows import Row, rows
from me3bev_cli.bench.latency_scores import FOLDER, Point, Score, points, scores
from me3bev_cli.bench.latency_subjects import Subject, every_pair, named
from me3bev_cli.bench.latency_tables import NOT_TIMED, SHARED, TIMED
from me3bev_cli.bench.machine import machine
from me3bev_cli.errors import UserError
from me3bev_cli.evaluation.results import JSON
from me3bev_cli.pipeline.assemble import pick_device
from me3bev_cli.pretrained import NAME, box, results_home
from me3bev_cli.stopping import Stop
from me3bev_cli.training.checkpoint import checkpoints
from me3bev_cli.training.run import is_run, runs_root, versions

DTYPES = {"fp32": torch.float32, "bf16": torch.bfloat16}


@dataclass(frozen=True)
class Plan:
    """What is measured, and how."""

    subjects: Sequence[Subject]
    conditions: Conditions
    effort: Effort
    lengths: Sequence[int] | None
    skipped: Sequence[str] = ()
    """Lines about plugins that cannot take part."""
    scores: Sequence[Score] = ()


@dataclass(frozen=True)
class Outcome:
    """What was found."""

    report: dict[str, Any]
    """What `--json` writes."""
    rows: Sequence[Row]
    stopped: bool
    points: Sequence[Point] = field(default=())

    @property
    def title(self) -> str:
        """For pictures."""
        setup = self.report["setup"]
        threads = (
            f"{setup['threads']} thread{'s' if setup['threads'] > 1 else ''}, " if setup["device"] == "cpu" else ""
        )
        return f"raw observation to action: {setup['device']}, {threads}{setup['dtype']}, batch {setup['batch']}"

    def picture(self, budget_ms: float | None) -> bytes:
        """Latency by context, and stages, as PNG."""
        from me3bev_cli.bench.latency_picture import latency_picture

        return latency_picture(self.rows, self.title, budget_ms)

    def score_picture(self) -> bytes:
        """Speed against driving score, as PNG."""
        from me3bev_cli.bench.latency_picture import score_picture

        return score_picture(self.points, f"speed and driving score; {self.title.partition(': ')[2]}")


def prepare(
    sources: Sequence[str],
    lengths: Sequence[int] | None,
    *,
    batch: int,
    threads: int | None,
    dtype: str,
    device: str,
    graphs: bool,
    effort: Effort,
    with_scores: bool,
) -> Plan:
    """Check every option before anything is built; from here on torch uses `threads`.

    Raises:
        UserError: a source or the device is not there, or no run has scores.
    """
    place = pick_device(device)
    if place.type == "cuda":
        # Streams, graphs and memory statistics are the current device's.
        torch.cuda.set_device(place)
    skipped: list[str] = []
    if sources or with_scores:
        subjects = named(sources or _evaluated_runs())
    else:
        subjects, skipped = every_pair()
        subjects = [*named([NAME]), *subjects]
    found = scores(subjects) if with_scores else []
    if threads is not None:
        torch.set_num_threads(threads)
    return Plan(subjects, Conditions(place, DTYPES[dtype], batch, graphs), effort, lengths, skipped, found)


def _evaluated_runs() -> list[str]:
    """Every run that has a checkpoint and results of an evaluation."""
    root = runs_root()
    runs = [path for path in sorted(root.iterdir()) if is_run(path)] if root.is_dir() else []
    found = [str(run) for run in runs if checkpoints(run) and any((run / FOLDER).rglob(JSON))]
    found += [NAME] if any((results_home(box()) / FOLDER).rglob(JSON)) else []
    if not found:
        raise UserError(
            f"there is no evaluated run under {root}", where="--with-scores", hint="`me3bev eval --run RUN` makes one"
        )
    return found


def run(plan: Plan) -> Outcome:
    """Measure; Ctrl-C ends it after the frame that is under way."""
    here, progress, stop = machine(), LatencyProgress(), Stop()
    with stop.listening():
        measured = measure(plan.subjects, plan.conditions, plan.effort, plan.lengths, progress, lambda: stop.asked)
    progress.end()
    found = rows(measured)
    report = {
        "setup": _setup(plan),
        "machine": here,
        "versions": versions(),
        "ceilings": measured.ceilings.report(),
        "stopped": measured.stopped,
        "left_out": list(plan.skipped),
        "rows": found,
    }
    compared = points(plan.scores, found)
    if plan.scores:
        report["scores"] = [vars(point.score) | vars(point) | {"score": point.score.mean} for point in compared]
    return Outcome(report, found, measured.stopped, compared)


def _setup(plan: Plan) -> dict[str, Any]:
    conditions, cuda = plan.conditions, plan.conditions.device.type == "cuda"
    return {
        "timed": TIMED,
        "not_timed": NOT_TIMED,
        "shared": SHARED,
        "device": torch.cuda.get_device_name(conditions.device) if cuda else conditions.device.type,
        "graphs": conditions.graphs if cuda else None,
        "threads": torch.get_num_threads(),
        "dtype": str(conditions.dtype).removeprefix("torch."),
        "batch": conditions.batch,
        "warmup": plan.effort.warmup,
        "repeats": plan.effort.repeats,
        "seconds": plan.effort.seconds,
    }

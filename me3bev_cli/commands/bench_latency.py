"""`me3bev bench-latency`: time from raw observation to action, by network, stage and context."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from me3bev_cli.errors import UserError, unknown_name

if TYPE_CHECKING:
    from me3bev_cli.bench.latency_session import Outcome, Plan

OVER_BUDGET = 3
"""Exit code."""
WIDTH = 160
"""Columns that hold every table."""


def bench_latency(
    sources: Annotated[
        list[str] | None,
        typer.Argument(
            help="Recipes, run or checkpoint folders, `pretrained`. Default: that and every pair at full size.",
            metavar="RECIPE|RUN",
        ),
    ] = None,
    context: Annotated[
        str | None,
        typer.Option(help="Frames, as window and as stream. Default: 4,16,64,256,1024 and each recipe's own."),
    ] = None,
    batch: Annotated[int, typer.Option(help="Observations per call.", min=1)] = 1,
    threads: Annotated[int | None, typer.Option(help="CPU threads. Default: as torch chooses.", min=1)] = None,
    dtype: Annotated[str, typer.Option(help="fp32, or bf16 by autocast.")] = "fp32",
    device: Annotated[str, typer.Option(help="auto, cpu or cuda.")] = "auto",
    graphs: Annotated[bool, typer.Option(help="On CUDA: graphs where they apply.")] = True,
    repeats: Annotated[int, typer.Option(help="Timed calls of each context, at most.", min=1)] = 50,
    seconds: Annotated[float, typer.Option(help="Of timing in all; slow contexts get fewer calls.", min=0)] = 90,
    warmup: Annotated[int, typer.Option(help="Calls before the timing begins.", min=0)] = 5,
    budget_ms: Annotated[
        float | None,
        typer.Option(help="Exit with 3 if a 95th percentile exceeds it: of --context's, else of each recipe's own."),
    ] = None,
    with_scores: Annotated[
        bool, typer.Option("--with-scores", help="Speed against driving score of evaluated runs. Default: all of them.")
    ] = False,
    json: Annotated[str | None, typer.Option(help="Write the figures.", metavar="FILE|-")] = None,
    csv: Annotated[Path | None, typer.Option(help="Write the rows.", metavar="FILE")] = None,
    plot: Annotated[
        Path | None, typer.Option(help="Draw latency by context, and the stages' shares.", metavar="FILE.png")
    ] = None,
    scores_plot: Annotated[Path, typer.Option(help="Where --with-scores draws.", metavar="FILE.png")] = Path(
        "latency-scores.png"
    ),
) -> None:
    """Time networks from raw observation to clipped action, by stage and context.

    Networks take turns frame by frame in one process. Beside the times stand parameters, operations, memory and the
    distance from what the machine, measured in the same turns, could do at most. Ctrl-C prints what has been measured.
    """
    if dtype not in ("fp32", "bf16"):
        raise unknown_name("dtype", dtype, ("fp32", "bf16"), where="--dtype")
    lengths = None if context is None else _lengths(context)
    if budget_ms is not None and not budget_ms > 0:
        raise UserError(f"{budget_ms:g} ms is no budget", where="--budget-ms", allowed="milliseconds above 0")
    from me3bev_cli.bench.latency import Effort
    from me3bev_cli.bench.latency_session import prepare, run

    effort = Effort(warmup=warmup, repeats=repeats, seconds=seconds)
    plan: Plan = prepare(
        sources or [], lengths, batch=batch, threads=threads, dtype=dtype, device=device, graphs=graphs,
        effort=effort, with_scores=with_scores,
    )  # fmt: skip
    if not sources and not with_scores:
        typer.echo("me3bev: no run is named: `pretrained`, the shipped policy, stands beside every pair", err=True)
    for line in plan.skipped:
        typer.echo(f"me3bev: left out: {line}", err=True)
    outcome = run(plan)
    if not outcome.rows:
        typer.echo("me3bev: stopped: nothing has been measured yet", err=True)
        raise typer.Exit(130)
    # The tables first: a file that cannot be written costs no measurement.
    _print(outcome, json)
    _write(outcome, json, csv, plot, scores_plot, budget_ms)
    _judge(outcome, budget_ms, every=context is not None)


def _lengths(text: str) -> list[int]:
    """`4,16` -> [4, 16]."""
    words = [word.strip() for word in text.split(",")]
    for word in words:
        if not word.isdecimal() or not 1 <= int(word) <= 65536:
            raise UserError(f"'{word}' is no number of frames", where="--context", allowed="as 4,16,64; 1 to 65536")
    return [int(word) for word in words]


def _write(
    outcome: Outcome, json: str | None, csv: Path | None, plot: Path | None, scores_plot: Path, budget_ms: float | None
) -> None:
    from rich.markup import escape

    from me3bev_cli.bench.latency_rows import csv_text
    from me3bev_cli.files import atomic_write_bytes, atomic_write_text
    from me3bev_cli.output import STDOUT, console, write_json

    written = []
    if json is not None:
        write_json(outcome.report, json)
        written += [Path(json)] if json != STDOUT else []
    if csv is not None:
        atomic_write_text(csv, csv_text(outcome.rows))
        written.append(csv)
    if plot is not None:
        atomic_write_bytes(plot, outcome.picture(budget_ms))
        written.append(plot)
    if outcome.points:
        atomic_write_bytes(scores_plot, outcome.score_picture())
        written.append(scores_plot)
    for path in written:
        console(json).print(f"wrote {escape(str(path))}", soft_wrap=True)


def _print(outcome: Outcome, json: str | None) -> None:
    from me3bev_cli.bench.latency_tables import preface, score_tables, tables
    from me3bev_cli.output import console

    place = console(json)
    # A narrow terminal breaks lines; it must not cut figures off.
    place.width = max(place.width, WIDTH)
    for line in preface(outcome.report):
        place.print(line, markup=False, soft_wrap=True)
    for headline, table in [*tables(outcome.rows), *score_tables(outcome.points)]:
        place.print(f"\n{headline}", style="bold", markup=False)
        place.print(table)


def _judge(outcome: Outcome, budget_ms: float | None, every: bool) -> None:
    """Exit with 130 after Ctrl-C, else with 3 where the budget is exceeded."""
    from me3bev_cli.bench.latency_rows import over_budget
    from me3bev_cli.bench.latency_tables import context

    over = [] if budget_ms is None else over_budget(outcome.rows, budget_ms, every)
    if over:
        named = ", ".join(f"{row['name']} {context(row)} ({row['p95_ms']:.1f} ms)" for row in over)
        typer.echo(f"me3bev: over the budget of {budget_ms:g} ms at the 95th percentile: {named}", err=True)
    if outcome.stopped:
        typer.echo("me3bev: stopped: the figures are those of what had been measured", err=True)
        raise typer.Exit(130)
    if over:
        raise typer.Exit(OVER_BUDGET)

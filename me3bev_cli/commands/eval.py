"""`me3bev eval`: drive episodes and score them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from me3bev_cli.errors import UserError

if TYPE_CHECKING:
    from me3bev_cli.evaluation.gate import Gate
    from me3bev_cli.evaluation.outcome import Outcome
    from me3bev_cli.evaluation.session import Driven, Evaluation

FELL_SHORT = 3
"""Exit code when a gate is not kept."""


def evaluate(
    maps: Annotated[str | None, typer.Option(help="As T1-T7 or T1,T3. Default: every map.")] = None,
    density: Annotated[str | None, typer.Option(help="As low,high. Default: the recipe's.")] = None,
    weather: Annotated[
        str | None,
        typer.Option(help="As clear_noon,night or all, training, evaluation. Default: the recipe's evaluation set."),
    ] = None,
    run: Annotated[
        list[Path] | None,
        typer.Option(
            help="Run or checkpoint, several times. Default: the newest run, else `pretrained`.",
            metavar="RUN",
        ),
    ] = None,
    checkpoint: Annotated[str, typer.Option(help="Which of the runs' checkpoints.")] = "last",
    driver: Annotated[
        list[str] | None,
        typer.Option(
            help="autopilot, idle, random or untrained, several times; without --run in place of the newest run.",
            metavar="NAME",
        ),
    ] = None,
    reference: Annotated[
        str | None, typer.Option(help="Such drivers beside the newest run, as idle,random or all.")
    ] = None,
    recipe: Annotated[str | None, typer.Option(help="World of a --driver. Default: highway as it comes.")] = None,
    episodes: Annotated[int, typer.Option(help="For each map and density.")] = 20,
    workers: Annotated[int | None, typer.Option(help="Processes. Default: one per core.")] = None,
    seed: Annotated[int, typer.Option(help="Of routes and traffic.")] = 0,
    device: Annotated[str, typer.Option(help="Of the policy: auto, cpu or cuda.")] = "auto",
    baseline: Annotated[
        str | None,
        typer.Option(help="Compare the others with it on the same seeds.", metavar="RUN|METHOD"),
    ] = None,
    paper: Annotated[bool, typer.Option("--paper", help="Add the paper's published rows (CARLA).")] = False,
    from_logs: Annotated[
        list[Path] | None,
        typer.Option(help="Score logs instead of driving: an evaluation, or MCAP episodes.", metavar="DIR"),
    ] = None,
    gate: Annotated[
        Path | None, typer.Option(help="Exit with 3 unless every threshold in it is kept.", metavar="FILE")
    ] = None,
    out: Annotated[Path | None, typer.Option(help="Where to write. Default: RUN/eval/MAPS-DENSITY[-WEATHER].")] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Begin anew in a folder of an evaluation.")] = False,
    json: Annotated[str | None, typer.Option(help="Write the figures here too.", metavar="FILE|-")] = None,
    csv: Annotated[Path | None, typer.Option(help="Write the rows here too.", metavar="FILE")] = None,
    markdown: Annotated[Path | None, typer.Option(help="Write the tables here too.", metavar="FILE")] = None,
    latex: Annotated[Path | None, typer.Option(help="Write the paper's table here too.", metavar="FILE")] = None,
    picture: Annotated[Path | None, typer.Option(help="Write the picture here too.", metavar="FILE")] = None,
) -> None:
    """Drive episodes on maps and report the metrics of each.

    Each episode is kept as soon as it is finished: after Ctrl-C the same command goes on. `me3bev metrics` says what
    the figures mean.
    """
    for name, value, least in (("--episodes", episodes, 1), ("--workers", workers, 0), ("--seed", seed, 0)):
        if value is not None and value < least:
            raise UserError(f"{value} is too few" if least else f"{value} is negative", where=name)
    from me3bev_cli.evaluation.gate import read_gate
    from me3bev_cli.evaluation.methods import Asked, parse_references
    from me3bev_cli.evaluation.session import prepare

    thresholds = None if gate is None else read_gate(gate)
    copies = {"csv": csv, "markdown": markdown, "latex": latex, "picture": picture}
    if from_logs:
        if run or driver or reference is not None or recipe is not None:
            raise UserError("logs have been driven already", where="--from-logs", hint="Leave out --run and --driver")
        outcome, place, methods = _from_logs(from_logs, out, overwrite, baseline, paper)
        ending = ""
    else:
        asked = Asked(
            run or (), checkpoint, driver or (), parse_references(reference), recipe, device, baseline
        )  # fmt: skip
        evaluation = prepare(
            asked, maps=maps, density=density, weather=weather, episodes=episodes, seed=seed, out=out,
            overwrite=overwrite,
        )  # fmt: skip
        if thresholds is not None and gate is not None:
            _check_gate(thresholds, gate, evaluation)
        driven = _drive(evaluation, workers)
        outcome, place, methods = _score(evaluation, driven, paper), evaluation.out, evaluation.judged
        ending = f" Seed {evaluation.seed}; {driven.pace}."
    written = [] if place is None else outcome.write(place)
    written += _copies(outcome, json, copies)
    _print(outcome, json, written, ending)
    if thresholds is not None:
        _judge(thresholds, outcome, methods)


def _check_gate(gate: Gate, path: Path, evaluation: Evaluation) -> None:
    from me3bev_cli.evaluation.gate import check_names

    labels = [method.label for method in evaluation.methods]
    check_names(gate, path, evaluation.maps, evaluation.densities, labels)


def _drive(evaluation: Evaluation, workers: int | None) -> Driven:
    """Drive the episodes; Ctrl-C says what is kept."""
    from me3bev_cli.allocator import keep_freed_memory
    from me3bev_cli.evaluation.progress import EvaluationProgress
    from me3bev_cli.evaluation.session import drive, finished
    from me3bev_cli.workers import cores

    keep_freed_memory()
    total = len(evaluation.visits)
    with EvaluationProgress(total) as progress:
        try:
            driven = drive(evaluation, cores() if workers is None else workers, progress)
        except KeyboardInterrupt:
            driven = None
    if driven is None:
        done = f"{finished(evaluation)} of {total} episodes are kept in {evaluation.out}"
        typer.echo(f"me3bev: stopped: {done}; the same command goes on", err=True)
        raise typer.Exit(130)
    for sentence in driven.notes:
        typer.echo(f"me3bev: {sentence}", err=True)
    return driven


def _score(evaluation: Evaluation, driven: Driven, paper: bool) -> Outcome:
    from me3bev_cli.evaluation.outcome import Outcome, work_out

    results = work_out(driven.episodes, baseline=evaluation.baseline, paper=paper)
    return Outcome(evaluation.setup(), results, driven.snapshot)


def _from_logs(
    folders: list[Path], out: Path | None, overwrite: bool, baseline: str | None, paper: bool
) -> tuple[Outcome, Path | None, list[str]]:
    from me3bev_cli.evaluation.outcome import Outcome, work_out
    from me3bev_cli.evaluation.recompute import recover

    recovered = recover(folders, out, overwrite)
    results = work_out(recovered.episodes, baseline=baseline, paper=paper, lost=recovered.lost)
    for sentence in recovered.lost:
        typer.echo(f"me3bev: {sentence}", err=True)
    if recovered.lost:
        typer.echo(f"me3bev: the figures rest on the other {len(recovered.episodes)} episodes", err=True)
    methods = list(dict.fromkeys(episode.driver for episode in recovered.episodes))
    return Outcome(recovered.setup, results, recovered.snapshot), recovered.out, methods


def _copies(outcome: Outcome, json: str | None, copies: dict[str, Path | None]) -> list[Path]:
    """What was asked for beside the folder."""
    from me3bev_cli.files import atomic_write_bytes, atomic_write_text
    from me3bev_cli.output import STDOUT, write_json

    written = []
    if json is not None:
        write_json(outcome.document, json)
        written += [Path(json)] if json != STDOUT else []
    for kind, path in copies.items():
        if path is not None:
            content = getattr(outcome, kind)
            (atomic_write_bytes if isinstance(content, bytes) else atomic_write_text)(path, content)
            written.append(path)
    return written


def _print(outcome: Outcome, json: str | None, written: list[Path], ending: str) -> None:
    from rich.markup import escape

    from me3bev_cli.evaluation.published import NOTE
    from me3bev_cli.evaluation.tables import side_by_side, tables, weather_tables
    from me3bev_cli.output import console

    results = outcome.results
    several = len({row.method for row in results.shown}) > 1  # The published ones count.
    many_maps = len({row.map for row in results.rows}) > 1
    shown = side_by_side(results) if several else []
    if many_maps or not several:
        shown += tables(results.rows)
    place = console(json)
    for headline, table in [*shown, *weather_tables(results.by_weather)]:
        place.print(headline, style="bold", markup=False)
        place.print(table)
    place.print(f"↑ higher is better, ↓ lower; in brackets the 95 % interval.{ending}")
    if results.published:
        place.print(NOTE)
    for path in written:
        place.print(f"wrote {escape(str(path))}", soft_wrap=True)


def _judge(gate: Gate, outcome: Outcome, methods: list[str]) -> None:
    from me3bev_cli.evaluation.gate import shortfalls

    found = shortfalls(gate, outcome.results.rows, methods)
    for shortfall in found:
        typer.echo(f"me3bev: fell short: {shortfall.text}", err=True)
    if found:
        raise typer.Exit(FELL_SHORT)
    typer.echo(f"me3bev: the gate is kept: {len(gate.thresholds)} thresholds", err=True)

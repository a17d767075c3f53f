"""`me3bev train`: train a recipe's policy, several with several seeds, or go on with what was begun."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from me3bev_cli.errors import UserError

if TYPE_CHECKING:
    from me3bev_cli.recipe import Recipe
    from me3bev_cli.training.trainer import Trainer


def train(
    recipes: Annotated[
        list[str] | None, typer.Argument(help="Recipe files or names of shipped recipes.", metavar="[RECIPE]...")
    ] = None,
    resume: Annotated[
        Path | None, typer.Option(help="Go on with this run, or with every run of a batch's folder.", metavar="RUN|DIR")
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(help="Folder of the new run, by default runs/NAME-DATE-TIME; of a batch: runs."),
    ] = None,
    overrides: Annotated[
        list[str] | None, typer.Option("--set", help="Override a key of the recipe.", metavar="KEY=VALUE")
    ] = None,
    perception: Annotated[
        Path | None,
        typer.Option(help="A run with the same perception, or `pretrained`: its eyes are taken.", metavar="RUN"),
    ] = None,
    seeds: Annotated[
        str | None, typer.Option(help="As 0,1,2: a batch, one run NAME-seedK for each recipe and seed.")
    ] = None,
    parallel: Annotated[int, typer.Option(help="Runs of a batch at a time.", min=1)] = 1,
    threads: Annotated[int | None, typer.Option(help="CPU threads for the network. Default: all cores.", min=1)] = None,
    json: Annotated[str | None, typer.Option(help="Write the summary.", metavar="FILE|-")] = None,
) -> None:
    """Train the policy of a recipe; with several recipes or seeds a batch, which the same command goes on with."""
    recipes = recipes or []
    if bool(recipes) == (resume is not None):
        raise UserError("name a recipe to train or a run to go on with", hint="`me3bev train RECIPE` or `--resume RUN`")
    if resume is not None and (overrides or seeds is not None or perception is not None):
        where = "--set" if overrides else "--seeds" if seeds is not None else "--perception"
        raise UserError("a run goes on with its own recipe", where=where, hint="Start a new run to change it")
    from me3bev_cli.recipe_loading import resolve_recipe
    from me3bev_cli.training import batch
    from me3bev_cli.training.run import choose_run, is_run, open_run

    if resume is not None and not is_run(resume) and (found := batch.unfinished(resume)):
        _batch(found, parallel, threads, json)
    elif resume is not None:
        run = open_run(resume)
        _run(resolve_recipe(str(run / "recipe.yaml")), run, threads, json)
    elif len(recipes) > 1 or seeds is not None:
        _batch(batch.prepare(recipes, seeds, overrides or [], out, perception), parallel, threads, json)
    elif parallel > 1:
        raise UserError("there is one run only", where="--parallel", hint="--seeds 0,1,2 makes a batch")
    else:
        loaded = resolve_recipe(recipes[0], overrides or [])
        _run(loaded, choose_run(loaded, out), threads, json, perception)


def _batch(runs: list[Path], parallel: int, threads: int | None, json_target: str | None) -> None:
    """Train every run that is not finished, and show what has become of all."""
    from me3bev_cli.commands.runs import table
    from me3bev_cli.output import console, write_json
    from me3bev_cli.stopping import Stop
    from me3bev_cli.training.batch import Batch
    from me3bev_cli.training.listing import describe

    stop = Stop()
    with stop.listening():
        failed = Batch(runs, parallel, threads).train(stop)
    found = [describe(run) for run in runs]
    console(json_target).print(table(found))
    if json_target is not None:
        write_json({"runs": [entry.row() for entry in found], "failed": [str(run) for run in failed]}, json_target)
    if stop.asked:
        typer.echo("me3bev: stopped; the same command goes on", err=True)
        raise typer.Exit(130)
    if failed:
        names = ", ".join(str(run) for run in failed)
        typer.echo(f"me3bev: {len(failed)} of {len(runs)} runs failed: {names}", err=True)
        raise typer.Exit(1)


def _run(
    recipe: Recipe, run: Path, threads: int | None, json_target: str | None, perception: Path | None = None
) -> None:
    """Train to the end or to Ctrl-C, and say how to go on."""
    import json

    import torch

    from me3bev_cli.allocator import keep_freed_memory
    from me3bev_cli.output import write_json
    from me3bev_cli.stopping import Stop
    from me3bev_cli.training.best import best_line, read_best
    from me3bev_cli.training.display import Display
    from me3bev_cli.training.run import is_run, training_in
    from me3bev_cli.training.takeover import begin_run
    from me3bev_cli.training.trainer import InterruptedTrainingError, Trainer

    if threads is not None:
        torch.set_num_threads(threads)
    keep_freed_memory()
    stop = Stop()
    plan = [(stage.kind, stage.steps) for stage in recipe.stages]
    display = Display(sum(steps for _, steps in plan), len(plan), plan=plan)
    with stop.listening():
        # The network is built before the folder is made: a recipe that cannot be built leaves nothing behind.
        trainer = Trainer(recipe, run, display, stop)
        if not is_run(run):
            begin_run(recipe, run, perception)
        with training_in(run):
            trainer.resume()
            display.begin(trainer.progress.total_steps, read_best(run))
            _introduce(trainer, run)
            try:
                last = trainer.train()
            except InterruptedTrainingError:
                display.close()
                display.say(
                    f"stopped at step {trainer.progress.total_steps:,}; go on with: me3bev train --resume {run}"
                )
                raise typer.Exit(130) from None
            finally:
                display.close()
    display.say(f"finished: {last}")
    for line in (best_line(run), f"reward curve: {run / 'reward.png'}"):
        if line is not None:
            display.say(line)
    if json_target is not None:
        write_json(json.loads((run / "summary.json").read_text()), json_target)


def _introduce(trainer: Trainer, run: Path) -> None:
    """What is trained, for which reward, from where."""
    from me3bev_cli.reward_terms import formula

    recipe, say = trainer.recipe, trainer.display.say
    count = sum(p.numel() for p in trainer.network.parameters())
    say(f"{recipe.name}: {count:,} parameters on {trainer.device}; seed {recipe.seed}; run {run}")
    formulas = [formula(recipe.reward_in(stage)) for stage in recipe.stages]
    if len(set(formulas)) == 1:
        say(f"reward: {formulas[0]}")
    else:
        for number, text in enumerate(formulas, start=1):
            say(f"reward in stage {number}: {text}")
    if trainer.progress.total_steps:
        say(f"going on from step {trainer.progress.total_steps:,}")

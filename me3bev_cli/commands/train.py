"""`me3bev train`: train a recipe's policy, or go on with a run."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from me3bev_cli.errors import UserError

if TYPE_CHECKING:
    from me3bev_cli.recipe import Recipe


def train(
    recipe: Annotated[str | None, typer.Argument(help="A recipe file or the name of a shipped recipe.")] = None,
    resume: Annotated[Path | None, typer.Option(help="Go on with this run.", metavar="RUN")] = None,
    out: Annotated[Path | None, typer.Option(help="Folder of the new run. Default: runs/NAME-DATE-TIME.")] = None,
    overrides: Annotated[
        list[str] | None, typer.Option("--set", help="Override a key of the recipe.", metavar="KEY=VALUE")
    ] = None,
    threads: Annotated[int | None, typer.Option(help="CPU threads for the network. Default: all cores.", min=1)] = None,
    json: Annotated[str | None, typer.Option(help="Write the run's summary.", metavar="FILE|-")] = None,
) -> None:
    """Train the policy of a recipe."""
    if (recipe is None) == (resume is None):
        raise UserError("name a recipe to train or a run to go on with", hint="`me3bev train RECIPE` or `--resume RUN`")
    from me3bev_cli.recipe_loading import resolve_recipe
    from me3bev_cli.training.run import choose_run, open_run

    if resume is not None:
        if overrides:
            raise UserError("a run goes on with its own recipe", where="--set", hint="Start a new run to change it")
        run = open_run(resume)
        loaded = resolve_recipe(str(run / "recipe.yaml"))
    else:
        assert recipe is not None
        loaded = resolve_recipe(recipe, overrides or [])
        run = choose_run(loaded, out)
    _run(loaded, run, threads, json)


def _run(recipe: Recipe, run: Path, threads: int | None, json_target: str | None) -> None:
    """Train to the end or to Ctrl-C, and say how to go on."""
    import json

    import torch

    from me3bev_cli.output import write_json
    from me3bev_cli.recipe_loading import dump
    from me3bev_cli.stopping import Stop
    from me3bev_cli.training.display import Display
    from me3bev_cli.training.run import is_run, make_run
    from me3bev_cli.training.trainer import InterruptedTrainingError, Trainer

    if threads is not None:
        torch.set_num_threads(threads)
    stop = Stop()
    display = Display(sum(stage.steps for stage in recipe.stages), len(recipe.stages))
    with stop.listening():
        # The network is built before the folder is made: a recipe that cannot be built leaves nothing behind.
        trainer = Trainer(recipe, run, display, stop)
        if not is_run(run):
            make_run(run, dump(recipe))
        trainer.resume()
        display.begun_at = trainer.progress.total_steps
        count = sum(p.numel() for p in trainer.network.parameters())
        display.say(f"{recipe.name}: {count:,} parameters on {trainer.device}; run {run}")
        if trainer.progress.total_steps:
            display.say(f"going on from step {trainer.progress.total_steps:,}")
        try:
            last = trainer.train()
        except InterruptedTrainingError:
            display.say(f"stopped at step {trainer.progress.total_steps:,}; go on with: me3bev train --resume {run}")
            raise typer.Exit(130) from None
    display.say(f"finished: {last}")
    display.say(f"reward curve: {run / 'reward.png'}")
    if json_target is not None:
        write_json(json.loads((run / "summary.json").read_text()), json_target)

"""`me3bev bench-train`: what an update and a rollout cost, beside plain Stable-Baselines3 PPO on stacked frames."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from me3bev_cli.recipe import Recipe


def bench_train(
    recipe: Annotated[str, typer.Argument(help="A recipe file or the name of a shipped recipe.")] = "me3bev",
    overrides: Annotated[
        list[str] | None, typer.Option("--set", help="Override a key of the recipe.", metavar="KEY=VALUE")
    ] = None,
    samples: Annotated[int, typer.Option(help="Samples of a minibatch, rounded up to whole segments.", min=1)] = 16,
    rounds: Annotated[int, typer.Option(help="Turns that each of those compared takes.", min=1)] = 2,
    steps: Annotated[int, typer.Option(help="Steps of collection per environment.", min=2)] = 16,
    threads: Annotated[int | None, typer.Option(help="CPU threads for the network. Default: all cores.", min=1)] = None,
    json: Annotated[str | None, typer.Option(help="Write the figures.", metavar="FILE|-")] = None,
) -> None:
    """Time training: updates, rollouts, memory.

    Plain Stable-Baselines3 PPO learns from the same samples with the same network and weights; each of its
    observations holds the frames of a whole window. Timed is SB3's `train()` of both: one pass over one minibatch. They
    take turns in one process.
    """
    import torch

    from me3bev_cli.allocator import keep_freed_memory
    from me3bev_cli.bench.machine import machine
    from me3bev_cli.bench.train import measure
    from me3bev_cli.output import write_json
    from me3bev_cli.recipe_loading import resolve_recipe
    from me3bev_cli.training.run import versions

    if threads is not None:
        torch.set_num_threads(threads)
    keep_freed_memory()
    loaded = resolve_recipe(recipe, overrides or [])
    here = machine() | {"threads": torch.get_num_threads()}
    figures = measure(loaded, samples=samples, rounds=rounds, steps=steps, progress=_show)
    report = figures | {"setup": _setup(loaded, figures, rounds, steps), "machine": here, "versions": versions()}
    _print(report, json)
    if json is not None:
        write_json(report, json)


def _setup(recipe: Recipe, figures: dict[str, Any], rounds: int, steps: int) -> dict[str, Any]:
    return {
        "recipe": recipe.name,
        "spatial": recipe.spatial.model_dump() if recipe.spatial else None,
        "cameras": len(recipe.observation.cameras),
        "height": recipe.observation.height,
        "width": recipe.observation.width,
        "rounds": rounds,
        "steps": steps,
        **figures.pop("stage"),
    }


def _show(what: str, done: int, total: int) -> None:
    """A counter on stderr, in a terminal only."""
    if sys.stderr.isatty():
        sys.stderr.write(f"\r\x1b[2K{what} {done + 1}/{total}" if done < total else "\r\x1b[2K")
        sys.stderr.flush()


def _print(report: dict[str, Any], json: str | None) -> None:
    from rich import box
    from rich.table import Table

    from me3bev_cli.output import console

    place = console(json)
    _print_setup(place, report)
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, padding=(0, 2, 0, 0))
    table.add_column("", no_wrap=True)
    for name in ("plain SB3", "ours", "ratio", "quartiles", "target"):
        table.add_column(name, justify="right", no_wrap=True)
    cost, held = report["update_ms_per_sample"], report["rollout_bytes"]
    rows = (
        ("update, ms per sample", cost["plain_sb3"], cost["ours"], "update_speedup", ",.1f"),
        ("the same, frozen encoder", cost["plain_sb3_frozen"], cost["ours_frozen"], "frozen_speedup", ",.1f"),
        ("rollout, MB", held["plain_sb3"] / 1e6, held["ours"] / 1e6, "memory_ratio", ",.0f"),
        ("the same, frozen encoder", held["plain_sb3"] / 1e6, held["ours_frozen"] / 1e6, "frozen_memory_ratio", ",.0f"),
    )
    for label, theirs, mine, key, form in rows:
        spread, target = report["spread"].get(key), report["targets"].get(key)
        table.add_row(
            label,
            f"{theirs:{form}}",
            f"{mine:{form}}",
            f"{report[key]:.2f}",
            f"{spread[0]:.2f} .. {spread[1]:.2f}" if spread else "",
            f"at least {target:g}" if target else "",
        )
    place.print(table)
    _print_environments(place, report)


def _print_setup(place: Any, report: dict[str, Any]) -> None:
    setup, here = report["setup"], report["machine"]
    place.print(
        f"{setup['recipe']}: {setup['cameras']} images of {setup['height']} x {setup['width']}, windows of "
        f"{setup['window']}; {setup['device']}, {here['threads']} threads of {here['processor']}, "
        f"{here['cores']} cores, load {here['load']}"
    )
    place.print(
        f"timed: SB3's train() of both, one pass over one minibatch of {setup['samples']} samples "
        f"(ours: segments of {setup['segment']}),\n"
        f"       loss, backward pass and optimiser step; same network, weights and samples; "
        f"medians of {setup['rounds']} rounds in turns"
    )
    if setup["microbatch"]:
        place.print(
            f"       both encode {setup['microbatch']} frames at a time and once more in the backward pass, "
            "as the recipe's microbatch says"
        )
    place.print(
        "       frozen encoder: SB3 runs it forward on every frame of every sample; ours reads what it gave in "
        "collection\n"
        f"memory: the arrays of a rollout of {setup['rollout']} steps of {setup['envs']} environments"
    )


def _print_environments(place: Any, report: dict[str, Any]) -> None:
    from rich import box
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, padding=(0, 2, 0, 0))
    names = ("environments", "collection", "of it environments", "update", "overall")
    for name in (*names, "update, frozen", "overall, frozen"):
        table.add_column(name, justify="right", no_wrap=True)
    for row in report["environments"]:
        table.add_row(
            str(row["envs"]),
            f"{row['collection_steps_per_s']:.1f}",
            f"{row['environment_share']:.0%}",
            *(f"{row[key]:.1f}" for key in _RATES),
        )
    place.print(f"environment steps/s; an update passes {report['setup']['epochs']} times over each step:")
    place.print(table)


_RATES = ("update_steps_per_s", "overall_steps_per_s", "frozen_update_steps_per_s", "frozen_overall_steps_per_s")

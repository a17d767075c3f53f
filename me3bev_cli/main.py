"""The command line: names, order and help. What a command needs is imported when it runs."""

from __future__ import annotations

from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from me3bev_cli import __version__
from me3bev_cli.commands import (
    bench_env,
    bench_latency,
    bench_train,
    collect,
    decode,
    drive,
    logs,
    maps,
    metrics,
    plot,
    plugins,
    recipe,
    report,
    runs,
    train,
)
from me3bev_cli.commands import eval as evaluation
from me3bev_cli.errors import UserError

HELPERS = "Helpers"


class Commands(TyperGroup):
    """Lists commands under their panels in plain text (rich is slow to import) and turns mistakes into exit codes."""

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """The verbs first, each panel of helpers after them."""
        panels: dict[str, list[tuple[str, Any]]] = {}
        for name in self.list_commands(ctx):
            command = self.get_command(ctx, name)
            if command is not None and not command.hidden:
                panel = getattr(command, "rich_help_panel", None)
                panels.setdefault(panel if isinstance(panel, str) else "Commands", []).append((name, command))
        # One column for all panels: names are padded to the longest.
        longest = max((len(name) for rows in panels.values() for name, _ in rows), default=0)
        for panel, rows in panels.items():
            with formatter.section(panel):
                limit = formatter.width - longest - 6
                formatter.write_dl([(name.ljust(longest), c.get_short_help_str(limit)) for name, c in rows])

    def invoke(self, ctx: Any) -> Any:
        """Run the command: 2 for a user's mistake, 130 for Ctrl-C; a defect keeps its traceback."""
        try:
            return super().invoke(ctx)
        except UserError as error:
            typer.echo(f"me3bev: {error}", err=True)
            raise typer.Exit(2) from None
        except KeyboardInterrupt:
            typer.echo("me3bev: stopped", err=True)
            raise typer.Exit(130) from None


app = typer.Typer(
    cls=Commands,
    help="Build, train and compare end-to-end driving policies from recipes.",
    epilog="`me3bev COMMAND --help` says more.",
    context_settings={"max_content_width": 100},
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)


def _show_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"me3bev {__version__}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", help="Print the version.", callback=_show_version, is_eager=True)
    ] = False,
) -> None:
    pass


app.command()(collect.collect)
app.command()(train.train)
app.command("eval")(evaluation.evaluate)
app.command()(runs.runs)
app.command()(plot.plot)
app.command()(report.report)
app.command(cls=drive.DriveCommand)(drive.drive)
app.command()(decode.decode)
app.command()(bench_latency.bench_latency)
app.command()(bench_env.bench_env)
app.command()(bench_train.bench_train)
app.add_typer(logs.app, name="logs", rich_help_panel=HELPERS)
app.add_typer(maps.app, name="maps", rich_help_panel=HELPERS)
app.add_typer(recipe.app, name="recipe", rich_help_panel=HELPERS)
app.command(rich_help_panel=HELPERS)(plugins.plugins)
app.command(rich_help_panel=HELPERS)(metrics.metrics)


def main() -> None:
    """The console script."""
    app()


if __name__ == "__main__":
    main()

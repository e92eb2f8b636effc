"""The verbs in the order of `deepbots --help`; each is the function `command` of the module of its name, imported when it is asked for."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib import import_module
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

import deepbots_cli
from deepbots_cli.cli import terminal
from deepbots_cli.diagnostics.nearest import nearest

VERBS: Mapping[str, str] = {
    "train": "Train a policy in a new run directory, and evaluate it.",
    "eval": "Evaluate the policy of a run on held-out episodes.",
    "lint": "Check scenarios and report every problem.",
    "explain": "Explain a finding: what it means, and what to write instead.",
    "fmt": "Put scenario files into the canonical layout.",
    "lsp": "Serve an editor: findings as you type, completion, fixes.",
    "inspect": "Show what a scenario means: spaces, messages, reward, timing.",
    "run": "Run episodes without a trained policy, and show the reward terms.",
    "compile": "Print the Python that a scenario is compiled to.",
    "diff": "Compare two scenarios by meaning.",
    "new": "Write a first scenario, with a comment on every part.",
    "copy": "Copy a scenario that comes with deepbots, to change it.",
    "upgrade": "Bring a scenario file to the current version of the language.",
    "eject": "Write a scenario out as a small Python project of its own.",
    "list": "List the scenarios that come with deepbots, and your runs.",
    "bench": "Time a step of the environment against bare physics.",
    "schema": "Print the JSON Schema of scenario files, for editors.",
    "doctor": "Check the installation.",
}


_SETTINGS = {"help_option_names": ["-h", "--help"], "max_content_width": 100}


class Verbs(TyperGroup):
    """Looks its commands up in the table of verbs."""

    def list_commands(self, ctx: Any) -> list[str]:
        return list(VERBS)

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        if cmd_name not in VERBS:
            near = nearest(cmd_name, VERBS)
            ctx.fail(f"there is no verb '{cmd_name}'" + (f"; did you mean '{near}'?" if near else f"; there are {', '.join(VERBS)}"))
        app = typer.Typer(add_completion=False, rich_markup_mode=None, context_settings=_SETTINGS)
        app.command(cmd_name)(import_module(f"deepbots_cli.cli.verbs.{cmd_name}").command)
        return typer.main.get_command(app)

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        with formatter.section("Verbs"):
            formatter.write_dl(list(VERBS.items()))

    def invoke(self, ctx: Any) -> Any:
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt:
            terminal.note("interrupted")
            raise typer.Exit(130) from None


def run(arguments: Sequence[str] | None) -> None:
    """Parse and run; ends with SystemExit, or with the exception of the verb."""
    app = typer.Typer(
        cls=Verbs,
        add_completion=False,
        rich_markup_mode=None,
        no_args_is_help=True,
        subcommand_metavar="VERB ...",
        context_settings=_SETTINGS,
    )
    app.callback()(_deepbots)
    typer.main.get_command(app).main(args=None if arguments is None else list(arguments), prog_name="deepbots")


def _version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"deepbots {deepbots_cli.__version__}")
        raise typer.Exit


def _deepbots(
    version: Annotated[bool, typer.Option("--version", help="Show the version and exit.", callback=_version, is_eager=True)] = False,
) -> None:
    """One YAML scenario and a URDF robot become a trained, evaluated, explained policy.

    A scenario is named by the path of a file, or by the name of one that comes with deepbots.

    \b
      deepbots train cartpole                   train, evaluate, say whether it is solved
      deepbots copy cartpole                    a copy to change
      deepbots lint cartpole.yaml               everything that is wrong with it
      deepbots train cartpole.yaml --seed 1
    """

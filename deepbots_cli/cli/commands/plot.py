"""`deepbots plot`: learning curves of runs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from deepbots_cli.cli import terminal
from deepbots_cli.cli.command import Force, integer, option
from deepbots_cli.files import atomic_write
from deepbots_cli.words import counted


def command(
    runs: Annotated[
        list[Path],
        typer.Argument(
            metavar="RUN", help="Run directories, folders of runs, or folders of TensorBoard files."
        ),
    ],
    out: Annotated[Path, option("--output -o FILE", "File to write, .png or .svg.")] = Path("plot.png"),
    window: Annotated[
        int, integer("--window N", "Average returns and successes over this number of episodes.", 1, 100_000)
    ] = 100,
    force: Force = False,
    dark: Annotated[bool, option("--dark", "Light lines on a dark ground.")] = False,
) -> None:
    """Plot the learning curves of runs."""
    from deepbots_cli.view import plots, training_logs
    from deepbots_cli.view.pictures import check_target

    check_target(out, plots.SUFFIXES, force=force)
    with terminal.transient_line("reading the logs ..."):
        logs = training_logs.read_logs(runs, window, by_agent=True)
    figure = plots.plot(logs, theme="dark" if dark else "light")
    with atomic_write(out) as draft:
        figure.savefig(draft, format=out.suffix[1:].lower(), dpi=130)
    for log in logs:
        if log.evaluation is not None and log.evaluation.remarks:
            terminal.note(
                f"note: about the evaluation that the diamond of {log.path} shows:"
                f" {'; '.join(log.evaluation.remarks)}"
            )
    terminal.print_result(f"{out} ({counted(len({log.path for log in logs}), 'run')})")

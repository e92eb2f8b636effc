"""`deepbots report`: a run or a group as one HTML file; `plot`: learning curves."""

from __future__ import annotations

from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Annotated

import typer

from deepbots_cli.cli import terminal
from deepbots_cli.cli.command import AllowCode, Force, Json, integer, option
from deepbots_cli.document import Permissions
from deepbots_cli.errors import MissingExtraError, UsageError
from deepbots_cli.files import atomic_write
from deepbots_cli.learning.campaigns.study import JOURNAL_NAME
from deepbots_cli.rollout.source import SourceKind, folder_kind
from deepbots_cli.words import counted

if TYPE_CHECKING:
    from deepbots_cli.insight.report import Report


def command(
    run: Annotated[
        Path,
        typer.Argument(
            metavar="RUN|GROUP",
            help="A run directory of `deepbots train`, or the folder of a group.",
        ),
    ],
    out: Annotated[
        Path | None, option("--output -o FILE", "File to write; by default RUN.html in the current folder.")
    ] = None,
    force: Force = False,
    figures: Annotated[Path | None, option("--figures FOLDER", "Also write every figure as PNG.")] = None,
    episodes: Annotated[
        int, integer("--episodes N", "Evaluation episodes to run again for trajectories.", 3, 1000)
    ] = 12,
    clips: Annotated[
        bool, option("--clips/--no-clips", "Film the best, the median and the worst episode.")
    ] = True,
    as_json: Json = False,
    allow_code: AllowCode = False,
) -> None:
    """Write a report about a run."""
    from deepbots_cli.files import atomic_write, check_folder, check_output
    from deepbots_cli.view.plots import import_matplotlib

    if folder_kind(run) is SourceKind.STUDY:
        raise UsageError(
            f"the report of a study is gone; `deepbots runs {quote(str(run))}` lists the trials of {run}, and"
            f" `optuna-dashboard {quote(str(run / JOURNAL_NAME))}` shows them in the browser (pip install"
            " optuna-dashboard)"
        )
    target = out or Path(f"{run.resolve().name}.html")
    if target.suffix.lower() not in (".html", ".htm"):
        raise UsageError(f"{target} must end in .html")
    check_output(target, force=force)
    if figures is not None:
        check_folder(figures)
    try:
        import_matplotlib()
    except ModuleNotFoundError as error:
        raise MissingExtraError("train", "a report") from error
    from deepbots_cli.insight.report import FIGURE_NAMES, Report

    if figures is not None and figures.is_dir():
        check_output(*(figures / f"{name}.png" for name in FIGURE_NAMES), force=force)
    with terminal.transient_line("reading the run ..."):
        report = Report.read(run)
    if figures is not None and figures.is_dir():
        # Only the run names its agents, and each agent has a figure of its own.
        check_output(*(figures / f"{name}.png" for name in report.figure_names), force=force)
    selection = report.choose_episodes(episodes)
    permissions = Permissions(code=allow_code)
    with terminal.progress("episodes") as show:
        report.repeat_episodes(selection, show, clips=clips, permissions=permissions)
    with terminal.transient_line("looking for the causes ..."):
        report.find_causes(permissions)
    with terminal.transient_line("drawing ..."):
        with atomic_write(target) as draft:
            draft.write_text(report.html(), encoding="utf-8")
        figure_paths = report.write_figures(figures) if figures is not None else []
    for note in report.notes:
        terminal.note(f"note: {note}")
    figures_text = f", {len(figure_paths)} figures in {quote(str(figures))}" if figure_paths else ""
    data = {
        "report": target,
        "result": report.result,
        **_run_data(report),
        "figures": figure_paths,
        "notes": report.notes,
    }
    terminal.show(
        data,
        report.result,
        f"{target} ({target.stat().st_size / 1000:,.0f} kB){figures_text}",
        as_json=as_json,
    )


def _run_data(report: Report) -> dict[str, object]:
    """Return the causes in a run, and the results of each of several agents."""
    of_agents = {
        agent.name: {"result": agent.result, "causes": [cause.as_json() for cause in agent.causes]}
        for agent in report.agents
    }
    causes = [cause.as_json() for cause in report.causes]
    return {"causes": causes, **({"agents": of_agents} if of_agents else {})}


def plot(
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

"""`deepbots view` and `deepbots play`, which serve a page in the browser."""

from __future__ import annotations

import sys
import webbrowser
from dataclasses import replace
from pathlib import Path
from shlex import join
from typing import TYPE_CHECKING, Annotated, Any

import typer

from deepbots_cli.cli import records, terminal
from deepbots_cli.cli.command import (
    ADVANCED,
    EPISODES,
    Case,
    EngineOrRun,
    Force,
    Overrides,
    Seed,
    Stage,
    Start,
    integer,
    option,
    start_values,
)
from deepbots_cli.document import Permissions
from deepbots_cli.errors import UsageError, counted
from deepbots_cli.rollout.source import RECORDING_SUFFIX

if TYPE_CHECKING:
    from deepbots_cli.view.episodes import Showing, ShowingState
    from deepbots_cli.view.recordings import DrivenEpisodes

Shown = Annotated[
    str,
    typer.Argument(
        metavar="SCENARIO|RUN|MODEL|RECORDING",
        help="A scenario file, the name of a shipped scenario, a run directory, a model in it, a recording"
        " or the log of a robot.",
    ),
]
ScenarioOrRun = Annotated[
    str,
    typer.Argument(
        metavar="SCENARIO|RUN|MODEL",
        help="A scenario file, the name of a shipped scenario, a run directory, or a model in it.",
    ),
]
Host = Annotated[
    str,
    option(
        "--host ADDRESS",
        "Address to serve on. With an address that other machines can reach, such as 0.0.0.0, the page opens"
        " only with the token in the printed address.",
        ADVANCED,
    ),
]
Port = Annotated[
    int | None,
    integer(
        "--port N", "Port of the page; by default the first free port from 8787.", 0, 65535, group=ADVANCED
    ),
]
Open = Annotated[bool, option("--open", "Open the page in the browser.")]
Episode = Annotated[
    int,
    integer(
        "--episode K", "Begin with the start of held-out episode K of `deepbots eval`.", 0, group=EPISODES
    ),
]


def view(
    shown: Shown,
    driver: Annotated[
        str | None,
        option(
            "--driver NAME",
            "Who acts, as for `deepbots try`; also `policy` (of a run) and `you` (keys and sliders of the"
            " page).",
        ),
    ] = None,
    seed: Seed = 0,
    episode: Episode = 0,
    start: Start = None,
    watch: Annotated[bool, option("--watch", "Restart with the new files when a file is saved.")] = False,
    compare: Annotated[
        str | None,
        option("--compare OTHER", "Show another run or scenario beside the first one, with the same seeds."),
    ] = None,
    worlds: Annotated[
        int | None,
        integer(
            "--worlds N", "Step a batch of N worlds in MuJoCo, and show one of them.", 1, 4096, group=ADVANCED
        ),
    ] = None,
    world: Annotated[
        int, integer("--world K", "The world to show first, with --worlds.", 0, group=ADVANCED)
    ] = 0,
    frame_rate: Annotated[
        int,
        integer(
            "--fps N",
            "Pictures per second. A browser without a graphics card needs fewer.",
            1,
            60,
            group=ADVANCED,
        ),
    ] = 30,
    overrides: Overrides = None,
    case: Case = None,
    stage: Stage = None,
    engine: EngineOrRun = None,
    host: Host = "127.0.0.1",
    port: Port = None,
    open_: Open = False,
    permissions: Permissions = Permissions(),
) -> None:
    """Watch a policy, a scenario or a recording in the browser."""
    if world >= (worlds or 1):
        reason = f"--worlds {worlds} creates the worlds 0 to {worlds - 1}" if worlds else "add --worlds N"
        raise UsageError(f"there is no world {world}; {reason}")
    from deepbots_cli.view.episodes import Showing

    engine = engine or ("mujoco" if worlds else None)
    source = Showing(
        shown, overrides or (), permissions, engine, case, stage, worlds or 0, start_values(start)
    )
    compared = replace(source, reference=compare) if compare else None
    settings = {
        "driver": driver,
        "seed": seed,
        "episode": episode,
        "world": world,
        "watch": watch,
        "frame_rate": frame_rate,
    }
    _serve(source, open_, compare=compared, host=host, port=port, **settings)


def play(
    shown: ScenarioOrRun,
    output: Annotated[
        Path | None,
        option(
            "--output -o FILE",
            "Record the episodes that you drive in this file (.mcap), which `replay` and `view` read.",
        ),
    ] = None,
    seed: Seed = 0,
    episode: Episode = 0,
    overrides: Overrides = None,
    case: Case = None,
    stage: Stage = None,
    engine: EngineOrRun = None,
    host: Host = "127.0.0.1",
    port: Port = None,
    open_: Open = False,
    force: Force = False,
    permissions: Permissions = Permissions(),
) -> None:
    """Drive the robot of a scenario in the browser."""
    from deepbots_cli.view.episodes import Showing
    from deepbots_cli.view.pictures import check_target

    if output is not None:
        check_target(output, (RECORDING_SUFFIX,), force=force)
    source = Showing(shown, overrides or (), permissions, engine, case, stage)
    _serve(source, open_, host=host, port=port, seed=seed, episode=episode, playing=True, output=output)


def _serve(source: Showing, open_: bool, **options: Any) -> None:
    """Serve a page until Ctrl-C; `options` are those of `Page`."""
    from deepbots_cli.view.page import Page

    page = Page(source, **options)
    try:
        terminal.print_result(page.address)
        sys.stdout.flush()  # programs that read the address wait for it
        terminal.note("Ctrl-C ends it")
        if open_:
            webbrowser.open(page.address)
        page.run()
    finally:
        page.close()
        if page.driven is not None:
            _finish(page.driven)


def _finish(driven: DrivenEpisodes) -> None:
    """Print the episodes that a person has driven, and the use of their recording."""
    if driven.is_full:
        terminal.note(driven.note)
    if not driven.ends:
        terminal.note(f"{driven.path} was not written: you drove no episode from its reset to its end")
        return
    driven.save()
    rows = records.recorded_rows(enumerate(driven.ends))
    count = counted(len(rows), "episode")
    lines = [
        records.recorded_table(rows),
        f"{driven.path} ({count}, {driven.path.stat().st_size / 1000:,.0f} kB)",
    ]
    further = [["deepbots", "replay", "--verify"], [*_training_words(driven.player.opened), "--teacher"]]
    terminal.show(
        None, *lines, as_json=False, next_commands=[join([*words, str(driven.path)]) for words in further]
    )


def _training_words(opened: ShowingState) -> list[str]:
    """Return the words of the command that trains the shown scenario."""
    showing = opened.shown
    if opened.run is not None:
        from deepbots_cli.insight.training import training_command

        return training_command(opened.run, showing.overrides)
    changed = [word for text in showing.overrides for word in ("--set", text)]
    return [
        "deepbots",
        "train",
        showing.reference,
        *changed,
        *(["--engine", showing.engine] if showing.engine else []),
    ]

"""Pages of the scene in the browser, which `view` and `play` serve: their arguments, and the way they end."""

from __future__ import annotations

import sys
import webbrowser
from shlex import join
from typing import TYPE_CHECKING, Annotated, Any

import typer

from deepbots_cli.cli import records, terminal
from deepbots_cli.cli.command import (
    ADVANCED,
    EPISODES,
    integer,
    option,
)
from deepbots_cli.words import counted

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
        "--episode K",
        "Begin with the start of held-out episode K of `deepbots eval`, counted from 0.",
        0,
        group=EPISODES,
    ),
]


def serve(source: Showing, open_: bool, **options: Any) -> None:
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
        if page.playback.driven is not None:
            _finish(page.playback.driven)


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
        from deepbots_cli.insight.train_command import training_command

        return training_command(opened.run, showing.overrides)
    changed = [word for text in showing.overrides for word in ("--set", text)]
    return [
        "deepbots",
        "train",
        showing.reference,
        *changed,
        *(["--engine", showing.engine] if showing.engine else []),
    ]

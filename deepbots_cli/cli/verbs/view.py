"""`deepbots view`: a world in the browser."""

from __future__ import annotations

import sys
import webbrowser
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from deepbots_cli.cli import terminal
from deepbots_cli.cli.command import AllowCode, AllowPaths, Case, Seed, Sets, Stage, known_engine, whole

Shown = Annotated[
    str, typer.Argument(metavar="SCENARIO|RUN", help="A scenario file, the name of a shipped scenario, a run directory or a recording.")
]
EngineOrRun = Annotated[
    str | None,
    typer.Option("--engine", metavar="NAME", callback=known_engine, help="Physics engine; by default pybullet, or the engine of the run."),
]
Host = Annotated[
    str,
    typer.Option("--host", metavar="ADDRESS", help="Address to serve on; beyond this machine, such as 0.0.0.0, the page asks for a token."),
]
Port = Annotated[
    int | None,
    typer.Option("--port", metavar="N", parser=whole(0, 65535), help="Port of the page; by default the first free one from 8787 on."),
]
Open = Annotated[bool, typer.Option("--open", help="Open the page in the browser.")]
Episode = Annotated[
    int,
    typer.Option("--episode", metavar="K", parser=whole(0), help="Number of the episode, which begins as episode K of an evaluation does."),
]


def command(
    shown: Shown,
    driver: Annotated[
        str | None,
        typer.Option("--driver", "--script", metavar="NAME", help="A script of the scenario, `random`, `zero`, `policy` or `you`."),
    ] = None,
    seed: Seed = 0,
    episode: Episode = 0,
    watch: Annotated[bool, typer.Option("--watch", help="Read the files again when they are saved, and begin again.")] = False,
    compare: Annotated[
        str | None, typer.Option("--compare", metavar="OTHER", help="Show another run or scenario beside it, from the same seeds.")
    ] = None,
    sets: Sets = None,
    case: Case = None,
    stage: Stage = None,
    engine: EngineOrRun = None,
    host: Host = "127.0.0.1",
    port: Port = None,
    open_: Open = False,
    allow_paths: AllowPaths = None,
    allow_code: AllowCode = False,
) -> None:
    """Show a scenario, a run or a recording in the browser.

    The command prints the address of the page, and serves it until Ctrl-C. The page shows robots, objects, sensor rays and contacts,
    with pause, single steps, speed and seed, and plots the observation, the action and every reward term.

    A run is driven by its policy, a scenario by its first script, or else by random actions. While a run is trained, each episode shows
    its newest policy. A recording is played, with a slider for its steps.

    \b
      deepbots view find_ball
      deepbots view runs/find_ball-0-1
      deepbots view runs/find_ball-0-1 --compare runs/find_ball-1-1
      deepbots view find_ball-0-0.mcap
      deepbots view mine.yaml --watch
      deepbots view find_ball --set goal=20cm --seed 3

    Next: `deepbots play SCENARIO` lets you drive.
    """
    serve(shown, driver, seed, episode, watch, sets, case, stage, engine, host, port, open_, allow_paths, allow_code, compare=compare)


def serve(
    shown: str,
    driver: str | None,
    seed: int,
    episode: int,
    watch: bool,
    sets: list[str] | None,
    case: str | None,
    stage: str | None,
    engine: str | None,
    host: str,
    port: int | None,
    open_: bool,
    allow_paths: list[Path] | None,
    allow_code: bool,
    *,
    compare: str | None = None,
    playing: bool = False,
) -> None:
    """Serve a page until Ctrl-C; the arguments are those of the verbs."""
    from deepbots_cli.view.episodes import Source
    from deepbots_cli.view.page import Page

    source = Source(shown, sets or (), allow_paths or (), allow_code, engine, case, stage)
    other = replace(source, reference=compare) if compare else None
    page = Page(source, compare=other, host=host, port=port, driver=driver, seed=seed, episode=episode, watch=watch, playing=playing)
    try:
        terminal.say(page.address)
        sys.stdout.flush()  # programs that read it wait for it
        terminal.note("Ctrl-C ends it")
        if open_:
            webbrowser.open(page.address)
        page.run()
    finally:
        page.close()

"""`deepbots clip`: an episode as MP4, GIF or an offline page."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from deepbots_cli.cli import terminal
from deepbots_cli.cli.command import AllowCode, AllowPaths, Case, Seed, Sets, Stage
from deepbots_cli.cli.verbs.picture import At, Driver, From, Size
from deepbots_cli.cli.verbs.view import EngineOrRun, Episode, Shown


def command(
    shown: Shown,
    out: Annotated[
        Path,
        typer.Option(
            "--out", "-o", metavar="FILE", help="File to write: .mp4, .gif, or .html for an interactive page that needs no server."
        ),
    ] = Path("clip.mp4"),
    driver: Driver = None,
    seconds: Annotated[
        float | None, typer.Option("--seconds", metavar="S", min=0.01, max=3600, help="Simulated seconds; by default the whole episode.")
    ] = None,
    speed: Annotated[
        float, typer.Option("--speed", metavar="X", min=0.01, max=100, help="Seconds of the episode in a second of the clip.")
    ] = 1.0,
    size: Size = "480x320",
    eye: From = None,
    target: At = None,
    seed: Seed = 0,
    episode: Episode = 0,
    sets: Sets = None,
    case: Case = None,
    stage: Stage = None,
    engine: EngineOrRun = None,
    allow_paths: AllowPaths = None,
    allow_code: AllowCode = False,
) -> None:
    """Make a moving picture of an episode: MP4, GIF or an offline page.

    In a run, the policy acts. In a scenario, the first script acts; without a script, actions are random.

    \b
      deepbots clip find_ball --script around --out find_ball.gif
      deepbots clip runs/cartpole-0-1 --episode 3 --out cartpole.mp4
      deepbots clip quadruped --out quadruped.html --seconds 10

    Next: `deepbots view SCENARIO` shows it live.
    """
    from deepbots_cli.view import pictures
    from deepbots_cli.view.episodes import Source, player

    pictures.check_target(out, pictures.SUFFIXES)
    source = Source(shown, sets or (), allow_paths or (), allow_code, engine, case, stage)
    with player(source, driver) as world, terminal.passing("running the episode ..."):
        frame = pictures.clip(
            world, out, pictures.Shot(size[0], size[1], eye, target), seed=seed, episode=episode, seconds=seconds, speed=speed
        )
    agent = next(iter(frame.agents.values()))
    state = frame.ending or "not ended"
    terminal.say(f"{out} ({out.stat().st_size / 1000:,.0f} kB; {state} after {frame.time:.2f} s, return {agent.episode_return:.2f})")

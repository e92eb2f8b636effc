"""`deepbots picture`: a world as PNG."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from deepbots_cli.cli import terminal
from deepbots_cli.cli.command import AllowCode, AllowPaths, Case, Seed, Sets, Stage, whole
from deepbots_cli.cli.verbs.view import EngineOrRun, Episode, Shown

MAX_SIDE = 4096


def size(text: str) -> tuple[int, int]:
    """A parser of `640x480`, the width and height of a picture in pixels."""
    wide, _, tall = text.lower().partition("x")
    if not (wide.isdecimal() and tall.isdecimal() and 16 <= int(wide) <= MAX_SIDE and 16 <= int(tall) <= MAX_SIDE):
        raise typer.BadParameter(f"'{text}' is no size; write width x height in pixels, such as 640x480, from 16 to {MAX_SIDE}")
    return int(wide), int(tall)


def point(text: str) -> tuple[float, float, float]:
    """A parser of `x,y,z` in m, world frame."""
    try:
        x, y, z = (float(part) for part in text.split(","))
    except ValueError:
        raise typer.BadParameter(f"'{text}' is no point; write x,y,z in m, such as 1,-0.5,0.8") from None
    if not all(abs(part) < 1e6 for part in (x, y, z)):
        raise typer.BadParameter(f"'{text}' is farther than 1000 km away, or no number")
    return x, y, z


# Any: typer would parse each part of a tuple alone.
Size = Annotated[Any, typer.Option("--size", metavar="WxH", parser=size, help="Width and height in pixels.")]
From = Annotated[
    Any, typer.Option("--from", metavar="X,Y,Z", parser=point, help="Position of the camera in m; by default it sees the whole scene.")
]
At = Annotated[Any, typer.Option("--at", metavar="X,Y,Z", parser=point, help="Point in m that the camera looks at.")]
Driver = Annotated[
    str | None, typer.Option("--script", metavar="NAME", help="What acts: a script of the scenario, `random`, `zero` or `policy`.")
]


def command(
    shown: Shown,
    out: Annotated[Path, typer.Option("--out", "-o", metavar="PNG", help="File to write.")] = Path("picture.png"),
    size: Size = "640x480",
    eye: From = None,
    target: At = None,
    labels: Annotated[bool, typer.Option("--labels", help="Name the links and joints of the first robot.")] = False,
    rays: Annotated[bool, typer.Option("--rays", help="Draw the rays of sensors.")] = False,
    path: Annotated[bool, typer.Option("--path", help="Run the episode, and draw the path of the robot, seen from above.")] = False,
    steps: Annotated[int, typer.Option("--steps", metavar="N", parser=whole(0), help="Run this number of steps first.")] = 0,
    driver: Driver = None,
    seed: Seed = 0,
    episode: Episode = 0,
    sets: Sets = None,
    case: Case = None,
    stage: Stage = None,
    engine: EngineOrRun = None,
    allow_paths: AllowPaths = None,
    allow_code: AllowCode = False,
) -> None:
    """Draw a picture of a scenario.

    It shows the beginning of an episode, or the world after some steps.

    \b
      deepbots picture find_ball
      deepbots picture quadruped --labels --size 960x640 --out links.png
      deepbots picture find_ball --from 0,-1.5,1 --at 0,0,0 --rays
      deepbots picture find_ball --path --script around
      deepbots picture runs/find_ball-0-1 --path --episode 3

    Next: `deepbots clip SCENARIO` makes a moving picture.
    """
    from deepbots_cli.view import pictures
    from deepbots_cli.view.episodes import Source, player

    pictures.check_target(out, (".png",))
    source = Source(shown, sets or (), allow_paths or (), allow_code, engine, case, stage)
    shot = pictures.Shot(size[0], size[1], eye, target)
    with player(source, driver) as world:
        trace = list(world.episode(seed, episode, None if path and not steps else steps))
        image = pictures.picture(world, shot, labels=labels, rays=rays, path=trace if path else ())
    image.save(out)
    terminal.say(str(out))

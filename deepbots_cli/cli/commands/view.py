"""What people see of a world: `view` and `play` serve a page in the browser, `picture` and `clip` write files."""

from __future__ import annotations

import sys
import webbrowser
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from deepbots_cli.cli import terminal
from deepbots_cli.cli.command import (
    Case,
    Driver,
    Force,
    Overrides,
    Seed,
    Stage,
    Start,
    integer,
    known_engine,
    option,
    start_values,
)
from deepbots_cli.document import Permissions
from deepbots_cli.errors import UsageError
from deepbots_cli.files import atomic_write

if TYPE_CHECKING:
    from deepbots_cli.view.episodes import Showing

MAX_SIDE = 4096


def size(text: str) -> tuple[int, int]:
    """A parser of `640x480`, the width and height of a picture in pixels."""
    wide, _, tall = text.lower().partition("x")
    if not (wide.isdecimal() and tall.isdecimal() and 16 <= int(wide) <= MAX_SIDE and 16 <= int(tall) <= MAX_SIDE):
        raise typer.BadParameter(f"'{text}' is not a size; write width x height in pixels, such as 640x480, from 16 to {MAX_SIDE}")
    return int(wide), int(tall)


def point(text: str) -> tuple[float, float, float]:
    """A parser of `x,y,z` in m, world frame."""
    try:
        x, y, z = (float(part) for part in text.split(","))
    except ValueError:
        raise typer.BadParameter(f"'{text}' is not a point; write x,y,z in m, such as 1,-0.5,0.8") from None
    if not all(abs(part) < 1e6 for part in (x, y, z)):
        raise typer.BadParameter(f"'{text}' is farther than 1000 km away, or no number")
    return x, y, z


Shown = Annotated[
    str,
    typer.Argument(
        metavar="SCENARIO|RUN|RECORDING", help="A scenario file, the name of a shipped scenario, a run directory or a recording."
    ),
]
ScenarioOrRun = Annotated[
    str, typer.Argument(metavar="SCENARIO|RUN", help="A scenario file, the name of a shipped scenario, or a run directory.")
]
EngineOrRun = Annotated[
    str | None, option("--engine NAME", "Physics engine; by default that of the run or the scenario, else pybullet.", callback=known_engine)
]
Host = Annotated[
    str,
    option(
        "--host ADDRESS", "Address to serve on. If other machines can reach it (0.0.0.0), the printed address of the page contains a token."
    ),
]
Port = Annotated[int | None, integer("--port N", "Port of the page; by default the first free port from 8787.", 0, 65535)]
Open = Annotated[bool, option("--open", "Open the page in the browser.")]
Episode = Annotated[int, integer("--episode K", "Begin with the start of held-out episode K of `deepbots eval`.", 0)]
# Any: typer would parse each part of a tuple alone.
Size = Annotated[Any, option("--size WxH", "Width and height in pixels.", parser=size)]
From = Annotated[Any, option("--from X,Y,Z", "Position of the camera in m; by default it sees the whole scene.", parser=point)]
At = Annotated[Any, option("--at X,Y,Z", "Point in m that the camera looks at.", parser=point)]


def view(
    shown: Shown,
    driver: Annotated[
        str | None,
        option(
            "--driver NAME",
            "Who acts, as for `deepbots try`; also `policy` (of a run) and `you` (keys and sliders of the page).",
        ),
    ] = None,
    seed: Seed = 0,
    episode: Episode = 0,
    start: Start = None,
    watch: Annotated[bool, option("--watch", "Restart with the new files when a file is saved.")] = False,
    compare: Annotated[str | None, option("--compare OTHER", "Show another run or scenario beside it, from the same seeds.")] = None,
    worlds: Annotated[int | None, integer("--worlds N", "Step a batch of N worlds in MuJoCo, and show one of them.", 1, 4096)] = None,
    world: Annotated[int, integer("--world K", "The world to show first, with --worlds.", 0)] = 0,
    frame_rate: Annotated[int, integer("--fps N", "Pictures per second. A browser without a graphics card needs fewer.", 1, 60)] = 30,
    overrides: Overrides = None,
    case: Case = None,
    stage: Stage = None,
    engine: EngineOrRun = None,
    host: Host = "127.0.0.1",
    port: Port = None,
    open_: Open = False,
    permissions: Permissions = Permissions(),
) -> None:
    """Show a scenario, a run or a recording in the browser.

    The command prints the address of the page, and serves it until Ctrl-C. The page shows robots, objects, sensor rays and contacts,
    with pause, single steps, speed and seed, and plots the observation, the action and every reward term.

    In a run, the policy acts. In a scenario, the first script acts; without a script, actions are random. While a run is trained, each
    episode shows its newest policy. A recording is played, with a slider for its steps.

    With --worlds N, a batch of N worlds is stepped together in MuJoCo, and a slider chooses the world that is shown. World K begins as
    held-out episode K.

    \b
      deepbots view find_ball
      deepbots view runs/find_ball-0-1
      deepbots view runs/find_ball-0-1 --compare runs/find_ball-1-1
      deepbots view find_ball-0-0.mcap
      deepbots view mine.yaml --watch
      deepbots view find_ball --set goal=20cm --seed 3
      deepbots view panda_push --start mark=0.5,0.1
      deepbots view runs/cartpole-0-1 --worlds 16 --world 3

    Next: `deepbots play SCENARIO` lets you drive.
    """
    if world >= (worlds or 1):
        reason = f"a batch of {worlds} worlds has worlds 0 to {worlds - 1}" if worlds else "add --worlds N"
        raise UsageError(f"there is no world {world}; {reason}")
    from deepbots_cli.view.episodes import Showing

    engine = engine or ("mujoco" if worlds else None)
    source = Showing(shown, overrides or (), permissions, engine, case, stage, worlds or 0, start_values(start))
    other = replace(source, reference=compare) if compare else None
    settings = {"driver": driver, "seed": seed, "episode": episode, "world": world, "watch": watch, "frame_rate": frame_rate}
    _serve(source, open_, compare=other, host=host, port=port, **settings)


def play(
    shown: ScenarioOrRun,
    seed: Seed = 0,
    episode: Episode = 0,
    overrides: Overrides = None,
    case: Case = None,
    stage: Stage = None,
    engine: EngineOrRun = None,
    host: Host = "127.0.0.1",
    port: Port = None,
    open_: Open = False,
    permissions: Permissions = Permissions(),
) -> None:
    """Drive the robot of a scenario in the browser.

    You command the robot with keys, a gamepad, or buttons and sliders in the page. The page compares your return with that of another
    driver in the same episode: the policy of a run, or the first script of a scenario.

    \b
      deepbots play find_ball
      deepbots play runs/find_ball-0-1
      deepbots play cartpole --set world.timestep=64ms

    Next: `deepbots train SCENARIO` trains a policy.
    """
    from deepbots_cli.view.episodes import Showing

    source = Showing(shown, overrides or (), permissions, engine, case, stage)
    _serve(source, open_, host=host, port=port, seed=seed, episode=episode, playing=True)


def _serve(source: Showing, open_: bool, **options: Any) -> None:
    """Serve a page until Ctrl-C; `options` are those of `Page`."""
    from deepbots_cli.view.page import Page

    page = Page(source, **options)
    try:
        terminal.print_result(page.address)
        sys.stdout.flush()  # programs that read it wait for it
        terminal.note("Ctrl-C ends it")
        if open_:
            webbrowser.open(page.address)
        page.run()
    finally:
        page.close()


def picture(
    shown: Shown,
    out: Annotated[Path, option("--output -o PNG", "File to write.")] = Path("picture.png"),
    force: Force = False,
    size: Size = "640x480",
    eye: From = None,
    target: At = None,
    labels: Annotated[bool, option("--labels", "Name the links and joints of the first robot.")] = False,
    rays: Annotated[bool, option("--rays", "Draw the rays of sensors.")] = False,
    path: Annotated[bool, option("--path", "Run the episode, and draw the paths of what moves in it.")] = False,
    steps: Annotated[int, integer("--steps N", "Run this number of steps first.", 0)] = 0,
    driver: Driver = None,
    seed: Seed = 0,
    episode: Episode = 0,
    start: Start = None,
    overrides: Overrides = None,
    case: Case = None,
    stage: Stage = None,
    engine: EngineOrRun = None,
    permissions: Permissions = Permissions(),
) -> None:
    """Draw a picture of a scenario.

    It shows the beginning of an episode, or the world after some steps.

    With --path, it shows the end of an episode, and the paths of the robots and of the objects that the task moves. For a
    robot with a fixed base, it shows the link that the task is about. The view is from above, or from the side where a path climbs.

    \b
      deepbots picture find_ball
      deepbots picture quadruped --labels --size 960x640 --output links.png
      deepbots picture find_ball --from 0,-1.5,1 --at 0,0,0 --rays
      deepbots picture find_ball --path --driver around
      deepbots picture runs/find_ball-0-1 --path --episode 3

    Next: `deepbots clip SCENARIO` writes a video.
    """
    from deepbots_cli.view import pictures
    from deepbots_cli.view.episodes import Showing, closing_player

    pictures.check_target(out, (".png",), force=force)
    source = Showing(shown, overrides or (), permissions, engine, case, stage, start=start_values(start))
    shot = pictures.Viewpoint(size[0], size[1], eye, target)
    with closing_player(source, driver) as world:
        trace = list(world.episode(seed, episode, None if path and not steps else steps))
        image = pictures.render_picture(world, shot, labels=labels, rays=rays, path=trace if path else ())
    with atomic_write(out) as draft:
        image.save(draft, "PNG")
    terminal.print_result(str(out))


def clip(
    shown: Shown,
    out: Annotated[
        Path, option("--output -o FILE", "File to write: .mp4, .gif, or .html for an interactive page that needs no server.")
    ] = Path("clip.mp4"),
    force: Force = False,
    driver: Driver = None,
    seconds: Annotated[float | None, option("--seconds S", "Simulated seconds; by default the whole episode.", min=0.01, max=3600)] = None,
    speed: Annotated[float, option("--speed X", "Playback speed: simulated seconds per second of video.", min=0.01, max=100)] = 1.0,
    size: Size = "480x320",
    eye: From = None,
    target: At = None,
    seed: Seed = 0,
    episode: Episode = 0,
    overrides: Overrides = None,
    case: Case = None,
    stage: Stage = None,
    engine: EngineOrRun = None,
    permissions: Permissions = Permissions(),
) -> None:
    """Make a video of an episode: MP4, GIF or an offline page.

    In a run, the policy acts. In a scenario, the first script acts; without a script, actions are random.

    \b
      deepbots clip find_ball --driver around --output find_ball.gif
      deepbots clip runs/cartpole-0-1 --episode 3 --output cartpole.mp4
      deepbots clip quadruped --output quadruped.html --seconds 10

    Next: `deepbots view SCENARIO` shows it live.
    """
    from deepbots_cli.view import pictures
    from deepbots_cli.view.episodes import Showing, closing_player

    pictures.check_target(out, pictures.SUFFIXES, force=force)
    source = Showing(shown, overrides or (), permissions, engine, case, stage)
    with closing_player(source, driver) as world, terminal.transient_line("running the episode ..."):
        frame = pictures.write_clip(
            world, out, pictures.Viewpoint(size[0], size[1], eye, target), seed=seed, episode=episode, seconds=seconds, speed=speed
        )
    agent = next(iter(frame.agents.values()))
    state = frame.ending or "not ended"
    terminal.print_result(
        f"{out} ({out.stat().st_size / 1000:,.0f} kB; {state} after {frame.time:.2f} s, return {agent.episode_return:.2f})"
    )

"""`deepbots play`: drive a robot in the browser."""

from __future__ import annotations

from deepbots_cli.cli.command import AllowCode, AllowPaths, Case, Seed, Sets, Stage
from deepbots_cli.cli.verbs.view import EngineOrRun, Episode, Host, Open, Port, Shown, serve


def command(
    shown: Shown,
    seed: Seed = 0,
    episode: Episode = 0,
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
    """Drive the robot of a scenario in the browser.

    You command the robot with keys, a gamepad, or buttons and sliders in the page. The page compares your return with that of another
    driver in the same episode: the policy of a run, or the first script of a scenario.

    \b
      deepbots play find_ball
      deepbots play runs/find_ball-0-1
      deepbots play cartpole --set world.timestep=64ms

    Next: `deepbots train SCENARIO` trains a policy.
    """
    serve(shown, None, seed, episode, False, sets, case, stage, engine, host, port, open_, allow_paths, allow_code, playing=True)

"""`deepbots record`: episodes as a file that can be replayed."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from deepbots_cli.cli import records, terminal
from deepbots_cli.cli.command import Case, Driver, Force, Json, Overrides, Seed, Stage, integer, option
from deepbots_cli.cli.commands.view import EngineOrRun, Episode, ScenarioOrRun
from deepbots_cli.document import Permissions
from deepbots_cli.errors import UsageError
from deepbots_cli.rollout.source import RECORDING_SUFFIX


def command(
    shown: ScenarioOrRun,
    out: Annotated[Path | None, option("--output -o FILE", "File to write; by default NAME-SEED-EPISODE.mcap.")] = None,
    force: Force = False,
    driver: Driver = None,
    seed: Seed = 0,
    episode: Episode = 0,
    episodes: Annotated[int, integer("--episodes N", "Number of episodes, from --episode on.", 1, 10_000)] = 1,
    steps: Annotated[int | None, integer("--steps N", "Record at most N steps of each episode; by default all.", 1)] = None,
    overrides: Overrides = None,
    case: Case = None,
    stage: Stage = None,
    engine: EngineOrRun = None,
    as_json: Json = False,
    permissions: Permissions = Permissions(),
) -> None:
    """Record episodes as an MCAP file.

    For every step, the file contains poses, sensor readings, messages, actions, observations and reward terms. It also contains the ending
    of each episode and the scenario. `view`, `clip` and `picture` accept a recording in place of a scenario, Foxglove opens it, and
    `replay --verify` runs it again.

    In a run, the policy acts. In a scenario, the first script acts; without a script, actions are random.

    \b
      deepbots record find_ball --driver around
      deepbots record runs/find_ball-0-1 --episodes 5 --output five.mcap
      deepbots record quadruped --seed 3 --episode 2

    Next: `deepbots view RECORDING` plays it in the browser.
    """
    from deepbots_cli.view import pictures
    from deepbots_cli.view.episodes import Showing, closing_player
    from deepbots_cli.view.recordings import record

    if shown.endswith(RECORDING_SUFFIX):
        raise UsageError(f"{shown} is already a recording; `deepbots clip {shown}` makes a video of it")
    opened = Showing(shown, overrides or (), permissions, engine, case, stage)
    path = out or Path(f"{Path(shown).stem}-{seed}-{episode}{RECORDING_SUFFIX}")
    pictures.check_target(path, (RECORDING_SUFFIX,), force=force)
    with closing_player(opened, driver) as world, terminal.progress(always=False) as show:
        numbers = range(episode, episode + episodes)
        last = record(world, path, seed, numbers, lambda number: show(number + 1 - episode, episodes) if show else None, steps=steps)
    rows = records.recorded_rows(zip(numbers, last, strict=True))
    data, size = {"recording": path, "bytes": path.stat().st_size, "episodes": rows}, f"{path} ({path.stat().st_size / 1000:,.0f} kB)"
    next_commands = [f"deepbots view {path}", f"deepbots replay --verify {path}"]
    terminal.show(data, records.recorded_table(rows), size, as_json=as_json, next_commands=next_commands)

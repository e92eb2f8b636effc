"""`deepbots view`: a policy, a scenario or a recording in the browser."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated

from deepbots_cli.cli.command import (
    ADVANCED,
    Case,
    EngineOrRun,
    Overrides,
    Seed,
    Stage,
    Start,
    integer,
    option,
    start_values,
)
from deepbots_cli.cli.pages import Episode, Host, Open, Port, Shown, serve
from deepbots_cli.document import Permissions
from deepbots_cli.errors import UsageError


def command(
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
    serve(source, open_, compare=compared, host=host, port=port, **settings)

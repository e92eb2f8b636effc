"""`deepbots try`: episodes without learning, with random or zero actions, a list of actions, or a script of
the scenario."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from deepbots_cli import api
from deepbots_cli.cli import terminal
from deepbots_cli.cli.command import (
    Case,
    Engine,
    Json,
    Overrides,
    Seed,
    Stage,
    Start,
    integer,
    option,
    start_values,
    written_options,
)
from deepbots_cli.cli.episodes import MAX_SHOWN, run_episodes, show_episodes
from deepbots_cli.document import Permissions
from deepbots_cli.engine_kinds import with_engine
from deepbots_cli.errors import MissingExtraError, UsageError
from deepbots_cli.program import RANDOM
from deepbots_cli.rollout import Driver, Episode
from deepbots_cli.rollout.drivers import POLICY, named_driver
from deepbots_cli.words import counted

if TYPE_CHECKING:
    from deepbots_cli.cli.sources import OpenedSource
    from deepbots_cli.program import Program
    from deepbots_cli.runtime import Supervisor

ROBOT = "Robot"
COUNT = 3


def command(
    ctx: typer.Context,
    scenario: Annotated[
        str,
        typer.Argument(
            metavar="SCENARIO",
            help="A scenario file, the name of a scenario that comes with deepbots, or the file of a failed"
            " episode (.json).",
        ),
    ],
    overrides: Overrides = None,
    case: Case = None,
    stage: Stage = None,
    driver: Annotated[
        str | None,
        option(
            "--driver NAME",
            "Who acts: `random`, `zero` (the middle of each range and the first option of each choice), a"
            " script of the scenario, or actions to repeat. By default `random`; with --robot there is no"
            " default for a scenario, and a run acts with its policy.",
        ),
    ] = None,
    episodes: Annotated[
        int | None, integer("--episodes N", f"Number of episodes, {COUNT} by default; with --robot 1.")
    ] = None,
    steps: Annotated[
        int | None,
        integer(
            "--steps N", "Stop after this total number of steps; by default at the end of the last episode."
        ),
    ] = None,
    seed: Seed = 0,
    start: Start = None,
    robot: Annotated[
        str | None,
        option(
            "--robot ADDRESS",
            "Act for the robot at an address in place of the simulated one: ros, ros:DOMAIN,"
            " tcp://HOST:PORT, ipc://FILE or ws://HOST:PORT. A scenario needs --driver with it; of a run, the"
            " policy acts.",
            ROBOT,
        ),
    ] = None,
    lockstep: Annotated[
        bool,
        option(
            "--lockstep",
            "With --robot, answer each set of values once; a simulated robot then waits for the answer.",
            ROBOT,
        ),
    ] = False,
    speed: Annotated[
        float, option("--speed X", "With --robot, how many seconds of the robot pass in one second.", ROBOT)
    ] = 1.0,
    engine: Engine = None,
    as_json: Json = False,
    permissions: Permissions = Permissions(),
) -> None:
    """Run a few episodes without training."""
    if scenario.endswith(".json") and _reproduced(ctx, Path(scenario), permissions, as_json=as_json):
        return
    if robot is None and (lockstep or speed != 1.0):
        raise UsageError("--lockstep and --speed need --robot")
    options = start_values(start)
    data = {"seed": seed, "start": options, "case": case, "stage": stage}
    if robot is not None:
        recorded_with: dict[str, Any] = {
            "episodes": episodes or 1,
            "seed": seed,
            "options": options,
            "max_steps": steps,
            "engine": engine,
        }
        from deepbots_cli.cli.sources import open_source
        from deepbots_robot.server import report_lines

        source = open_source(scenario, overrides or (), permissions, engine)
        program = source.program.variant(case, stage)
        result, report = _on_robot(
            source,
            program,
            driver,
            robot,
            lockstep=lockstep,
            speed=speed,
            permissions=permissions,
            **recorded_with,
        )
        show_episodes(
            program,
            result,
            data | {"driver": driver or POLICY, "link": report},
            report_lines(report),
            as_json=as_json,
        )
        return
    compiled = api.compile(scenario, overrides=with_engine(overrides, engine), permissions=permissions)
    terminal.note_warnings(compiled.findings, scenario)
    program = compiled.program.variant(case, stage)
    driver = RANDOM if driver is None else driver
    outcomes, name = _simulate(program, driver, episodes or COUNT, seed, steps, options, permissions)
    show_episodes(
        program,
        outcomes,
        {"digest": compiled.digest, "engine": name, **data, "driver": driver},
        (),
        as_json=as_json,
    )


def _simulate(
    program: Program,
    driver: str,
    count: int,
    seed: int,
    max_steps: int | None,
    options: dict[str, Any],
    permissions: Permissions,
) -> tuple[list[Episode], str]:
    """Run episodes in the simulation. Returns them, and the name of the engine. Many episodes are counted
    while they run."""
    with closing(api.make(program, permissions=permissions)) as environment:
        acting = named_driver(environment, driver)
        running = run_episodes(
            environment, acting, count=count, seed=seed, max_steps=max_steps, options=options
        )
        outcomes: list[Episode] = []
        with terminal.progress() as show:
            for episode in running:
                outcomes.append(episode)
                if count > MAX_SHOWN:
                    show(len(outcomes), count)
        return outcomes, environment.engine.name


def _on_robot(
    source: OpenedSource, program: Program, driver: str | None, address: str, **settings: Any
) -> tuple[list[Episode], dict[str, Any]]:
    """Run episodes on the robot at an address, with the policy of a run, or a named driver."""
    if driver is None and source.run is None:
        raise UsageError(
            "--robot needs --driver NAME: random, zero, a script of the scenario, or actions; or name a run,"
            " whose policy acts"
        )
    if not 0.0 < settings["speed"] <= 1000.0:
        raise UsageError(f"--speed {settings['speed']:g}: write a number above 0, at most 1000")
    try:
        from deepbots_cli.insight.real_robot import try_robot
        from deepbots_robot.serving import ServeError, Transport
    except ModuleNotFoundError as error:
        raise MissingExtraError("robot", "acting for a robot") from error
    run = source.run

    def acting(world: Supervisor) -> Driver:
        if driver is not None and (driver != POLICY or run is None):
            return named_driver(world, driver)
        from deepbots_cli.learning import policy
        from deepbots_cli.rollout.policies import PolicyDriver

        assert run is not None  # a scenario has a driver
        return PolicyDriver(policy.loaded(run, source.model), world)

    try:
        transport = Transport.at(address)
    except ServeError as error:
        raise UsageError(str(error)) from None
    return try_robot(program, transport, acting, note=terminal.note, **settings)


def _reproduced(ctx: typer.Context, path: Path, permissions: Permissions, *, as_json: bool) -> bool:
    """Repeat a failed episode; return whether the file is one."""
    from deepbots_cli.learning import failures  # this imports gymnasium

    if not failures.is_failure(path):
        return False
    refused = [name for key, name in written_options(ctx).items() if key not in ("as_json", "allow_code")]
    if refused:
        raise UsageError(
            f"leave out {', '.join(refused)}: the file of a failed episode already contains its scenario,"
            " start and actions; only --json and --allow-code can be added"
        )
    failure, error = failures.reproduce(path, permissions=permissions)
    repeated = (
        f"repeated {counted(len(failure.actions), 'action')}:"
        f" {'the episode does not fail' if error is None else error}"
    )
    terminal.show(
        {**failure.model_dump(), "reproduced": error}, f"{path}: {failure.error}", repeated, as_json=as_json
    )
    return True

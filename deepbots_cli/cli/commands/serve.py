"""`deepbots serve`: the policy of a bundle acts for a robot, or a simulation stands in for the robot."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from shlex import quote
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Annotated, Any

import typer

from deepbots_cli.cli import terminal
from deepbots_cli.cli.command import EPISODES, Engine, Json, Overrides, integer, option
from deepbots_cli.document import Permissions
from deepbots_cli.errors import DeepbotsError, MissingExtraError, UsageError
from deepbots_cli.rollout.source import SourceKind, folder_kind
from deepbots_cli.words import number_text

if TYPE_CHECKING:
    from deepbots_cli.insight.robot import SimulatedRobot
    from deepbots_cli.rollout import Episode
    from deepbots_robot.serving import Transport

_LINK = "Link"


def command(
    source: Annotated[
        str,
        typer.Argument(
            metavar="BUNDLE|RUN|MODEL|SCENARIO",
            help="A bundle of `export`, a run or a model in it; with --as-robot a scenario or a run.",
        ),
    ],
    as_robot: Annotated[
        bool, option("--as-robot", "Simulate the robot of a scenario: send its sensors and obey commands.")
    ] = False,
    ros: Annotated[
        bool, option("--ros", "Use ROS 2 topics, by Cyclone DDS; this is the default.", _LINK)
    ] = False,
    zmq: Annotated[
        str | None,
        option(
            "--zmq ADDRESS",
            "Use ZeroMQ at an address such as tcp://127.0.0.1:5555; the policy binds it.",
            _LINK,
        ),
    ] = None,
    websocket: Annotated[
        str | None,
        option(
            "--websocket PORT",
            "Use WebSocket at a port of this machine, or at HOST:PORT; the policy listens.",
            _LINK,
        ),
    ] = None,
    interface: Annotated[
        str | None,
        option("--interface NAME", "Network interface of ROS 2; by default the loopback interface.", _LINK),
    ] = None,
    domain: Annotated[int, integer("--domain N", "Domain of ROS 2, as ROS_DOMAIN_ID.", 0, 232, _LINK)] = 0,
    lockstep: Annotated[
        bool,
        option(
            "--lockstep",
            "Let the simulated robot wait for each command; give the option on both sides. The time of day"
            " does not count.",
        ),
    ] = False,
    speed: Annotated[
        float, option("--speed X", "Seconds of the robot in one second, the same on both sides.")
    ] = 1.0,
    seconds: Annotated[
        float | None, option("--seconds X", "End after this time; by default at Ctrl-C. Not with --as-robot.")
    ] = None,
    log: Annotated[
        Path | None, option("--log FILE", "Write an MCAP log of values and commands. Not with --as-robot.")
    ] = None,
    trusted: Annotated[
        Path | None,
        option(
            "--trusted FILE",
            "Serve only a bundle that is signed with one of the public keys in this file. Not with"
            " --as-robot.",
        ),
    ] = None,
    episodes: Annotated[
        int | None, integer("--episodes N", "End after N episodes; by default at Ctrl-C.", group=EPISODES)
    ] = None,
    seed: Annotated[
        int,
        integer(
            "--seed N",
            "Root seed; the episodes start as those of an evaluation with this seed.",
            0,
            group=EPISODES,
        ),
    ] = 0,
    overrides: Overrides = None,
    engine: Engine = None,
    as_json: Json = False,
    permissions: Permissions = Permissions(),
) -> None:
    """Let a policy act for a robot, or simulate the robot."""
    links = [
        name for name, present in (("--ros", ros), ("--zmq", zmq), ("--websocket", websocket)) if present
    ]
    if len(links) > 1:
        raise UsageError(f"{' and '.join(links)} are different links; choose one")
    if links not in ([], ["--ros"]) and (interface is not None or domain):
        raise UsageError(f"--interface and --domain belong to ROS 2; leave them out with {links[0]}")
    if not 0.0 < speed <= 1000.0:
        raise UsageError(f"--speed {speed:g}: write a number above 0, at most 1000")
    if seconds is not None and not 0.0 < seconds < float("inf"):
        raise UsageError(
            f"--seconds {seconds:g}: write a number of seconds above 0; without the option, Ctrl-C ends it"
        )
    try:
        from deepbots_robot.serving import Transport
    except ModuleNotFoundError as error:
        raise MissingExtraError("robot", "serving a policy") from error
    transport = Transport(zmq, websocket, interface, domain)
    if not as_robot:
        if episodes is not None or seed or overrides or engine or permissions != Permissions():
            raise UsageError(
                "--episodes, --seed, --set, --engine and --allow-... belong to a simulated robot; add"
                " --as-robot or leave them out"
            )
        settings: dict[str, Any] = {"speed": speed, "lockstep": lockstep, "log": log, "seconds": seconds}
        _serve_policy(Path(source), transport, trusted=trusted, as_json=as_json, **settings)
        return
    if log is not None or seconds is not None or trusted is not None:
        raise UsageError(
            "--log, --seconds and --trusted belong to the policy; leave them out with --as-robot"
        )
    from deepbots_cli.cli.sources import open_source
    from deepbots_cli.insight.robot import serve_robot

    side = open_source(source, overrides or (), permissions, engine)
    engine = engine or (side.run.engine_for(side.program) if side.run else None)
    settings = {
        "episodes": episodes,
        "seed": seed,
        "engine": engine,
        "permissions": permissions,
        "note": terminal.note,
    }
    running = serve_robot(side.program, transport, lockstep=lockstep, speed=speed, **settings)
    _simulate(side.program.name, running, as_json=as_json, success=side.program.defines_success)


def _serve_policy(
    folder: Path, transport: Transport, *, trusted: Path | None, as_json: bool, **settings: Any
) -> None:
    from deepbots_robot.bundle import load
    from deepbots_robot.model import BundleError
    from deepbots_robot.server import report_lines
    from deepbots_robot.serving import ServeError, nothing_served, serve

    with ExitStack() as stack:
        if folder_kind(folder) is SourceKind.RUN or folder.suffix == ".zip":
            if trusted is not None:
                raise UsageError(
                    f"{folder} is a run, and --trusted needs a signed bundle: deepbots export"
                    f" {quote(str(folder))} --sign KEY"
                )
            folder = _exported(folder, stack)
        try:
            report = serve(load(folder, trusted=trusted), transport, note=terminal.note, **settings)
        except (BundleError, ServeError) as error:
            raise UsageError(str(error)) from None
    terminal.show(report, *report_lines(report), as_json=as_json)
    nothing = nothing_served(report, settings["seconds"])
    if nothing:
        raise DeepbotsError(nothing)


def _exported(folder: Path, stack: ExitStack) -> Path:
    """Export the bundle of the best model of a run, or of a named model, into a folder that lasts as long as
    `stack`."""
    from deepbots_cli.cli.sources import run_to_export
    from deepbots_cli.insight.export.bundle import bundle_files
    from deepbots_cli.learning.runs.run import ModelRef

    ref = ModelRef.open(folder)
    run = run_to_export(ref.run, agent=None)
    with terminal.transient_line("exporting the policy ..."):
        bundle = Path(stack.enter_context(TemporaryDirectory())) / run.path.resolve().name
        for name, content in bundle_files(run, ref.name).items():
            path = bundle / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)
    return bundle


def _simulate(name: str, running: Any, *, as_json: bool, success: bool) -> None:
    """Show each episode, and at the end a summary of all of them."""
    episodes: list[Episode] = []
    robots: list[SimulatedRobot] = []
    terminal.note(f"{name} waits for a policy")
    try:
        for episode, robot in running:
            episodes.append(episode)
            robots = [robot]
            ending = f"{'success' if episode.is_success else 'no success'}, " if success else ""
            terminal.note(
                f"episode {len(episodes) - 1}: {ending}{episode.ended_by} after {episode.length} steps,"
                f" return {number_text(episode.total_return, 6)}"
            )
    except KeyboardInterrupt:
        terminal.note("interrupted")
    if not episodes:
        return
    from deepbots_cli.insight.robot import report, report_lines

    outcome = report(episodes, robots[0], success_defined=success)
    terminal.show(outcome, *report_lines(outcome), as_json=as_json)

"""`deepbots export`: a policy for a robot, and whether it fits a scenario; `serve`: the policy acts for a
robot, or a simulation stands in for the robot."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import ExitStack
from enum import StrEnum
from pathlib import Path, PurePosixPath
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Annotated, Any

import typer

from deepbots_cli import api
from deepbots_cli.cli import terminal
from deepbots_cli.cli.arguments import open_source, run_to_export
from deepbots_cli.cli.command import (
    ADVANCED,
    EPISODES,
    AllowPaths,
    Engine,
    Force,
    Json,
    Overrides,
    check_options,
    entry_of_webots,
    integer,
    option,
)
from deepbots_cli.cli.exits import FAILED
from deepbots_cli.cli.written_files import check_new_folder, refuse_links_within, write_new
from deepbots_cli.document import Permissions
from deepbots_cli.errors import DeepbotsError, MissingExtraError, UsageError
from deepbots_cli.learning.runs.run import ModelName, ModelRef
from deepbots_cli.program import identity
from deepbots_cli.rollout.source import Source, SourceKind, folder_kind
from deepbots_cli.words import number_text, shell_word

if TYPE_CHECKING:
    from deepbots_cli.insight.robot import SimulatedRobot
    from deepbots_cli.rollout import Episode
    from deepbots_robot.serving import Transport


class Form(StrEnum):
    bundle = "bundle"
    hub = "hub"
    isaac_lab = "isaac-lab"
    lerobot = "lerobot"
    webots = "webots"


def command(
    ctx: typer.Context,
    source: Annotated[
        Path | None,
        typer.Argument(
            metavar="RUN|MODEL|BUNDLE|SCENARIO",
            help="A run directory, a model in it, with --check a folder that `export` wrote, or with --to"
            " webots a scenario.",
            show_default=False,
        ),
    ] = None,
    out: Annotated[
        Path | None, option("--output -o FOLDER", "Folder to write; by default RUN-bundle.")
    ] = None,
    to: Annotated[
        Form,
        option(
            "--to",
            "A bundle, a repository of a model hub, the files that runners of Isaac Lab or LeRobot read, or a"
            " project of Webots.",
            ADVANCED,
        ),
    ] = Form.bundle,
    force: Force = False,
    agent: Annotated[
        str | None,
        option("--agent NAME", "If a run trained several agents, the one whose policy to export."),
    ] = None,
    last: Annotated[
        bool, option("--last", "Export the last model instead of the best one.", ADVANCED)
    ] = False,
    check: Annotated[
        str | None,
        option("--check SCENARIO", "Compare a bundle with a scenario, item by item; write nothing."),
    ] = None,
    sign: Annotated[
        Path | None, option("--sign KEY", "Sign the bundle with this private key (Ed25519).", ADVANCED)
    ] = None,
    new_key: Annotated[
        Path | None, option("--new-key FILE", "Write a new private key, and FILE.pub beside it.", ADVANCED)
    ] = None,
    overrides: Overrides = None,
    as_json: Json = False,
    allow_paths: AllowPaths = None,
) -> None:
    """Export a policy, sign it, or compare a bundle with a scenario."""
    if new_key is not None:
        check_options(ctx, "a new key")
        if source is not None:
            raise UsageError("--new-key makes a key and exports nothing; give it alone")
        _write_key(new_key, as_json=as_json)
        return
    if source is None:
        raise UsageError("write what to export, such as a folder under runs: deepbots export RUN")
    if check is not None:
        _check(
            source,
            check,
            overrides or (),
            Permissions(allow_paths or (), code=True),
            as_json=as_json,
        )
        return
    if to is Form.webots:
        entry_of_webots("exporter")(
            source, out, overrides or (), Permissions(allow_paths or ()), agent, last, force, as_json
        )
        return
    check_options(ctx, "a policy")
    model = "last" if last else "best"
    if out is not None:
        check_new_folder(out, force=force)
        refuse_links_within(out)
    opened = Source.open(source, Permissions(), SourceKind.RUN, SourceKind.CHECKPOINT)
    suffix = "".join(f"-{name}" for name in (agent, opened.model) if name is not None)
    folder = out or Path(f"{opened.path.resolve().name}{suffix}-{to.value}")
    check_new_folder(folder, force=force)
    refuse_links_within(folder)
    ref = ModelRef.open(opened, model=model)
    run = run_to_export(ref.run, agent)
    with terminal.transient_line("exporting the policy ..."):
        from deepbots_cli.insight.export import bundle

        files = (
            bundle.bundle_files(run, ref.name, sign)
            if to is Form.bundle
            else bundle.files_for(run, ref.name, to.value)
        )
    if to is not Form.bundle:
        write_new(files, folder, force=force)
        _show_folder(folder, files, to, as_json=as_json)
        return
    write_new(files, folder, force=force)
    _show_bundle(folder, files, ref.name, source, as_json=as_json)


def _show_folder(folder: Path, files: Mapping[PurePosixPath, bytes], form: Form, *, as_json: bool) -> None:
    """Print the files for another program, and for a hub how to upload them."""
    is_hub = form is Form.hub
    upload = (
        [f"hf upload YOUR_NAME/{shell_word(folder.resolve().name)} {shell_word(folder)}"] if is_hub else []
    )
    if is_hub and PurePosixPath("replay.mp4") not in files:
        terminal.note("there is no video, because this machine draws no pictures or writes no MP4")
    terminal.show(
        {"folder": folder}, f"{folder}: {', '.join(map(str, files))}", as_json=as_json, next_commands=upload
    )


def _show_bundle(
    folder: Path, files: Mapping[PurePosixPath, bytes], model: ModelName, source: Path, *, as_json: bool
) -> None:
    """Print the content of a new bundle, and its gaps; `source` is the run as it was named."""
    from deepbots_cli.insight.export import bundle
    from deepbots_robot.model import plain

    info = bundle.read_bundle(folder)
    sizes = [
        f"{name} ({len(content) / 1000:,.0f} kB)" for name, content in files.items() if len(name.parts) == 1
    ]
    result = (
        "not evaluated since the end of the training" if info.evaluation is None else info.evaluation.text
    )
    lines = [
        f"{folder}: {', '.join(sizes)}, and the robot files of the scenario",
        f"  {info.scenario.name}, {info.training.algorithm}: {result}",
    ]
    missing = [
        entry.name for entry in info.inputs if entry.source == "supervisor" and entry.supplied_by is None
    ]
    if missing and not as_json:
        terminal.note(
            f"no robot measures {', '.join(missing)}; README.md of the bundle says what must supply them"
        )
    if info.evaluation is None and model == "best" and not as_json:
        terminal.note(
            f"evaluate the run first for a result in the bundle: deepbots eval {shell_word(source)}"
        )
    next_commands = [
        f"deepbots serve {shell_word(folder)}",
        f"deepbots export --check {shell_word(folder / 'scenario.yaml')} {shell_word(folder)}",
    ]
    terminal.show(
        {"bundle": folder, **plain(info)}, "\n".join(lines), as_json=as_json, next_commands=next_commands
    )


def _write_key(file: Path, *, as_json: bool) -> None:
    """Write a private and a public key."""
    try:
        from deepbots_robot import signature
    except ModuleNotFoundError as error:
        raise MissingExtraError("robot", "making a key") from error
    try:
        public = signature.write_key(file)
    except signature.KeyFileError as error:
        raise UsageError(str(error)) from error
    terminal.show(
        {"private_key": file, "public_key": public},
        f"{file}: the private key, which signs; keep it where you export, and nowhere else",
        f"{public}: the public key, for the computer of the robot",
        as_json=as_json,
        next_commands=[
            f"deepbots export RUN --sign {shell_word(file)}",
            f"deepbots serve BUNDLE --trusted {shell_word(public)}",
        ],
    )


def _check(
    folder: Path,
    scenario: str,
    overrides: list[str] | tuple[()],
    permissions: Permissions,
    *,
    as_json: bool,
) -> None:
    from deepbots_cli.insight.export import bundle

    contents = bundle.read_bundle(folder)
    compiled = api.compile(scenario, overrides=overrides, permissions=permissions)
    words = ("bundle", "scenario")
    differ = identity.compare_interfaces(
        contents.scenario.interface, identity.interface(compiled.program), words=words
    )
    settings = "".join(f" {option}" for option in terminal.scenario_options(permissions, overrides))
    remarks = bundle.remarks(
        contents,
        compiled.program,
        f"deepbots diff {shell_word(folder / 'scenario.yaml')} {shell_word(scenario)}{settings}",
    )
    verdict = (
        f"the policy in {folder} does not fit {scenario}:"
        if differ
        else f"the policy in {folder} fits {scenario}"
    )
    data = {
        "bundle": folder,
        "scenario": scenario,
        "fits": not differ,
        "differences": differ,
        "remarks": remarks,
    }
    terminal.show(data, verdict, *(f"  {line}" for line in differ), as_json=as_json)
    if not as_json:
        for remark in remarks:
            terminal.note(f"note: {remark}")
    if differ:
        raise typer.Exit(FAILED)


_LINK = "Link"


def command_serve(
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
        settings: dict[str, Any] = {"speed": speed, "lockstep": lockstep, "log": log, "seconds": seconds}
        _serve_policy(Path(source), transport, trusted=trusted, as_json=as_json, **settings)
        return
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
                    f" {shell_word(folder)} --sign KEY"
                )
            folder = _exported_bundle(folder, stack)
        try:
            report = serve(load(folder, trusted=trusted), transport, note=terminal.note, **settings)
        except (BundleError, ServeError) as error:
            raise UsageError(str(error)) from None
    terminal.show(report, *report_lines(report), as_json=as_json)
    nothing = nothing_served(report, settings["seconds"])
    if nothing:
        raise DeepbotsError(nothing)


def _exported_bundle(folder: Path, stack: ExitStack) -> Path:
    """Export the bundle of the best model of a run, or of a named model, into a folder that lasts as long as
    `stack`."""
    from deepbots_cli.insight.export.bundle import bundle_files

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

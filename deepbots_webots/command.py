"""`deepbots webots`: a world of Webots, with its controllers, on MuJoCo; what `deepbots new --webots` writes."""

from __future__ import annotations

import os
import sys
import time
import webbrowser
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NoReturn

import typer

from deepbots_cli.cli import terminal
from deepbots_cli.cli.command import Host, Json, Open, Port, integer, option
from deepbots_cli.cli.exits import FAILED, INTERRUPTED
from deepbots_cli.cli.tables import table
from deepbots_cli.errors import UsageError
from deepbots_cli.words import counted

if TYPE_CHECKING:
    from deepbots_cli.cli.command import Starter
    from deepbots_webots.project import Program, World
    from deepbots_webots.runner import Outcome
    from deepbots_webots.scene import Robot, Scene

_MAX_NAMED = 5
"""The maximum number of worlds that a message names."""


def command(
    world: Annotated[Path, typer.Argument(metavar="WORLD.wbt", help="The world of a project of Webots.")],
    allow_code: Annotated[
        bool,
        option(
            "--allow-code",
            "Run the controllers of the project: programs with all rights of yours. Without this option, the"
            " world is only checked.",
        ),
    ] = False,
    steps: Annotated[
        int | None, integer("--steps N", "End after this number of basic time steps; by default, never.")
    ] = None,
    timeout: Annotated[
        float, option("--timeout SECONDS", "End if a controller does not step for this time.", min=0.1)
    ] = 600.0,
    fast: Annotated[
        bool | None,
        typer.Option(
            "--fast/--real-time",
            help="Run as fast as the machine can, or at the pace of a clock, which is the default with"
            " --view.",
        ),
    ] = None,
    protos: Annotated[
        list[Path] | None,
        option(
            "--protos DIR",
            "A copy of Webots, or a folder with PROTO files, from which the world may read; may be repeated."
            " WEBOTS_HOME is another one.",
        ),
    ] = None,
    python: Annotated[
        Path | None,
        option(
            "--python FILE",
            "The interpreter of the environment whose packages the controllers import; it has the same"
            " version as this one.",
        ),
    ] = None,
    controller: Annotated[
        list[str] | None,
        option(
            "--controller ROBOT=FILE",
            "The program of a robot, such as of one whose controller is <extern>; may be repeated.",
        ),
    ] = None,
    view: Annotated[
        bool,
        option(
            "--view", "Show the run in the browser, where keys are pressed for a Keyboard, until it ends."
        ),
    ] = False,
    host: Host = "127.0.0.1",
    port: Port = None,
    open_: Open = False,
    as_json: Json = False,
) -> None:
    """Run the controllers of a world of Webots."""
    chosen = _chosen(controller or ())
    with _checked(world, protos or ()):
        read, scene, programs = _read(world, protos or (), chosen)
        if not allow_code:
            _show_robots(scene, programs, as_json=as_json)
            return
        from deepbots_webots.runner import Runner, packages_of
        from deepbots_webots.simulation import Pace, Simulation

        simulation = Simulation(scene, read.span)
        pace = Pace(simulation, is_fast=not view if fast is None else fast)
        try:
            with ExitStack() as stack:
                after_step: list[Callable[[], None]] = []
                if view:
                    from deepbots_webots.viewer import Viewer

                    viewer = stack.enter_context(Viewer(simulation, pace, world.name, host, port))
                    after_step.append(viewer)
                    terminal.note(viewer.address)
                    terminal.note("Ctrl-C ends it")
                    if open_:
                        webbrowser.open(viewer.address)
                runner = Runner(
                    simulation,
                    programs,
                    steps=steps,
                    timeout=timeout,
                    packages=packages_of(python) if python is not None else (),
                    # With --json, the standard output has the JSON alone.
                    output=sys.stderr if as_json else None,
                    pace=pace,
                    after_step=after_step,
                )
                started = time.perf_counter()
                outcome = runner.run()
                seconds = time.perf_counter() - started
        except KeyboardInterrupt:
            terminal.note("interrupted")
            _leave(INTERRUPTED)
    _report(outcome, seconds, simulation.physics_seconds, as_json=as_json)
    if outcome.is_stuck:
        _leave(outcome.exit_code)
    if outcome.exit_code:
        raise typer.Exit(outcome.exit_code)


def start(world: Path, protos: Sequence[Path], name: str, title: str) -> Starter:
    """Return the scenario of a world, for `deepbots new --webots`.

    Raises:
        UsageError: There is no such file or folder, or no valid scenario comes out.
    """
    from deepbots_webots.imports.starter import from_webots

    with _checked(world, protos):
        return from_webots(world, protos, name, title)


@contextmanager
def _checked(world: Path, protos: Sequence[Path]) -> Iterator[None]:
    """Context that checks the paths of a command first, and that prints the errors of the world."""
    from deepbots_webots.syntax import WorldError

    check_world(world)
    for folder in protos:
        if not folder.is_dir():
            raise UsageError(f"--protos {folder}: there is no such folder")
    try:
        yield
    except WorldError as error:
        for finding in error.findings:
            terminal.note(str(finding))
        raise typer.Exit(FAILED) from error


def check_world(path: Path) -> None:
    """Check that a file exists and has the ending of a world.

    Raises:
        UsageError: It does not.
    """
    if path.suffix == ".wbt" and path.is_file():
        return
    if path.exists() and not path.is_dir():
        raise UsageError(f"{path} is not a world; name a file that ends in .wbt")
    folder = path if path.is_dir() else path.parent
    files = (*folder.glob("*.wbt"), *folder.glob("worlds/*.wbt"))
    worlds = sorted(str(world.relative_to(folder)) for world in files)[:_MAX_NAMED]
    hint = f"; {folder} has the worlds {', '.join(worlds)}" if worlds else "; name a file that ends in .wbt"
    raise UsageError(f"{path} is a folder{hint}" if path.is_dir() else f"{path} does not exist{hint}")


def _chosen(words: Iterable[str]) -> dict[str, Path]:
    """Return the programs of `--controller ROBOT=FILE` by the name of the robot.

    Raises:
        UsageError: A text has no `=`, or a file does not exist.
    """
    chosen = {}
    for word in words:
        # The name of a robot and a path may contain `=`, too.
        splits = [(word[:at], Path(word[at + 1 :])) for at, sign in enumerate(word) if sign == "="]
        robot, path = next((split for split in splits if split[1].is_file()), ("", None))
        if path is None:
            problem = (
                "there is no such file" if splits else "write ROBOT=FILE, such as e-puck=controllers/c/c.py"
            )
            raise UsageError(f"--controller {word}: {problem}")
        chosen[robot] = path.resolve()
    return chosen


def _read(
    path: Path, protos: Sequence[Path], chosen: Mapping[str, Path]
) -> tuple[World, Scene, list[tuple[Robot, Program]]]:
    """Return a world, its scene, and its robots with their programs; print its warnings."""
    from deepbots_webots.project import programs, read_world
    from deepbots_webots.scene import build_scene

    world = read_world(path, protos)
    scene = build_scene(world)
    for warning in world.findings.warnings:
        terminal.note(str(warning))
    world.findings.require_none()
    names = [robot.name for robot in scene.robots]
    unknown = next((name for name in chosen if name not in names), None)
    if unknown is not None:
        robots = f"the robots of the world are {', '.join(names)}" if names else "the world has no robots"
        raise UsageError(f"--controller {unknown}=...: {robots}")
    pairs = list(programs(world.files, scene.robots, chosen))
    for _, program in pairs:
        if program.remark:
            terminal.note(program.remark)
    return world, scene, pairs


def _show_robots(scene: Scene, programs: Sequence[tuple[Robot, Program]], *, as_json: bool) -> None:
    paths = {robot: program.path for robot, program in programs}
    rows = [
        {
            "robot": robot.name,
            "supervisor": "yes" if robot.is_supervisor else "no",
            # The file of a controller that has another name.
            "controller": robot.controller if path is None or path.stem == robot.controller else path.name,
            "runs": "yes" if path is not None else "no",
            "devices": ", ".join(robot.devices),
        }
        for robot, path in ((robot, paths.get(robot)) for robot in scene.robots)
    ]
    none = "the world has no robots, so that no controller would run"
    note = "add --allow-code to run these controllers, if you trust the project" if rows else none
    terminal.show(rows, table(rows, is_prose=True), *([note] if not as_json else []), as_json=as_json)


def _leave(code: int) -> NoReturn:
    """End the process. Controllers that run are threads, which nothing else ends."""
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)


def _report(outcome: Outcome, seconds: float, physics: float, *, as_json: bool) -> None:
    for problem in outcome.problems:
        terminal.print_error(problem)
    rate = outcome.seconds / max(seconds, 1e-9)
    speed = f"{rate:.0f}" if rate >= 10 else f"{rate:.2g}"
    facts = {
        "exit_code": outcome.exit_code,
        "steps": outcome.steps,
        "simulated_s": outcome.seconds,
        "wall_s": round(seconds, 3),
        "physics_cpu_s": round(physics, 3),
        "controllers": [
            {"robot": name, "exit_code": code, "steps": count} for name, code, count in outcome.controllers
        ],
    }
    if as_json:
        terminal.show_json(facts)
        return
    terminal.note(
        f"{counted(outcome.steps, 'step')}, {outcome.seconds:g} s of simulated time in {seconds:.1f} s"
        f" ({speed} times real time; {physics:.1f} s of CPU for the physics)"
    )

"""`deepbots inspect`."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path
from typing import Annotated

import typer

from deepbots_cli import api
from deepbots_cli.cli import anatomy, robot_file, terminal
from deepbots_cli.cli import picture as drawing
from deepbots_cli.cli.comparison.sides import opened
from deepbots_cli.cli.options import AllowCode, AllowPaths, Case, Json, Sets, Stage, chosen
from deepbots_cli.cli.tables import pairs, table
from deepbots_cli.diagnostics import Source, Span
from deepbots_cli.document import Mapping
from deepbots_cli.document.load import under
from deepbots_cli.errors import EngineError, EvaluationError, MissingExtraError
from deepbots_cli.program import Program

_CAPTIONS = {
    "observation": "low .. high becomes what the policy sees; values beyond are clipped",
    "poses": "of the ends of robots at the start of the episode with seed 0, world frame",
    "drawn": "anew at every reset, in SI units",
    "hyperparameters": "from the scenario, from a default of deepbots, or from the library's own default",
    "timing": "in step n of the agent; n counts from 0, physics steps from 1",
}


def command(
    scenario: Annotated[
        str,
        typer.Argument(
            metavar="SCENARIO|RUN|ROBOT", help="A scenario or robot file (a path, package://..., a shipped name), or a run directory."
        ),
    ],
    sets: Sets = None,
    case: Case = None,
    stage: Stage = None,
    picture: Annotated[
        Path | None, typer.Option("--picture", metavar="PNG", help="Also draw the world at the start of an episode; the file is replaced.")
    ] = None,
    as_json: Json = False,
    allow_paths: AllowPaths = None,
    allow_code: AllowCode = False,
) -> None:
    """Show what a scenario means: spaces, messages, reward, timing. Or what a robot file holds: links, joints, what is odd.

    Of a run directory it shows the scenario that the run was trained with, and how far the training has come.

    Figures are in SI units. The table of poses tells where the ends of robots are when an episode begins, if the simulator is installed.
    The table of timing tells from which physics step an action acts and how old each observation is.

    \b
      deepbots inspect cartpole
      deepbots inspect cartpole --picture world.png
      deepbots inspect cartpole --set messages.timing=paper
      deepbots inspect find_ball_random --stage few
      deepbots inspect runs/cartpole-0-1
      deepbots inspect package://pybullet_data/husky/husky.urdf --picture husky.png
    """
    if picture is not None:
        drawing.check(picture)
    if robot_file.named(scenario):
        _inspect_robot(scenario, picture, as_json)
        return
    side = opened(scenario, sets or (), allow_paths or (), allow_code=allow_code)
    terminal.mention(side.findings, scenario)
    ir = chosen(side.ir, case, stage)
    root = side.root if isinstance(side.root, Mapping) else Mapping(Span(Source(scenario, ""), 0, 0), {})
    if case is not None:
        root = under(root, ("evaluation", "cases", case))
    elif stage is not None:
        root = under(root, ("curriculum", [known.name for known in side.ir.curriculum].index(stage)))
    tables = {**anatomy.sections(ir, root, side.run), **_start(ir, picture, allow_code=allow_code)}
    if as_json:
        terminal.show_json(tables)
    else:
        _show(tables)
    if picture is not None:
        terminal.note(f"the world is drawn in {picture}")


def _start(ir: Program, picture: Path | None, *, allow_code: bool) -> anatomy.Sections:
    """Where the ends of robots are at the start of an episode, if the simulator is installed; draws the world if a picture is asked for."""
    links = anatomy.end_links(ir)
    if picture is None and not links:
        return {}
    try:
        with closing(api.make(ir, render_mode="rgb_array" if picture else None, allow_code=allow_code)) as environment:
            environment.reset(seed=0)
            if picture is not None:
                picture.write_bytes(drawing.png(environment.render()))
            rows = anatomy.poses(environment, links)
            return {"poses": rows} if rows else {}
    except MissingExtraError:
        if picture is not None:
            raise
    except (EngineError, EvaluationError) as error:
        if picture is not None:
            raise
        terminal.note(f"no poses are shown, since no episode can begin: {error}")
    return {}


def _inspect_robot(reference: str, picture: Path | None, as_json: bool) -> None:
    robot, findings = robot_file.opened(reference)
    tables = robot_file.sections(robot, findings)
    if picture is not None:
        picture.write_bytes(robot_file.photograph(robot.model))
    if as_json:
        terminal.show_json(tables)
    else:
        _show({name: rows for name, rows in tables.items() if name != "findings"})
        if findings:
            terminal.show_findings(findings)
    if picture is not None:
        terminal.note(f"the robot is drawn in {picture}")


def _show(tables: anatomy.Sections) -> None:
    for name, rows in tables.items():
        terminal.say(f"{name}{f': {_CAPTIONS[name]}' if name in _CAPTIONS else ''}")
        terminal.say((table(rows) if isinstance(rows, list) else pairs(rows)) + "\n")

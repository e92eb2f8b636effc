"""`deepbots inspect`: a scenario, a run or a robot file as the tables of `cli/inspection.py`, and a picture of it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from deepbots_cli import api
from deepbots_cli.cli import inspection, terminal
from deepbots_cli.cli.command import Case, Engine, Force, Json, Overrides, Stage, option
from deepbots_cli.cli.sources import is_robot, open_robot, open_source
from deepbots_cli.cli.tables import row_as_lines, table
from deepbots_cli.diagnostics import Source, Span
from deepbots_cli.diagnostics.render import summary
from deepbots_cli.document import MappingNode, Permissions, shipped
from deepbots_cli.document.load import with_settings_at
from deepbots_cli.engine_kinds import chosen
from deepbots_cli.errors import EngineError, EvaluationError, MissingExtraError, UsageError
from deepbots_cli.files import atomic_write, check_output
from deepbots_cli.footprint import resting_height, robot_bounds
from deepbots_cli.frames import add
from deepbots_cli.program import Program
from deepbots_cli.program.world import RobotBody, WorldModel
from deepbots_cli.robots.model import Pose, RobotModel

if TYPE_CHECKING:
    from deepbots_cli.port import Image

_CAPTIONS = {
    "observation": "low .. high is mapped to the range in `seen_as`; values outside are clipped",
    "poses": "end links of the robots at the start of the episode with seed 0, in the world frame",
    "drawn": "values that each reset draws anew, in SI units",
    "hyperparameters": "`from` names the source of each value: the scenario, or the default of deepbots or of the library",
    "timing": "the physics step of each action and measurement, for step n = 0, 1, ... of the agent; the first physics step is 1",
}


def command(
    scenario: Annotated[
        str,
        typer.Argument(
            metavar="SCENARIO|RUN|ROBOT",
            help="A scenario file, a robot file (URDF), the name of a shipped scenario or robot, or a run directory.",
        ),
    ],
    overrides: Overrides = None,
    case: Case = None,
    stage: Stage = None,
    picture: Annotated[Path | None, option("--picture PNG", "Also write a picture of the start of an episode to this file.")] = None,
    force: Force = False,
    engine: Engine = None,
    as_json: Json = False,
    permissions: Permissions = Permissions(),
) -> None:
    """Show a scenario, a run or a robot file as tables.

    The tables of a scenario show spaces, messages, reward, timing and hyperparameters in SI units. The table of timing shows the physics
    step in which an action takes effect, and the age of each observation. The table of poses needs the simulator. A run shows its
    scenario and the progress of its training. A robot file shows its links, joints and findings.

    \b
      deepbots inspect cartpole
      deepbots inspect cartpole --picture world.png
      deepbots inspect cartpole --set messages.timing=delayed
      deepbots inspect find_ball_random --stage few
      deepbots inspect runs/cartpole-0-1
      deepbots inspect package://pybullet_data/husky/husky.urdf --picture husky.png

    Next: `deepbots try SCENARIO` runs random actions.
    """
    if picture is not None:
        _check(picture, force=force)
    if is_robot(scenario):
        _inspect_robot(scenario, picture, chosen(engine), as_json)
        return
    side = open_source(scenario, overrides or (), permissions, engine)
    terminal.note_warnings(side.findings, scenario)
    program = side.program.variant(case, stage)
    root = side.root if isinstance(side.root, MappingNode) else MappingNode(Span(Source(scenario, ""), 0, 0), {})
    if case is not None:
        root = with_settings_at(root, ("evaluation", "cases", case))
    elif stage is not None:
        root = with_settings_at(root, ("curriculum", [known.name for known in side.program.curriculum].index(stage)))
    engine = engine or (side.run.engine_for(program) if side.run else None)
    tables = {**inspection.scenario_tables(program, root, side.run), **_start(program, picture, engine, permissions=permissions)}
    terminal.show(tables, *_lines(tables), as_json=as_json)
    if picture is not None:
        terminal.note(f"wrote a picture of the world to {picture}")


def _start(program: Program, picture: Path | None, engine: str | None, permissions: Permissions) -> inspection.Tables:
    """The poses of end links at the start of an episode, if the simulator is installed; renders the world if `picture` is given."""
    links = inspection.end_links(program)
    if picture is None and not links:
        return {}
    try:
        mode = "rgb_array" if picture else None
        with closing(api.make(program, engine=engine, render_mode=mode, permissions=permissions)) as environment:
            environment.reset(seed=0)
            if picture is not None:
                _draw(environment.render(), picture)
            rows = inspection.poses(environment, links)
            return {"poses": rows} if rows else {}
    except MissingExtraError:
        if picture is not None:
            raise
    except (EngineError, EvaluationError) as error:
        if picture is not None:
            raise
        terminal.note(f"the table of poses is missing because no episode can begin: {error}")
    return {}


def _inspect_robot(reference: str, picture: Path | None, engine: str, as_json: bool) -> None:
    robot, findings = open_robot(reference)
    tables = inspection.robot_tables(robot, findings)
    if picture is not None:
        _draw(_rendered(robot.model, engine), picture)
    terminal.show(tables, *_lines({name: rows for name, rows in tables.items() if name != "findings"}), as_json=as_json)
    if findings and not as_json and _is_of_package(reference):
        codes = ", ".join(f"{count} {code}" for code, count in Counter(finding.code for finding in findings).most_common())
        terminal.note(f"{summary(findings)} about a file of a package, which you cannot change ({codes}); --json lists them")
    elif findings and not as_json:
        terminal.show_findings(findings)
    if picture is not None:
        terminal.note(f"wrote a picture of the robot to {picture}")


def _is_of_package(reference: str) -> bool:
    """Whether a robot file comes with deepbots or an installed package."""
    is_named = reference.startswith("package://") or (shipped.robot_path(reference) is not None and not Path(reference).is_file())
    return is_named or not {"site-packages", "dist-packages"}.isdisjoint(Path(reference).resolve().parts)


def _rendered(model: RobotModel, engine: str) -> Image:
    """The robot on a floor, its joints at 0."""
    from deepbots_cli import engines
    from deepbots_cli.runtime.overview import view_around

    pose = Pose((0.0, 0.0, resting_height(model)))
    world = WorldModel(0.01, 1, robots=(RobotBody("robot", model, fixed_base=True, pose=pose),))
    low, high = robot_bounds(model)
    view = view_around([(add(low, pose.xyz), add(high, pose.xyz))])
    with closing(engines.create(engine, world)) as opened_engine:
        return opened_engine.render(view)


def _check(picture: Path, *, force: bool) -> None:
    """Raises: UsageError: The file cannot be a picture, or exists."""
    if picture.suffix.lower() != ".png":
        raise UsageError(f"{picture} is not the name of a PNG file; it must end in .png")
    check_output(picture, force=force)


def _draw(image: Image, picture: Path) -> None:
    """Write an image (uint8, height x width x 3) as PNG."""
    import PIL.Image  # of the extra that draws

    with atomic_write(picture) as draft:
        PIL.Image.fromarray(image).save(draft, format="PNG")


def _lines(tables: inspection.Tables) -> Iterator[str]:
    for name, rows in tables.items():
        yield f"{name}{f': {_CAPTIONS[name]}' if name in _CAPTIONS else ''}"
        yield (table(rows) if isinstance(rows, list) else row_as_lines(rows)) + "\n"

"""`deepbots inspect`: a scenario, a run or a robot file as the tables of `insight/inspection.py`, with
captions."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from deepbots_cli import api
from deepbots_cli.cli import terminal
from deepbots_cli.cli.arguments import OpenedSource, is_robot, open_robot, open_source, xacro_arguments
from deepbots_cli.cli.command import Case, EngineOrRun, Overrides, Stage, XacroArguments, option
from deepbots_cli.cli.tables import row_as_lines, table
from deepbots_cli.diagnostics import Source, Span
from deepbots_cli.diagnostics.render import summary
from deepbots_cli.document import MappingNode, Permissions, shipped
from deepbots_cli.document.load import with_settings_at
from deepbots_cli.errors import EngineError, EvaluationError, MissingExtraError
from deepbots_cli.insight import inspection
from deepbots_cli.program import Program
from deepbots_cli.program.identity import Deployment

if TYPE_CHECKING:
    from deepbots_robot.topics import Topic


def command(
    scenario: Annotated[
        str,
        typer.Argument(
            metavar="SCENARIO|RUN|ROBOT",
            help="A scenario file, a robot file (URDF), the name of a shipped scenario or robot, or a run"
            " directory.",
        ),
    ],
    overrides: Overrides = None,
    case: Case = None,
    stage: Stage = None,
    engine: EngineOrRun = None,
    full: Annotated[
        bool, option("--full", "Show all tables, also joints, sensors, timing, resets and hyperparameters.")
    ] = False,
    ros: Annotated[
        bool, option("--ros", "Print the section `ros`: a ROS 2 topic for each sensor and each command.")
    ] = False,
    xacro: XacroArguments = None,
    as_json: Annotated[bool, option("--json", "Print all tables as JSON.")] = False,
    permissions: Permissions = Permissions(),
) -> None:
    """Show the tables of a scenario, a run or a robot file."""
    if is_robot(scenario):
        _inspect_robot(scenario, permissions, xacro_arguments(xacro), as_json)
        return
    xacro_arguments(xacro, of_robot=False)
    side = open_source(scenario, overrides or (), permissions, engine)
    terminal.note_warnings(side.findings, scenario, permissions, overrides or ())
    program = side.program.variant(case, stage)
    if ros:
        topics = _topics(program)
        terminal.show(topics, _ros_text(topics), as_json=as_json)
        return
    root = root_of(side, scenario)
    if case is not None:
        root = with_settings_at(root, ("evaluation", "cases", case))
    elif stage is not None:
        root = with_settings_at(
            root, ("curriculum", [entry.name for entry in side.program.curriculum].index(stage))
        )
    tables = inspection.scenario_tables(program, root, side.run, side.learner)
    if full or as_json:
        tables = {
            **tables,
            **_poses(program, engine or (side.run.engine_for(program) if side.run else None), permissions),
        }
    selected_tables = {name: rows for name, rows in tables.items() if full or name in BRIEF_TABLES}
    terminal.show(
        tables,
        *_lines(selected_tables if as_json else inspection.in_written_units(selected_tables, program, root)),
        as_json=as_json,
    )
    if len(selected_tables) < len(tables) and not as_json:
        terminal.note(
            "--full also shows:"
            f" {', '.join(name.replace('_', ' ') for name in tables if name not in selected_tables)}"
        )


def _topics(program: Program) -> dict[str, Topic]:
    """Return the topic of each sensor, of each command, and of each reading of the world that the policy
    needs and no robot measures."""
    try:
        from deepbots_cli.program.topics import command_fields, mapping, sensor_fields
    except ModuleNotFoundError as error:
        raise MissingExtraError("robot", "--ros") from error
    needed = {
        *Deployment(program).unmeasured,
        *(field.name for field in (*sensor_fields(program), *command_fields(program))),
    }
    return {name: topic for name, topic in mapping(program).items() if name in needed}


def _ros_text(topics: Mapping[str, Topic]) -> str:
    """Return the section `ros` of a scenario."""
    parts = {name: "" if topic.part is None else f", part: {topic.part}" for name, topic in topics.items()}
    return "\n".join(
        [
            "ros:",
            *(
                f"  {name}: {{topic: {topic.name}, type: {topic.type}{parts[name]}}}"
                for name, topic in topics.items()
            ),
        ]
    )


def _poses(program: Program, engine: str | None, permissions: Permissions) -> inspection.Tables:
    """Return the poses of end links at the start of an episode, if the simulator is installed."""
    links = inspection.end_links(program)
    if not links:
        return {}
    try:
        with closing(api.make(program, engine=engine, permissions=permissions)) as environment:
            environment.reset(seed=0)
            rows = inspection.poses(environment, links)
            return {"poses": rows} if rows else {}
    except MissingExtraError:
        return {}
    except (EngineError, EvaluationError) as error:
        terminal.note(f"the table of poses is missing because no episode can begin: {error}")
        return {}


def _inspect_robot(
    reference: str, permissions: Permissions, arguments: Mapping[str, str], as_json: bool
) -> None:
    robot, findings = open_robot(reference, permissions.folders, arguments)
    tables = inspection.robot_tables(robot, findings)
    terminal.show(
        tables, *_lines({name: rows for name, rows in tables.items() if name != "findings"}), as_json=as_json
    )
    if findings and not as_json and _is_of_package(reference):
        codes = ", ".join(
            f"{count} {code}" for code, count in Counter(finding.code for finding in findings).most_common()
        )
        terminal.note(
            f"{summary(findings)} about a file of a package, which you cannot change ({codes}); --json lists"
            " them"
        )
    elif findings and not as_json:
        terminal.show_findings(findings, permissions)


def _is_of_package(reference: str) -> bool:
    """Return whether a robot file comes with deepbots or an installed package."""
    is_named = reference.startswith("package://") or (
        shipped.robot_path(reference) is not None and not Path(reference).is_file()
    )
    return is_named or not {"site-packages", "dist-packages"}.isdisjoint(Path(reference).resolve().parts)


def _lines(tables: inspection.Tables) -> Iterator[str]:
    for name, rows in tables.items():
        yield f"{name}{f': {CAPTIONS[name]}' if name in CAPTIONS else ''}"
        yield (table(rows) if isinstance(rows, list) else row_as_lines(rows)) + "\n"


CAPTIONS = {
    "observation": "low .. high is mapped to the range in `seen_as`; values outside are clipped",
    "critic": "what only the value function sees, in training",
    "mirror_images": "the value of a number in the mirror image is `sign` times the value of `mirror_image`",
    "poses": "end links of the robots at the start of the episode with seed 0, in the world frame",
    "drawn": "values that each reset draws",
    "hyperparameters": "`from` names the source of each value: the scenario, or the default of deepbots or"
    " of the library",
    "timing": "the physics step of each action and measurement, for step n = 0, 1, ... of the agent; the"
    " first physics step is 1",
}
BRIEF_TABLES = (
    "run",
    "scenario",
    "robots",
    "message_fields",
    "observation",
    "critic",
    "action",
    "mirror_images",
    "reward",
    "endings",
    "training",
)
"""The tables without `--full`."""


def root_of(side: OpenedSource, reference: str) -> MappingNode:
    """Return the mapping of a scenario, an empty one if it has none."""
    if isinstance(side.root, MappingNode):
        return side.root
    return MappingNode(Span(Source(reference, ""), 0, 0), {})

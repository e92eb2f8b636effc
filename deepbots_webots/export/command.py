"""`deepbots export --to webots`: the files of a project of Webots, and the gaps: what Webots lacks, and what
differs there."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from contextlib import closing
from dataclasses import field
from math import inf
from pathlib import Path, PurePosixPath
from typing import Any

import deepbots_cli
from deepbots_cli import api, engines
from deepbots_cli.cli import terminal
from deepbots_cli.cli.arguments import run_to_export
from deepbots_cli.cli.written_files import check_new_folder, refuse_links_within, write_new
from deepbots_cli.codegen import formatted
from deepbots_cli.codegen.names import class_name, docstring
from deepbots_cli.compiler.inputs import INPUTS_FOLDER
from deepbots_cli.document import Permissions
from deepbots_cli.errors import MissingExtraError, UsageError
from deepbots_cli.frames import Frame
from deepbots_cli.learning.runs.run import ModelRef
from deepbots_cli.program import Program
from deepbots_cli.program.robots import Motor, Robot
from deepbots_cli.records import dataclass
from deepbots_cli.robots.model import Joint
from deepbots_cli.rollout.source import Source, SourceKind
from deepbots_cli.runtime import Supervisor
from deepbots_cli.words import shell_word
from deepbots_webots.bridge import names
from deepbots_webots.bridge.project import (
    MODULE,
    SCENARIO,
    Project,
    ReaderLog,
    RemoteRobot,
    lines_of,
    project_of,
)
from deepbots_webots.bridge.robot import RobotDevices
from deepbots_webots.export.world import WorldWriter, joint_stops, world_text

OVERRIDES = ("messages.timing=delayed", "messages.format=csv")
"""The settings of a scenario in Webots: messages take a timestep, and those of deepbots are texts."""


def export(
    source: Path,
    out: Path | None,
    overrides: Sequence[str],
    permissions: Permissions,
    agent: str | None,
    last: bool,
    force: bool,
    as_json: bool,
) -> None:
    """Write a scenario, or a run with its policy, as a project of Webots; list first what differs there."""
    opened = Source.open(source, permissions, SourceKind.SCENARIO, SourceKind.RUN, SourceKind.CHECKPOINT)
    is_run = opened.kind is not SourceKind.SCENARIO
    if not is_run and (agent is not None or last):
        raise UsageError("--agent and --last name a policy of a run; leave them out for a scenario")
    if is_run and overrides:
        raise UsageError("a run is always exported as it was trained; leave out --set")
    folder = out or Path(f"{opened.path.resolve().name.removesuffix('.yaml')}-webots")
    check_new_folder(folder, force=force)
    refuse_links_within(folder)
    policy = None
    if is_run:
        ref = ModelRef.open(opened, model="last" if last else "best")
        run = run_to_export(ref.run, agent)
        prepared = prepare(Source.open(run.path, permissions, SourceKind.RUN))
        if run.program.timing != "delayed":
            prepared.gaps.differs.append(
                "The policy was trained with `timing: immediate`; train it with `timing: delayed` for the"
                " same returns."
            )
        policy = policy_of_run(run, ref.name)
    else:
        prepared = prepare(opened, overrides)
    if not as_json:
        for sentence in prepared.gaps.differs:
            terminal.note(f"differs in Webots: {sentence}")
    contents = project_files(prepared, policy)
    write_new(contents, folder, force=force)
    world = next(path for path in contents if path.suffix == ".wbt")
    terminal.show(
        {"folder": folder, "differs": prepared.gaps.differs, "files": [str(path) for path in contents]},
        f"{folder}: {len(contents)} files; open {world} in Webots",
        as_json=as_json,
        next_commands=[f"deepbots webots {shell_word(folder / world)} --allow-code"],
    )


@dataclass(frozen=True, eq=False)
class WebotsProject:
    """A scenario that fits Webots, and what differs there. `starts` are the poses of robots and objects at
    the start of an episode, by their names in the world."""

    compiled: api.Compiled
    project: Project
    remotes: dict[str, RemoteRobot]
    gaps: Gaps
    starts: dict[str, Frame]


def prepare(source: Source, overrides: Sequence[str] = ()) -> WebotsProject:
    """Compile a scenario, or that of a run, for Webots.

    Raises:
        ScenarioError: The scenario has errors.
        UsageError: The scenario cannot be exported; the message has a sentence for each reason.
        MissingExtraError: MuJoCo is not installed.
    """
    compiled = api.compile(source, overrides=[*overrides, *OVERRIDES])
    gaps = static_gaps(compiled.program)
    _require_none(compiled.program, gaps)
    project = project_of(compiled)
    recorder = EngineRecorder(engines.create("mujoco", project.world))
    with closing(recorder), closing(project.supervisor(recorder)) as task:
        _gaps_of_calls(recorder, task, gaps)
        _require_none(compiled.program, gaps)
        _gaps_of_episodes(recorder, task, gaps)
        task.reset(seed=0)
        bodies = [body.name for body in project.world.objects] + [*project.robots]
        starts = {name: recorder.pose(name)() for name in bodies}
    gaps.differs = list(dict.fromkeys(gaps.differs))  # those of each robot once
    remotes = {name: remote for name, remote, *_ in reversed([*lines_of(task)])}
    return WebotsProject(compiled, project, remotes, gaps, starts)


def _require_none(program: Program, gaps: Gaps) -> None:
    if gaps.missing:
        sentences = "\n".join(f"  {sentence}" for sentence in dict.fromkeys(gaps.missing))
        raise UsageError(f"{program.name} cannot be exported to Webots:\n{sentences}")


def project_files(prepared: WebotsProject, policy: bytes | None = None) -> dict[PurePosixPath, bytes]:
    """Return the files of the project.

    Args:
        policy: The policy as a graph of ONNX, for the supervisor.
    """
    compiled, project = prepared.compiled, prepared.project
    program = compiled.program
    world = re.sub(r"\W+|(?<=[a-z0-9])(?=[A-Z])", "_", program.name).lower()
    texts = _texts(prepared, world, policy)
    info = f"Written by deepbots {deepbots_cli.__version__} from scenario {compiled.digest[:12]}"
    writer = WorldWriter(project, prepared.remotes, prepared.starts, info)
    texts[f"worlds/{world}.wbt"] = world_text(writer.nodes())
    texts[f"scenario/{SCENARIO}"], texts[f"scenario/{MODULE}"] = compiled.resolved, formatted(compiled.code)
    files = {PurePosixPath(path): text.encode() for path, text in texts.items()}
    if policy is not None:
        files[PurePosixPath("controllers/supervisor/policy.onnx")] = policy
    for path, content in compiled.inputs.items():
        files[PurePosixPath("scenario", INPUTS_FOLDER, path)] = content
    return files


def _texts(prepared: WebotsProject, world: str, policy: bytes | None) -> dict[str, str]:
    """Return the texts of README, requirements and controllers."""
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    templates = Environment(
        loader=FileSystemLoader(Path(__file__).parent / "project"),
        undefined=StrictUndefined,
        keep_trailing_newline=True,
        trim_blocks=True,
        autoescape=False,  # the files are Python, Markdown and worlds, not HTML
    )
    project, program = prepared.project, prepared.compiled.program
    controllers = {names.controller_name(name): spec for name, spec in project.robots.items()}
    words = {
        "name": program.name,
        "summary": " ".join(program.summary.split()),
        "docstring": "\n    ".join(docstring(program.summary)),
        "class_name": class_name(program.name),
        "version": deepbots_cli.__version__,
        "digest": prepared.compiled.digest[:12],
        "world": world,
        "timestep": project.timestep_ms,
        "channels": {name: names.to_robot_channel(index) for index, name in enumerate(project.robots)},
        "is_batch": program.agent.copies is not None,
        "has_policy": policy is not None,
        "controllers": list(controllers),
        "differs": prepared.gaps.differs,
    }
    paths = {
        "README.md": "README.md.j2",
        "requirements.txt": "requirements.txt.j2",
        "controllers/supervisor/webots_environment.py": "webots_environment.py.j2",
        "controllers/supervisor/supervisor.py": "supervisor.py.j2",
    }
    texts = {path: templates.get_template(name).render(words) for path, name in paths.items()}
    for name, robot in controllers.items():
        robot_words = {**words, "class_name": class_name(name), "robot": robot}
        texts[f"controllers/{name}/{name}.py"] = templates.get_template("robot.py.j2").render(robot_words)
    return texts


def policy_of_run(run: Any, model: Any) -> bytes:
    """Return the policy of a run as a graph of ONNX from observations to actions.

    Raises:
        MissingExtraError: onnx is not installed.
        UsageError: The policy is recurrent, or cannot be exported.
    """
    try:
        from deepbots_cli.insight.export.network import policy_graph
        from deepbots_cli.learning import policy
    except ModuleNotFoundError as error:
        if (error.name or "").startswith("deepbots"):
            raise
        raise MissingExtraError("export", "exporting a policy") from error
    learner = policy.loaded(run, model)
    if learner.network().memory is not None:
        raise UsageError(
            "the policy of this run is recurrent; the export to Webots has policies without memory only"
        )
    return policy_graph(learner, run.program)


# Gaps


SEEDS = range(3)
"""The seeds of the episodes that deepbots begins to see what varies between them."""
_MISSING = {
    "contact": "Touch sensors of robots",
    "contact_force": "Contact forces",
    "contact_force_vector": "Contact forces",
    "joint_torques": "Torques of motors that the supervisor reads",
    "joint_wrench": "Forces and torques in joints",
    "camera": "Cameras",
    "pusher": "Disturbances and thrust",
    "before_substep": "Delays, and other actuators that act in each physics step,",
    "inverse_kinematics": "Cartesian actuators",
    "clearance": "Clearances that a robot measures",
    "angular_momentum": "Angular momentum that a robot measures",
}
"""What the methods of an engine are for, as the subject of a sentence."""
_OF_SUPERVISOR = frozenset(
    ["contact_force", "contact_force_vector", "joint_torques", "joint_wrench", "camera", "pusher"]
)


@dataclass
class Gaps:
    """What cannot be exported, and what differs in Webots."""

    missing: list[str] = field(default_factory=list)
    """The reasons for which a scenario is refused."""
    differs: list[str] = field(default_factory=list)


class EngineRecorder(ReaderLog):
    """An engine that records the calls of a scenario, and what it changes."""

    def __init__(self, engine: Any) -> None:
        super().__init__(engine)
        self.parameters: set[str] = set()
        self.has_joint_velocities = False

    def set_joint(self, robot: str, joint: str, position: float, velocity: float) -> None:
        self.has_joint_velocities |= velocity != 0.0
        self.engine.set_joint(robot, joint, position, velocity)

    def set_parameter(self, parameter: Any, owner: tuple[str, ...], *values: float) -> None:
        self.parameters.add(parameter)
        self.engine.set_parameter(parameter, owner, *values)


def static_gaps(program: Program) -> Gaps:
    """Return what the program alone shows."""
    gaps = Gaps()
    milliseconds = program.world.timestep * 1000
    for is_there, sentence in (
        (
            program.members or program.others is not None,
            "Several agents with policies of their own cannot be exported.",
        ),
        (program.links, "Messages between robots cannot be exported."),
        (
            program.python_functions,
            "Reward terms and endings that are Python functions cannot be exported.",
        ),
        (
            abs(milliseconds - round(milliseconds)) > 1e-9,
            f"A timestep of {milliseconds:g} ms is not a whole number of ms, which Webots steps by.",
        ),
        (any(program.world.gravity[:2]), "Gravity that is not vertical cannot be exported."),
    ):
        if is_there:
            gaps.missing.append(sentence)
    bodies = [
        *(robot.name for robot in program.world.robots),
        *(body.name for body in program.world.objects),
    ]
    taken = Counter([*map(names.def_name, bodies), *names.OWN_NODES])
    for body_name in bodies:
        if taken[names.def_name(body_name)] > 1:
            gaps.missing.append(
                f"Another part of the project in Webots has the name of {body_name}: rename it."
            )
    for body in program.world.objects:
        if body.pooled or body.variants:
            gaps.missing.append(
                f"The object {body.name}, which some episodes leave out or change, cannot be exported."
            )
    if program.world.lines:
        gaps.differs.append(
            "Lines on the ground are not drawn; sensors of brightness read them all the same."
        )
    for robot in program.robots:
        _gaps_of_robot(program, robot, gaps)
    gaps.differs.append(
        "Messages take one timestep in each direction (`timing: delayed`), and are comma-separated values."
    )
    gaps.differs.append("The physics, and with it the returns, are those of Webots.")
    return gaps


def _gaps_of_robot(program: Program, robot: Robot, gaps: Gaps) -> None:
    for actuator in robot.actuators:
        if isinstance(actuator, Motor) and (
            actuator.stiffness is not None or actuator.no_load_speed is not None
        ):
            gaps.missing.append(
                f"The motor {actuator.name} of {robot.name} cannot be exported: motors of Webots have no"
                " stiffness, and no torque that falls with their speed."
            )
    if not (robot.to_route.perfect and robot.from_route.perfect):
        gaps.differs.append("Latency, loss and range of messages are left out.")
    model = next(body.model for body in program.world.robots if body.name == robot.name)
    for joint in model.joints:
        _gaps_of_joint(f"the joint {joint.name} of {robot.name}", joint, gaps)


def _gaps_of_joint(name: str, joint: Joint, gaps: Gaps) -> None:
    if joint.type in ("floating", "planar"):
        gaps.missing.append(f"Webots has no {joint.type} joints, such as {name}.")
    elif joint.moves:
        low, high = joint.ends(inf)
        if joint.mimic is not None:
            gaps.missing.append(f"Webots has no joints that follow another one, such as {name}.")
        if not low <= 0.0 <= high:
            gaps.missing.append(f"The limits of {name} do not contain 0, as those of Webots must.")
        elif min(-low, high) < inf and joint_stops(joint) is None:
            gaps.differs.append(f"The limits of {name} are beyond 180 degrees, and are left out.")
    if joint.armature:
        gaps.differs.append(f"The armature of {name} is left out.")


def _gaps_of_calls(recorder: EngineRecorder, task: Supervisor, gaps: Gaps) -> None:
    """Add what the generated code asks of its engine when it is bound."""
    for _, remote, *_ in lines_of(task):
        for method, _, options in remote.log.calls:
            if not hasattr(RobotDevices, method):
                gaps.missing.append(f"{_MISSING[method]} cannot be exported.")
            if options.get("upright"):
                gaps.missing.append("Rays that stay level when the robot tilts cannot be exported.")
    methods = {method for method, *_ in recorder.calls}
    for method in sorted(methods & _OF_SUPERVISOR):
        gaps.missing.append(f"{_MISSING[method]} cannot be exported.")
    if "contact" in methods:
        gaps.differs.append("A contact counts if it lasts until the end of a timestep.")


def _gaps_of_episodes(recorder: EngineRecorder, task: Supervisor, gaps: Gaps) -> None:
    """Add what differs between a few episodes."""
    for seed in SEEDS:
        task.reset(seed=seed)
    if any(getattr(agent, "has_varied_sensors", False) for agent in task.agents.values()):
        gaps.differs.append("Faults of sensors that an episode draws have their nominal values.")
    if varied := sorted(recorder.parameters - {"gravity"}):
        parameters = ", ".join(name.replace("_", " ") for name in varied)
        gaps.differs.append(f"Changes of {parameters} between episodes are left out.")
    if recorder.has_joint_velocities:
        gaps.differs.append("Joints are at rest at the start of an episode.")

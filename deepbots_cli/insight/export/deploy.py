"""The settings of a runner of Isaac Lab, which follow from a scenario alone: the content of
`params/deploy.yaml`.

The file has the keys of unitree_rl_lab (`joint_ids_map`, `step_dt`, `stiffness`, `damping`,
`default_joint_pos`, `commands`, `actions`, `observations`), with all digits of each number. A runner computes
`scale * clip(value)` of each observation, and `clip(scale * action + offset)` of the action; other scenarios
cannot be written so. Neither torch nor onnx is imported here, so a scenario that does not fit is refused at
once.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import chain, count
from pathlib import PurePosixPath
from typing import TYPE_CHECKING, Any

import numpy as np

from deepbots_cli import frames
from deepbots_cli.analysis import Analysis
from deepbots_cli.compiler.robots import rigid_root
from deepbots_cli.errors import UsageError
from deepbots_cli.expressions import intervals as iv
from deepbots_cli.expressions.scalar import Const, Name, Op, Scalar
from deepbots_cli.insight.export.devices import linear, output
from deepbots_cli.program import Program
from deepbots_cli.program.robots import Command, Motor, Robot, Sensor
from deepbots_cli.program.task import Observation
from deepbots_cli.robots.model import RobotModel
from deepbots_cli.scenario.training import ALGORITHMS

if TYPE_CHECKING:
    from deepbots_cli.learning.learner import Learner


_TERMS = {
    "gyro": "base_ang_vel",
    "projected_gravity": "projected_gravity",
    "joint_position": "joint_pos",
    "joint_velocity": "joint_vel_rel",
}
"""The names that runners have for the value of a sensor."""
_OF_BASE = ("gyro", "projected_gravity")
"""The kinds of sensors that have such a name at the root link only."""
_ROUNDING = 1e-9

DEPLOY_NAME, GRAPH_NAME = PurePosixPath("params/deploy.yaml"), PurePosixPath("exported/policy.onnx")


def deploy_settings(program: Program) -> dict[str, Any]:
    """Return the content of `deploy.yaml`. Joints are in the order of the action; gains are in the order of
    the robot file.

    Raises:
        UsageError: A runner cannot compute the observation or the commands of the scenario, or keep the
            memory of its policy.
    """
    _require_plain_policy(program)
    robot, command = _only_command(program)
    motor = command.actuator
    if (
        not isinstance(motor, Motor)
        or motor.kind != "position_motor"
        or motor.stiffness is None
        or motor.damping is None
        or any(rate is not None for rate in motor.max_velocity)
    ):
        raise UsageError(
            "the runners of Isaac Lab drive position motors with stiffness and damping and without"
            f" `max_velocity`, and '{command.name}' is none; export a bundle instead"
        )
    coefficients = linear(program, command.scalars)
    if coefficients is None or not np.array_equal(coefficients[0], np.diag(np.diag(coefficients[0]))):
        raise UsageError(
            f"`apply.{command.name}` is not a scale and an offset for each number of the action; export a"
            " bundle instead"
        )
    scale, offset = np.diag(coefficients[0]).tolist(), coefficients[1].tolist()
    model = next(body.model for body in program.world.robots if body.name == robot.name)
    in_file = [joint.name for joint in model.joints if joint.name in motor.joints]
    ends = output(program, robot, command).range
    commands: dict[str, Any] = {}
    observations: dict[str, Any] = {}
    parameters = {value.name: value for value in program.parameters}
    analysis = Analysis(program)
    for entry in program.agent.observation:
        term = _term(entry)
        if entry.name in parameters:
            term["params"] = {"command_name": entry.name}
            commands[entry.name] = {"ranges": _command_ranges(entry, analysis)}
        plain_name = entry.name.replace(".", "_")
        numbered = (f"{plain_name}_{number}" for number in count(2))
        names = chain((_term_name(entry, robot, motor, model, offset) or plain_name, plain_name), numbered)
        observations[next(name for name in names if name not in observations)] = term
    return {
        "joint_names": [*motor.joints],
        "joint_ids_map": [in_file.index(joint) for joint in motor.joints],
        "step_dt": program.period,
        "stiffness": [motor.stiffness] * len(in_file),
        "damping": [motor.damping] * len(in_file),
        "default_joint_pos": offset,
        "commands": commands,
        "actions": {
            "JointPositionAction": {
                "clip": [[low, high] for low, high in zip(*ends, strict=True)]
                if None not in (*ends[0], *ends[1])
                else None,
                "joint_names": [*motor.joints],
                "scale": scale,
                "offset": offset,
                "joint_ids": None,
            }
        },
        "observations": observations,
    }


def _require_plain_policy(program: Program) -> None:
    """Check that a runner can compute the observation of the policy.

    Raises:
        UsageError: A runner cannot compute the observation of the policy, or keep its memory.
    """
    agent = program.agent
    algorithm = ALGORITHMS.get(agent.training.algorithm) if agent.training is not None else None
    if algorithm is not None and algorithm.is_recurrent:
        raise UsageError(
            "a recurrent policy does not fit the runners of Isaac Lab, which pass on no memory; export a"
            " bundle instead"
        )
    if (
        agent.choices
        or agent.goal is not None
        or agent.images
        or agent.frame_stack > 1
        or agent.copies is not None
    ):
        raise UsageError(
            "the runners of Isaac Lab take a vector of numbers and return targets of joints: choices, goals,"
            " images, copies and"
            " `agent.frame_stack` do not fit (use `history` of an observation); export a bundle instead"
        )


def _only_command(program: Program) -> tuple[Robot, Command]:
    robots = [robot for robot in program.robots if robot.name in program.agent.robots]
    commands = [(robot, command) for robot in robots for command in robot.commands]
    if len(commands) != 1:
        names = ", ".join(f"{robot.name}.{command.name}" for robot, command in commands)
        raise UsageError(
            f"the runners of Isaac Lab drive one group of joints, and the scenario commands {names}; export"
            " a bundle instead"
        )
    return commands[0]


def _command_ranges(entry: Observation, analysis: Analysis) -> dict[str, list[float]]:
    """Return the range of the values that the policy has seen, for each component of a parameter."""
    return {
        f"{entry.name}_{number.component}" if number.component else entry.name: [
            *(
                iv.clamp(analysis.ranges.of(number.scalar), iv.single(number.low), iv.single(number.high))
                if entry.clip
                else analysis.ranges.of(number.scalar)
            )
        ]
        for number in entry.numbers
    }


def _term(entry: Observation) -> dict[str, Any]:
    """Return the settings of the term of an entry of the observation."""
    size = len(entry.numbers)
    term: dict[str, Any] = {
        "params": {},
        "clip": None,
        "scale": [1.0] * size,
        "history_length": entry.history,
    }
    if not entry.numbers[0].is_truth and entry.name != "previous_action":
        ends = {*zip(entry.low, entry.high, strict=True)}
        if len(ends) > 1 or any(abs(low + high) > _ROUNDING * (high - low) for low, high in ends):
            raise UsageError(
                f"the range of the observation '{entry.name}' must be the same for all components and"
                " symmetric about 0, as"
                " the runners of Isaac Lab only multiply; export a bundle instead"
            )
        ((low, high),) = ends
        term |= {"scale": [1.0 / high] * size, "clip": [low, high] if entry.clip else None}
    return term


def _term_name(
    entry: Observation, robot: Robot, motor: Motor, model: RobotModel, offset: Sequence[float]
) -> str | None:
    """Return the name that runners have for an entry of the observation; None if they have none."""
    if entry.name == "previous_action":
        return "last_action"
    sent = next((value.scalars for value in robot.emitted if f"{robot.name}.{value.name}" == entry.name), ())
    sensors = {sensor.name: sensor for sensor in robot.sensors}
    pairs = [_sensed(tree) for tree in sent]
    sensors_read = {
        sensors[leaf.name].name: sensors[leaf.name]
        for leaf, _ in pairs
        if leaf is not None and leaf.name in sensors
    }
    if len(sensors_read) != 1 or any(leaf is None for leaf, _ in pairs):
        return None
    (sensor,) = sensors_read.values()
    shifts = [shift for _, shift in pairs]
    if [leaf.component for leaf, _ in pairs if leaf is not None] != [*(sensor.components or (None,))]:
        return None
    if sensor.kind == "joint_position" and any(shifts):
        is_of_pose = np.allclose(shifts, offset, rtol=0.0, atol=_ROUNDING)
        return "joint_pos_rel" if is_of_pose and sensor.subjects == motor.joints else None
    is_of_runner = _is_of_base(sensor, model) if sensor.kind in _OF_BASE else sensor.subjects == motor.joints
    return _TERMS.get(sensor.kind) if is_of_runner and not any(shifts) else None


def _is_of_base(sensor: Sensor, model: RobotModel) -> bool:
    """Return whether a sensor turns with the root link and has its axes."""
    link, frame = rigid_root(model, sensor.subjects[0])
    _, (x, y, z, _) = frames.compose(frame, frames.frame(sensor.mount))
    return link == model.root and max(abs(x), abs(y), abs(z)) <= _ROUNDING


def _sensed(tree: Scalar) -> tuple[Name | None, float]:
    """Return a component of a sensor, and the number that is subtracted from it."""
    match tree:
        case Name():
            return tree, 0.0
        case Op("sub", (Name() as leaf, Const(value))):
            return leaf, float(value)
    return None, 0.0


def isaac_files(program: Program, learner: Learner) -> dict[PurePosixPath, bytes]:
    """Return `params/deploy.yaml` and `exported/policy.onnx`.

    Raises:
        UsageError: The scenario is refused by `deploy_settings`.
    """
    import yaml

    from deepbots_cli.insight.export.network import Graph, check_network, decide

    text = yaml.safe_dump(
        deploy_settings(program), default_flow_style=None, sort_keys=False, allow_unicode=True
    )
    check_network(learner, program)
    graph = Graph()
    observation = graph.input("obs", np.float32, 1, len(program.agent.inputs))
    decision = decide(graph, learner.network(), program, {"observation": observation})
    graph.output("actions", decision.action, np.float32, 1, len(program.agent.range_names))
    return {DEPLOY_NAME: text.encode(), GRAPH_NAME: graph.model(program.name)}

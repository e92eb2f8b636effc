"""The properties of a scenario that Webots does not support, and those that differ: a sentence each."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from math import inf
from typing import TYPE_CHECKING, Any

from deepbots_cli.port import EngineProxy
from deepbots_cli.program.robots import Motor
from deepbots_cli.webots.bridge import names
from deepbots_cli.webots.bridge.task import RemoteRobot
from deepbots_cli.webots.export.world import joint_stops

if TYPE_CHECKING:
    from deepbots_cli.program import Program
    from deepbots_cli.program.robots import Robot
    from deepbots_cli.robots.model import Joint
    from deepbots_cli.runtime import Supervisor

SEEDS = range(3)
"""The seeds of the episodes that deepbots begins to see what varies between them."""
_OF_ROBOTS = frozenset(
    (
        *("joint_states", "joint_torques", "pose", "velocity", "motion", "rays"),
        *("velocity_motor", "position_motor", "torque_motor"),
    )
)
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
_LOOKS = frozenset(["light", "color"])


@dataclass
class Gaps:
    """What cannot be exported, and what differs in Webots."""

    missing: list[str] = field(default_factory=list)
    """The reasons for which a scenario is refused."""
    differs: list[str] = field(default_factory=list)

    def miss(self, sentence: str) -> None:
        if sentence not in self.missing:
            self.missing.append(sentence)

    def differ(self, sentence: str) -> None:
        if sentence not in self.differs:
            self.differs.append(sentence)


class EngineRecorder(EngineProxy):
    """An engine that records the calls of a scenario."""

    def __init__(self, engine: Any) -> None:
        super().__init__(engine)
        self.methods: set[str] = set()
        self.parameters: set[str] = set()
        self.has_joint_velocities = False

    def _pass(self, method: str, parts: int, *args: Any, **kwargs: Any) -> Any:
        self.methods.add(method)
        return super()._pass(method, parts, *args, **kwargs)

    def set_joint(self, robot: str, joint: str, position: float, velocity: float) -> None:
        self.has_joint_velocities |= velocity != 0.0
        self.engine.set_joint(robot, joint, position, velocity)

    def set_parameter(self, parameter: Any, owner: tuple[str, ...], *values: float) -> None:
        self.parameters.add(parameter)
        self.engine.set_parameter(parameter, owner, *values)


def static_gaps(program: Program) -> Gaps:
    """Return what the program alone shows."""
    gaps = Gaps()
    if program.members or program.others is not None:
        gaps.miss("Several agents with policies of their own cannot be exported.")
    if program.links:
        gaps.miss("Messages between robots cannot be exported.")
    if program.python_functions:
        gaps.miss("Reward terms and endings that are Python functions cannot be exported.")
    milliseconds = program.world.timestep * 1000
    if abs(milliseconds - round(milliseconds)) > 1e-9:
        gaps.miss(f"A timestep of {milliseconds:g} ms is not a whole number of ms, which Webots steps by.")
    if any(program.world.gravity[:2]):
        gaps.miss("Gravity that is not vertical cannot be exported.")
    robots = [robot.name for robot in program.world.robots]
    bodies = [*robots, *(body.name for body in program.world.objects)]
    taken = Counter([*map(names.def_name, bodies), *names.OWN_NODES])
    for body_name in bodies:
        name = names.def_name(body_name)
        if taken[name] > 1 or (name == names.TRAINING and body_name in robots):
            gaps.miss(f"Another part of the project in Webots has the name of {body_name}: rename it.")
    for body in program.world.objects:
        if body.pooled or body.variants:
            gaps.miss(f"The object {body.name}, which some episodes leave out or change, cannot be exported.")
    if program.world.lines:
        gaps.differ("Lines on the ground are not drawn; sensors of brightness read them all the same.")
    for robot in program.robots:
        _gaps_of_robot(program, robot, gaps)
    gaps.differ(
        "Messages take one timestep in each direction (`timing: delayed`), and are comma-separated values."
    )
    gaps.differ("The physics, and with it the returns, are those of Webots.")
    return gaps


def _gaps_of_robot(program: Program, robot: Robot, gaps: Gaps) -> None:
    for sensor in robot.sensors:
        if sensor.optics is not None:
            gaps.miss(f"The camera {sensor.name} of {robot.name} cannot be exported.")
    for actuator in robot.actuators:
        if not isinstance(actuator, Motor):
            gaps.miss(
                f"The actuator {actuator.name} of {robot.name} cannot be exported: it is not a motor of a"
                " joint."
            )
        elif actuator.stiffness is not None or actuator.no_load_speed is not None:
            gaps.miss(
                f"The motor {actuator.name} of {robot.name} cannot be exported: motors of Webots have no"
                " stiffness, and no torque that falls with their speed."
            )
    if not (robot.to_route.perfect and robot.from_route.perfect):
        gaps.differ("Latency, loss and range of messages are left out.")
    for joint in _model(program, robot.name).joints:
        for sentence, is_missing in _gaps_of_joint(robot.name, joint):
            (gaps.miss if is_missing else gaps.differ)(sentence)


def _model(program: Program, robot: str) -> Any:
    return next(body.model for body in program.world.robots if body.name == robot)


def _gaps_of_joint(robot: str, joint: Joint) -> Iterator[tuple[str, bool]]:
    """Yield sentences, and whether they refuse the scenario."""
    name = f"the joint {joint.name} of {robot}"
    if joint.type in ("floating", "planar"):
        yield f"Webots has no {joint.type} joints, such as {name}.", True
        return
    if joint.mimic is not None and joint.moves:
        yield f"Webots has no joints that follow another one, such as {name}.", True
    low, high = joint.ends(inf)
    if joint.moves and not low <= 0.0 <= high:
        yield f"The limits of {name} do not contain 0, as those of Webots must.", True
    elif joint.moves and min(-low, high) < inf and joint_stops(joint) is None:
        yield f"The limits of {name} are beyond 180 degrees, and are left out.", False
    if joint.armature:
        yield f"The armature of {name} is left out.", False


def dynamic_gaps(recorder: EngineRecorder, task: Supervisor, gaps: Gaps) -> None:
    """Add what the generated code asks of its engine: when it is bound, and in a few episodes."""
    for agent in task.agents.values():
        for remote in agent.controllers.values():
            if isinstance(remote, RemoteRobot):
                _gaps_of_calls(remote, gaps)
    for method in sorted(recorder.methods & _OF_SUPERVISOR):
        gaps.miss(f"{_MISSING[method]} cannot be exported.")
    if "contact" in recorder.methods:
        gaps.differ("A contact counts if it lasts until the end of a timestep.")
    for seed in SEEDS:
        task.reset(seed=seed)
    if any(getattr(agent, "has_varied_sensors", False) for agent in task.agents.values()):
        gaps.differ("Faults of sensors that an episode draws have their nominal values.")
    varied = sorted(recorder.parameters - _LOOKS - {"gravity"})
    if varied:
        parameters = ", ".join(name.replace("_", " ") for name in varied)
        gaps.differ(f"Changes of {parameters} between episodes are left out.")
    if recorder.parameters & _LOOKS:
        gaps.differ("Colors and light that episodes vary have their usual values.")
    if recorder.has_joint_velocities:
        gaps.differ("Joints are at rest at the start of an episode.")


def _gaps_of_calls(remote: RemoteRobot, gaps: Gaps) -> None:
    for method, _, options in remote.log.calls:
        if method not in _OF_ROBOTS:
            gaps.miss(f"{_MISSING[method]} cannot be exported.")
        if options.get("upright"):
            gaps.miss("Rays that stay level when the robot tilts cannot be exported.")

"""The requirements of a policy on a real robot: the readings of the world that no robot measures, and their
names.

A reading is called as the scenario would write it, with a robot for its root link: `position(cart)`.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from functools import cached_property

from deepbots_cli.expressions.scalar import EngineRead, Name, Scalar, names_in
from deepbots_cli.program import Program
from deepbots_cli.program.identity import Definitions, Node
from deepbots_cli.program.robots import Robot, Sensor

_OF_CHANNEL = frozenset({"age", "message_received"})


def reading_key(text: str) -> str:
    """Return the name of a reading without the spaces that a person may write."""
    return re.sub(r"\s+", "", text).replace(",", ", ")


class Deployment:
    """The readings of the world behind the observation, the masks and the commands of a policy."""

    def __init__(self, program: Program) -> None:
        self._program = program
        self.definitions = Definitions(program)
        self._roots = {f"{body.name}.{body.model.root}": body.name for body in program.world.robots}
        self.joints = {
            f"{body.name}.{joint.name}": joint for body in program.world.robots for joint in body.model.joints
        }

    @cached_property
    def sensed(self) -> Mapping[EngineRead, tuple[Robot, Sensor, int]]:
        """The readings that are a component of a sensor without faults: robot, sensor and the index of the
        component."""
        sensors: dict[EngineRead, tuple[Robot, Sensor, int]] = {}
        for robot in self._program.robots:
            if self._program.is_direct(robot, "from_robot"):
                for sensor in robot.sensors:
                    for index, component in enumerate(sensor.components or (None,)):
                        if sensor.is_direct:
                            sensors.setdefault(
                                sensor.world_value(robot.name, component), (robot, sensor, index)
                            )
        return sensors

    def subjects(self, reading: EngineRead) -> tuple[str, ...]:
        """Return the parts of the world that a reading is about; a robot for its root link."""
        return tuple(self._roots.get(subject, subject) for subject in reading.subjects)

    def name(self, reading: EngineRead) -> str:
        """Return the name of a reading, without its component."""
        return f"{reading.function}({', '.join(self.subjects(reading))})"

    def is_measured(self, reading: EngineRead) -> bool:
        """Return whether the robot measures it: the age of its messages, or a joint of which it has a sensor
        of this kind."""
        if reading.function in _OF_CHANNEL or reading in self.sensed:
            return True
        joint = self.joints.get(reading.subjects[0])
        robot = next(
            (robot for robot in self._program.robots if robot.name == reading.subjects[0].partition(".")[0]),
            None,
        )
        sensors = robot.sensors if robot is not None and joint is not None else ()
        return any(
            sensor.kind == reading.function and joint is not None and joint.name in sensor.subjects
            for sensor in sensors
        )

    @cached_property
    def unmeasured(self) -> tuple[str, ...]:
        """The readings that a tracker or an estimator must supply, in order of first use."""
        reads = (node for _, node in self.nodes if isinstance(node, EngineRead))
        return tuple(dict.fromkeys(self.name(reading) for reading in reads if not self.is_measured(reading)))

    @cached_property
    def goals(self) -> tuple[str, ...]:
        """The parameters that somebody must set."""
        names = (node.name for _, node in self.nodes if isinstance(node, Name))
        return tuple(dict.fromkeys(name for name in names if name in self.definitions.parameters))

    @cached_property
    def nodes(self) -> tuple[Node, ...]:
        """The nodes from which the policy and the commands of its robots are computed, through all
        definitions."""
        return tuple(self.definitions.nodes(self._needed()))

    def _needed(self) -> Iterator[Scalar]:
        agent = self._program.agent
        for entry in agent.observation:
            yield from entry.value.scalars
        if agent.goal is not None:
            yield from (*agent.goal.achieved.scalars, *agent.goal.targets)
        for part in agent.choices:
            yield from (option.forbidden.scalar for option in part.options if option.forbidden is not None)
        for robot in self._program.robots:
            if robot.name in agent.robots:
                sent = {entry.name: entry for entry in robot.receive}
                names = [
                    leaf.name
                    for command in robot.commands
                    for tree in command.scalars
                    for leaf in names_in(tree)
                ]
                for value in dict.fromkeys(sent[name] for name in names if name in sent):
                    yield from value.scalars

"""Which engine readers a piece of code needs, and how it gets at each number.

Every `World` leaf becomes an index into what one bound reader returned; a reader is called once per
tick, however many numbers are taken from it.
"""

from __future__ import annotations

from collections.abc import Iterable

from deepbots_cli.compiler.emit.names import Names
from deepbots_cli.compiler.emit.text import quoted, quoted_tuple
from deepbots_cli.lang.scalar import Draw, Op, Scalar, State, World

_XYZ = {"x": 0, "y": 1, "z": 2, "w": 3}
_POSE_PART = {"position": 0, "orientation": 1}
_VELOCITY_PART = {"velocity": 0, "angular_velocity": 1}
_JOINT_PART = {"joint_position": 0, "joint_velocity": 1}


class Reads:
    """The readers that all expressions of one class need; one reader covers all joints of a robot.

    Each part of the class calls those that its own expressions need.
    """

    def __init__(self, expressions: Iterable[Scalar], names: Names) -> None:
        self._names = names
        self._joints: dict[str, list[str]] = {}
        self._torques: dict[str, list[str]] = {}
        self._poses: dict[str, None] = {}
        self._velocities: dict[str, None] = {}
        for leaf in (leaf for expression in expressions for leaf in world_leaves(expression)):
            self._note(leaf)

    def _note(self, leaf: World) -> None:
        subject = leaf.subjects[0]
        if leaf.function in _POSE_PART:
            self._poses[subject] = None
        elif leaf.function in _VELOCITY_PART:
            self._velocities[subject] = None
        else:
            robot, joint = subject.split(".", 1)
            table = self._torques if leaf.function == "joint_torque" else self._joints
            joints = table.setdefault(robot, [])
            if joint not in joints:
                joints.append(joint)

    def bind_lines(self) -> list[str]:
        """Statements that take the readers from `engine`."""
        lines = [
            f"self.read_{self._local(robot, 'joints')} = engine.joint_states({quoted(robot)}, {quoted_tuple(joints)})"
            for robot, joints in self._joints.items()
        ]
        lines += [
            f"self.read_{self._local(robot, 'torques')} = engine.joint_torques({quoted(robot)}, {quoted_tuple(joints)})"
            for robot, joints in self._torques.items()
        ]
        lines += [f"self.read_{self._local(subject, 'pose')} = engine.pose({_body_and_link(subject)})" for subject in self._poses]
        lines += [
            f"self.read_{self._local(subject, 'velocity')} = engine.velocity({_body_and_link(subject)})" for subject in self._velocities
        ]
        return lines

    def call_lines(self, expressions: Iterable[Scalar]) -> list[str]:
        """Statements that read once what these expressions need."""
        needed = {_reader(leaf) for expression in expressions for leaf in world_leaves(expression)}
        tables = (("joints", self._joints), ("torques", self._torques), ("pose", self._poses), ("velocity", self._velocities))
        locals_ = [self._local(subject, what) for what, table in tables for subject in table if (subject, what) in needed]
        return [f"{name} = self.read_{name}()" for name in locals_]

    def code(self, leaf: World) -> str:
        """The code of one number, after its reader was called."""
        subject = leaf.subjects[0]
        if leaf.function in _POSE_PART:
            return f"{self._local(subject, 'pose')}[{_POSE_PART[leaf.function]}][{_XYZ[leaf.component or 'x']}]"
        if leaf.function in _VELOCITY_PART:
            return f"{self._local(subject, 'velocity')}[{_VELOCITY_PART[leaf.function]}][{_XYZ[leaf.component or 'x']}]"
        robot, joint = subject.split(".", 1)
        if leaf.function == "joint_torque":
            return f"{self._local(robot, 'torques')}[{self._torques[robot].index(joint)}]"
        return f"{self._local(robot, 'joints')}[{self._joints[robot].index(joint)}][{_JOINT_PART[leaf.function]}]"

    def _local(self, subject: str, what: str) -> str:
        return self._names(f"{subject} {what}")  # the blank keeps it apart from every name of the scenario


def _reader(leaf: World) -> tuple[str, str]:
    """Whose reader gives this number, and which of its readers."""
    subject = leaf.subjects[0]
    if leaf.function in _POSE_PART:
        return subject, "pose"
    if leaf.function in _VELOCITY_PART:
        return subject, "velocity"
    return subject.split(".", 1)[0], "torques" if leaf.function == "joint_torque" else "joints"


def world_leaves(expression: Scalar) -> Iterable[World]:
    match expression:
        case World():
            yield expression
        case Op(_, args) | State(_, args, _) | Draw(_, args, _):
            for argument in args:
                yield from world_leaves(argument)


def _body_and_link(subject: str) -> str:
    body, _, link = subject.partition(".")
    return f"{quoted(body)}, {quoted(link)}" if link else quoted(body)

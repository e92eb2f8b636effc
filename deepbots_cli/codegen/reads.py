"""Which engine readers a piece of code needs, and how it gets at each number.

Every `World` leaf becomes an index into what one bound reader returned; a reader is called once per
tick, however many numbers are taken from it.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator

from deepbots_cli.codegen.names import Names
from deepbots_cli.codegen.text import quoted, quoted_tuple
from deepbots_cli.expressions.scalar import Scalar, World, walk

_FOLLOWED = ("beside", "along")
"""What is told of a body and a line; a follower computes it from the body's pose."""
_AND = "\0"
"""Between two parts of the world that one reader is about: no name holds it, and those of the pieces of walls hold blanks."""
_XYZ = {"x": 0, "y": 1, "z": 2, "w": 3}
_METHODS = {"joints": "joint_states", "torques": "joint_torques", "pose": "pose", "velocity": "velocity"}
_OF_LINKS = {"position": "pose", "orientation": "pose", "velocity": "velocity", "angular_velocity": "velocity"}
ARRIVALS = ("age", "fresh")
"""What the channel tells, and no engine."""
_TOLD = {
    "gap": "engine.gap({0}, {1})",
    "contact": "engine.contact({0}, ({1},))",
    "collided": "engine.contact({0}, ground=False)",
    "path_distance": "self.ways.distance({0}, {1})",
    "reachable": "self.ways.reachable({0}, {1})",
}
"""Facts that are one number or truth value each, and the reader of each; {0} and {1} are parts of the world."""
MANY = 12  # numbers; from here on it is shorter and faster to unpack a quaternion once
UNREAD = (*ARRIVALS, "present")
"""What is known without a reader."""
_PART = {"position": 0, "orientation": 1, "velocity": 0, "angular_velocity": 1, "joint_position": 0, "joint_velocity": 1}
_PART |= {name: index for index, name in enumerate(_FOLLOWED)}
"""Where a fact stands in what its reader returns, or returns for a joint."""


class Reads:
    """The readers that all expressions of one class need; one reader covers all joints of a robot.

    Each part of the class calls those that its own expressions need.
    """

    def __init__(self, expressions: Iterable[Scalar], names: Names) -> None:
        self._names = names
        self._needed: dict[str, dict[str, list[str]]] = {what: {} for what in (*_METHODS, *_TOLD, "line", "sight")}
        """The subjects of each kind of reader, with the joints that it is asked for."""
        leaves = list(_facts(expressions))
        for leaf in leaves:
            self._note(leaf)
        turns = Counter(leaf.subjects[0] for leaf in leaves if leaf.function == "orientation")
        self._unpacked = {subject for subject, count in turns.items() if count >= MANY}
        """Whose quaternions become four variables, since they are used so often."""

    def _note(self, leaf: World) -> None:
        subject, what = _reader(leaf)
        joints = self._needed[what].setdefault(subject, [])
        if what in ("joints", "torques"):
            joint = leaf.subjects[0].split(".", 1)[1]
            joints += [] if joint in joints else [joint]
        elif what == "line":
            self._note(_place_of(leaf.subjects[0]))

    def bind_lines(self) -> list[str]:
        """Statements that take the readers from `engine`."""
        readers = [
            f"self.read_{self._local(subject, what)} = engine.{method}({_arguments(subject, joints)})"
            for what, method in _METHODS.items()
            for subject, joints in self._needed[what].items()
        ]
        readers += [
            f"self.read_{self._local(subject, what)} = {code.format(*map(_part, subject.split(_AND)))}"
            for what, code in _TOLD.items()
            for subject in self._needed[what]
        ]
        lines = [quoted(subject.partition(_AND)[2]) for subject in self._needed["line"]]
        followed = zip(self._followers, lines, strict=True)
        readers += [f"{follower} = Follower(self.scenario.world.line({line}))" for follower, line in followed]
        return [*readers, *(f"self.read_{self._local(subject, 'sight')} = {_sight(subject)}" for subject in self._needed["sight"])]

    @property
    def charts(self) -> bool:
        """Whether ways around obstacles are asked for."""
        return bool(self._needed["path_distance"] or self._needed["reachable"])

    def start_lines(self) -> list[str]:
        """Statements that begin an episode."""
        return [f"{follower}.reset()" for follower in self._followers]

    @property
    def _followers(self) -> list[str]:
        return [f"self.read_{self._local(subject, 'line')}" for subject in self._needed["line"]]

    def call_lines(self, expressions: Iterable[Scalar]) -> list[str]:
        """Statements that read once what these expressions need."""
        needed = {_reader(leaf) for leaf in _facts(expressions)}
        needed |= {(subject.partition(_AND)[0], "pose") for subject, what in needed if what == "line"}
        ordered = [(subject, what) for what, table in self._needed.items() for subject in table if (subject, what) in needed]
        return [line for reader in ordered for line in self._call(*reader)]

    def _call(self, subject: str, what: str) -> list[str]:
        local = self._local(subject, what)
        call = f"{local} = self.read_{local}({self._argument(subject, what)})"
        if what != "pose" or subject not in self._unpacked:
            return [call]
        return [call, f"{', '.join(self._turned(subject, component) for component in _XYZ)} = {local}[1]"]

    def _argument(self, subject: str, what: str) -> str:
        """What a reader is given in every tick: a follower the position of the body, the others nothing."""
        return self.code(_place_of(subject.partition(_AND)[0])).removesuffix("[0]") if what == "line" else ""

    def code(self, leaf: World) -> str:
        """The code of one number, after its reader was called."""
        subject, what = _reader(leaf)
        local = self._local(subject, what)
        if leaf.function == "orientation" and subject in self._unpacked:
            return self._turned(subject, leaf.component or "x")
        if what in ("pose", "velocity"):
            return f"{local}[{_PART[leaf.function]}][{_XYZ[leaf.component or 'x']}]"
        if what == "sight" or what in _TOLD:
            return local
        if what == "line":
            return f"{local}[{_PART[leaf.function]}]"
        index = self._needed[what][subject].index(leaf.subjects[0].split(".", 1)[1])
        return f"{local}[{index}]" if what == "torques" else f"{local}[{index}][{_PART[leaf.function]}]"

    def _turned(self, subject: str, component: str) -> str:
        return self._names(f"{subject} turned", component)

    def _local(self, subject: str, what: str) -> str:
        return self._names(f"{subject} {what}")  # the blank keeps it apart from every name of the scenario


def _reader(leaf: World) -> tuple[str, str]:
    """Whose reader gives this number, and which of its readers."""
    subject = leaf.subjects[0]
    if leaf.function in _OF_LINKS:
        return subject, _OF_LINKS[leaf.function]
    if leaf.function in _TOLD:
        return _AND.join(leaf.subjects), leaf.function
    if leaf.function in _FOLLOWED:
        return _AND.join(leaf.subjects), "line"
    if leaf.function == "visible":
        return _AND.join(leaf.subjects), "sight"
    return subject.split(".", 1)[0], "torques" if leaf.function == "joint_torque" else "joints"


def _sight(subject: str) -> str:
    """What tells whether a camera sees a body; `subject` names both."""
    camera, _, body = subject.partition(_AND)
    robot, _, sensor = camera.partition(".")
    return f"self.robot_{robot}.sees({quoted(sensor)}, {quoted(body)})"


def _place_of(body: str) -> World:
    return World("position", (body,), "x")


def _facts(expressions: Iterable[Scalar]) -> Iterator[World]:
    return (node for expression in expressions for node in walk(expression) if isinstance(node, World) and node.function not in UNREAD)


def _part(name: str) -> str:
    """A body or one of its links, as the port takes it."""
    body, _, link = name.partition(".")
    return f"({quoted(body)}, {quoted(link) if link else None})"


def _arguments(subject: str, joints: list[str]) -> str:
    if joints:
        return f"{quoted(subject)}, {quoted_tuple(joints)}"
    body, _, link = subject.partition(".")
    return f"{quoted(body)}, {quoted(link)}" if link else quoted(body)

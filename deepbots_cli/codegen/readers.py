"""Which engine readers a class needs, and how it gets at each number.

Every `World` leaf becomes an item of what one bound reader returned. A reader is bound when printed code first asks for it, and is
called once in each method that needs it, however many numbers are taken from it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from deepbots_cli.codegen.text import VARIABLES, Constants, Names, quoted
from deepbots_cli.expressions.scalar import World

Key = tuple[str, str]
"""The kind of a reader and what it reads."""
Needs = dict[Key, None]
"""The readers that a method calls, in order of first use."""

_AND = "\0"
"""Between two parts of the world that one reader is about: no name holds it, and those of the pieces of walls hold blanks."""
_KINDS = ("joints", "torques", "pose", "velocity")
_POSES = {"position": "pose", "orientation": "pose", "velocity": "velocity", "angular_velocity": "velocity"}
_ITEM = {
    "position": 0,
    "orientation": 1,
    "velocity": 0,
    "angular_velocity": 1,
    "joint_position": 0,
    "joint_velocity": 1,
    "cross_track_error": 0,
    "arc_length": 1,
}
"""The index of a fact in the result of its reader, or in the result for a joint."""
_XYZ = "xyzw"
ARRIVALS = ("age", "message_received")
"""Values that the channel has, not the engine."""
_SINGLE = {
    "clearance": "engine.clearance({0}, {1})",
    "contact": "engine.contact({0}, ({1},))",
    "collided": "engine.contact({0}, ground=False)",
    "path_distance": "self.ways.distance({0}, {1})",
    "reachable": "self.ways.reachable({0}, {1})",
    "visible": "self.robot_{robot}.sees({sensor}, {body})",
}
"""Facts that are one number or truth value each, and the reader of each; {0} and {1} are parts of the world."""
_ORDER = (*_KINDS, *_SINGLE, "line")


class Readers:
    """The readers of one class; one reader covers all joints of a robot."""

    def __init__(self, names: Names, constants: Constants, roots: Mapping[str, str], *, on_columns: bool = False) -> None:
        """`roots` has the full name of the root link of each robot, whose readers are named after the robot alone.

        For a batch (`on_columns`), motion is read as columns, and everything else from the single worlds.
        """
        self._on_columns = on_columns
        self._names = names
        self._constants = constants
        self._short = {link: robot for robot, link in roots.items()}
        self._joints: dict[Key, list[str]] = {}
        """Those that are read together, by their reader."""
        self._bound: Needs = {}

    # What printed code asks for

    def code(self, leaf: World, needs: Needs) -> str:
        """The code of one number."""
        what, item = leaf.function, _ITEM.get(leaf.function)
        if what in _POSES:
            return f"{self._need((_POSES[what], leaf.subjects[0]), needs)}[{item}][{_XYZ.index(leaf.component or 'x')}]"
        if what in _SINGLE:
            return self._need((what, _AND.join(leaf.subjects)), needs)
        if what in ("cross_track_error", "arc_length"):
            self.pose(leaf.subjects[0], needs)
            return f"{self._need(('line', _AND.join(leaf.subjects)), needs)}[{item}]"
        code, index = self._joint(leaf, needs)
        return f"{code}[{index}]" if what == "joint_torque" else f"{code}[{index}][{item}]"

    def pose(self, subject: str, needs: Needs) -> str:
        """The code of the position and the orientation of a body."""
        return self._need(("pose", subject), needs)

    def vector(self, leaves: Sequence[World], needs: Needs) -> tuple[str, str] | None:
        """The code of a sequence and of what is taken from each item; None where the facts are read apart."""
        what, subjects = leaves[0].function, [leaf.subjects for leaf in leaves]
        if any(leaf.function != what for leaf in leaves):
            return None
        if what in _POSES:
            parts = "".join(leaf.component or "" for leaf in leaves)
            whole = len(set(subjects)) == 1 and parts == _XYZ[: 4 if what == "orientation" else 3]
            return (f"{self.pose_or_velocity(leaves[0], needs)}[{_ITEM[what]}]", "") if whole else None
        if what in ("joint_position", "joint_velocity", "joint_torque"):
            robot, names = subjects[0][0].partition(".")[0], [one.partition(".")[2] for (one,) in subjects]
            if any(one.partition(".")[0] != robot for (one,) in subjects) or len(names) < 2:
                return None
            key = _of_joints(leaves[0], names)
            self._joints[key] = names
            return self._need(key, needs), "" if what == "joint_torque" else f"[{_ITEM[what]}]"
        if what == "contact" and len(leaves) > 2 and len({others[1:] for others in subjects}) == 1:
            robot = subjects[0][0].partition(".")[0]
            if all(one.partition(".")[0] == robot and "." in one for one, *_ in subjects):
                links = _AND.join(one.partition(".")[2] for one, *_ in subjects)
                return self._need(("contacts", _AND.join((robot, subjects[0][1], links))), needs), ""
        return None

    def pose_or_velocity(self, leaf: World, needs: Needs) -> str:
        """The code of what the reader of a link returns."""
        return self._need((_POSES[leaf.function], leaf.subjects[0]), needs)

    def _joint(self, leaf: World, needs: Needs) -> tuple[str, int]:
        single, (robot, _, name) = _of_joints(leaf, ()), leaf.subjects[0].partition(".")
        vectors = (key for key, names in self._joints.items() if name in names and key[0] == single[0] and _robot(key) == robot)
        key = next(vectors, single)
        joints = self._joints.setdefault(key, [])
        joints += [] if name in joints else [name]
        return self._need(key, needs), joints.index(name)

    def _need(self, key: Key, needs: Needs) -> str:
        self._bound[key] = needs[key] = None
        return self._local(key)

    # What it comes to

    def bind_lines(self) -> list[str]:
        """Statements that take the readers from `engine`."""
        return [f"self.read_{self._local(key)} = {self._reader(key)}" for key in self._sorted(self._bound)]

    def call_lines(self, needs: Needs) -> list[str]:
        """Statements that read once what a method needs."""
        lines = []
        for key in self._sorted(needs):
            kind, subject = key
            local = self._local(key)
            place = f"{self._local(('pose', subject.partition(_AND)[0]))}[0]" if kind == "line" else ""
            many = kind == "contacts"
            lines.append(f"{local} = [a() for a in self.read_{local}]" if many else f"{local} = self.read_{local}({place})")
        return lines

    def start_lines(self) -> list[str]:
        """Statements that begin an episode."""
        return [f"self.read_{self._local(key)}.reset()" for key in self._sorted(self._bound) if key[0] == "line"]

    @property
    def charts(self) -> bool:
        """Whether the class needs paths around obstacles."""
        return any(kind in ("path_distance", "reachable") for kind, _ in self._bound)

    def _sorted(self, keys: Needs) -> list[Key]:
        return sorted(keys, key=lambda key: _ORDER.index(key[0].removesuffix("s") if key[0] == "contacts" else key[0]))

    def _local(self, key: Key) -> str:
        kind, subject = key
        parts = subject.split(_AND)
        said = [self._short.get(part, part) for part in parts[: {"contacts": 2, "joints": 1, "torques": 1}.get(kind)]]
        return self._names.called(f"{kind}\1{subject}", *said, kind)

    def _reader(self, key: Key) -> str:
        kind, subject = key
        parts = subject.split(_AND)
        body, _, link = subject.partition(".")
        if self._on_columns and kind not in _KINDS:
            name = quoted(f"read_{self._local(key)}")
            return f"[self.each({name}, index) for index in range({len(parts) - 2})]" if kind == "contacts" else f"self.each({name})"
        match kind:
            case "joints" | "torques":
                method = "joint_states" if kind == "joints" else "joint_torques"
                return f"engine.{method}({quoted(parts[0])}, {self._constants.strings(tuple(self._joints[key]))})"
            case "pose" | "velocity":
                return f"engine.{kind}({quoted(body)}, {quoted(link)})" if link else f"engine.{kind}({quoted(body)})"
            case "line":
                return f"Follower(self.scenario.world.line({quoted(parts[1])}))"
            case "contacts":
                robot, other, *links = parts
                variable = VARIABLES[0]
                touched = _SINGLE["contact"].format(f"({quoted(robot)}, {variable})", _part(other))
                return f"[{touched} for {variable} in {self._constants.strings(tuple(links))}]"
            case "visible":
                robot, _, sensor = parts[0].partition(".")
                return _SINGLE[kind].format(robot=robot, sensor=quoted(sensor), body=quoted(parts[1]))
            case _:
                return _SINGLE[kind].format(*map(_part, parts))


def _of_joints(leaf: World, names: Sequence[str]) -> Key:
    """The reader of certain joints that are read as a vector, or of all that are read one by one."""
    kind = "torques" if leaf.function == "joint_torque" else "joints"
    return kind, _AND.join((leaf.subjects[0].partition(".")[0], *names))


def _robot(key: Key) -> str:
    return key[1].partition(_AND)[0]


def _part(name: str) -> str:
    """A body or one of its links, as the port takes it."""
    body, _, link = name.partition(".")
    return f"({quoted(body)}, {quoted(link) if link else None})"

"""Comparison of programs: canonical JSON with digests, the interfaces of agents, item by item, the values
that a value is made of, and the readings of the world that a policy needs and no robot measures.

Canonical means: keys sorted, no spaces, floats by their shortest exact form. Every record is an object whose
key `is` holds the class name. Texts and places in files are left out: an expression is written as its name
and its scalar trees, a file as its suffix and the digest of its content. The JSON is written and never read
back: a scenario is loaded and compiled instead.

The interface holds the observation, action and messages that a policy and a world have agreed on. A policy is
only as good as the meaning of the numbers that it was trained on. Each agreed item has a name and a text. A
run records them all; they show whether, and where, a scenario no longer fits its policy.

A reading is called as the scenario would write it, with a robot for its root link: `position(cart)`.
"""

from __future__ import annotations

import hashlib
import json
import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass, replace
from functools import cached_property, lru_cache
from pathlib import PurePath
from typing import Any

from deepbots_cli.expressions.scalar import EngineRead, Name, Scalar, names_in, walk
from deepbots_cli.program import Program
from deepbots_cli.program.resets import JointStart, Placement, RandomizedParameter
from deepbots_cli.program.robots import (
    Command,
    MessageField,
    MessageLayout,
    Motor,
    RayConfig,
    Robot,
    Sensor,
    Thrust,
)
from deepbots_cli.program.task import (
    ActionRange,
    Agent,
    Choices,
    Evaluation,
    ObservedNumber,
    SelfPlay,
    Training,
)
from deepbots_cli.program.values import Expression, NamedScalars
from deepbots_cli.program.world import Picture, RobotBody
from deepbots_cli.robots.model import Mesh

Node = tuple[Robot | None, Scalar]
"""A part of a tree, and the robot that computes it; None for the supervisor."""


class Definitions:
    """The values that a program names.

    `fields` are the fields that robots send, by full name, each with the robot that computes it.
    """

    def __init__(self, program: Program) -> None:
        self.parameters = {value.name: value for value in program.parameters}
        self.signals = {signal.name: signal for signal in program.signals}
        self.fields = {
            f"{robot.name}.{entry.name}": (robot, entry)
            for robot in program.robots
            for entry in robot.emitted
        }
        self._followed: dict[str, tuple[Robot | None, Expression | NamedScalars]] = {
            **{value.name: (None, value) for value in (*program.signals, *program.endings)},
            **self.fields,
            **{
                f"{link.receiver}.{value.name}": (None, value)
                for link in program.links
                for value in link.values
            },
        }

    def nodes(self, trees: Iterable[Scalar]) -> Iterator[Node]:
        """Return the nodes of trees of the supervisor, and after each name those of its definition, once.

        A parameter has no definition here, and a sensor has none.
        """
        return self._nodes(trees, None, set())

    def _nodes(self, trees: Iterable[Scalar], robot: Robot | None, met: set[str]) -> Iterator[Node]:
        for node in (node for tree in trees for node in walk(tree)):
            yield robot, node
            # A name on board of a robot is one of its sensors, and not a value of the supervisor.
            if (
                robot is None
                and isinstance(node, Name)
                and node.name in self._followed
                and node.name not in met
            ):
                met.add(node.name)
                owner, value = self._followed[node.name]
                yield from self._nodes(value.scalars, owner, met)


# Canonical JSON


def to_json(program: Program) -> str:
    """Return canonical JSON; equal programs give equal text."""
    # JSON has no NaN or infinity; `_plain` writes them as objects.
    # json writes a `NamedFloat` as a plain float, so that the name of a parameter is not part of the digest.
    return json.dumps(_plain(program), sort_keys=True, separators=(",", ":"), allow_nan=False)


@lru_cache(maxsize=16)
def digest(program: Program) -> str:
    """Return SHA-256 of the canonical JSON, in hexadecimal.

    The digest is kept, since each copy of an environment needs it: that of PandaReach takes 30 ms.
    """
    return hashlib.sha256(to_json(program).encode()).hexdigest()


def task_digest(program: Program) -> str:
    """Return the digest of the parts that determine an episode: it is the same for scenarios that differ only
    in their names, training, evaluation or scripts."""
    nameless = replace(program.with_agent(scripts=(), training=None, solved=None), name="", summary="")
    return digest(replace(nameless, curriculum=(), levels=None, evaluation=Evaluation(), cases=()))


_COUNTED: Mapping[type, Sequence[str]] = {
    Command: ("name", "scalars"),
    JointStart: ("robot", "states"),
    Placement: (
        *("body", "xyz", "rpy", "velocity", "angular_velocity"),
        *("seeks_height", "spot", "clearance", "at_most", "spacing", "stream"),
    ),
    RandomizedParameter: ("what", "of", "scalars"),
}
"""The members that count for records that are not written field by field."""
_UNCOUNTED: Mapping[type, Sequence[str]] = {
    SelfPlay: ("has_default_interval",),
    Sensor: ("reader", "world_function"),
}
_LATER: Mapping[type, Sequence[str]] = {
    Agent: ("critic",),
    Motor: ("stall_torque", "no_load_speed"),
    RayConfig: ("upright", "behind"),
    RobotBody: ("self_collision",),
    Thrust: ("axis",),
    Training: (
        *("shards", "teacher", "staleness", "patience"),
        *("symmetry", "agents", "self_play", "turns"),
    ),
}
"""Fields that are left out where they have their defaults, as in digests from before they were fields."""


def record_members(part: object) -> dict[str, Any] | None:
    """Return the members of a record by name, as they count for the digest; None if it is not a record. For a
    path, the suffix counts."""
    kind = type(part)
    if isinstance(part, Scalar):
        return part._asdict()
    if hasattr(part, "digest_fields"):
        return part.digest_fields()  # type: ignore[no-any-return]
    if kind in _COUNTED:
        return {name: getattr(part, name) for name in _COUNTED[kind]}
    if is_dataclass(part) and not isinstance(part, type):
        later = _LATER.get(kind, ())
        members = {
            field.name: value
            for field in fields(part)
            for value in [getattr(part, field.name)]
            if not (field.name in later and value == field.default)
        }
        for name in _UNCOUNTED.get(kind, ()):
            del members[name]
        return members | {"path": PurePath(part.path).suffix} if isinstance(part, Mesh | Picture) else members
    return None


def _plain(value: object) -> object:
    if value is None or isinstance(value, str | int):
        return value
    if isinstance(value, float):
        return value if math.isfinite(value) else {"is": "float", "value": repr(value)}
    inside = record_members(value)
    if inside is not None:
        return {"is": type(value).__name__, **{name: _plain(member) for name, member in inside.items()}}
    if isinstance(value, tuple):
        return [_plain(item) for item in value]
    if isinstance(value, Mapping):
        return {name: _plain(item) for name, item in value.items()}
    return value


# The interfaces of agents


def interface(program: Program) -> dict[str, dict[str, str]]:
    """Return the agreed items of the agent, by its name, in order: `observation.speed` to `-0.8 .. 0.8
    m/s`."""
    return {program.agent.name: _agreed(program.agent, program)}


def _agreed(agent: Agent, program: Program) -> dict[str, str]:
    """Return the agreed items of an agent: its observation and action, and the messages of its robots."""
    items = {f"observation.{observed.full_name}": _observed(observed) for observed in agent.numbers}
    for pictured in agent.images:
        items[f"observation.{pictured.name}"] = (
            f"picture of {' x '.join(map(str, pictured.shape))}, {pictured.history} in a row"
        )
    if agent.goal is not None:
        for component, low, high in zip(
            agent.goal.components or ("",), agent.goal.low, agent.goal.high, strict=True
        ):
            items[f"goal.{component}".rstrip(".")] = _range(low, high, agent.goal.unit)
    if agent.frame_stack > 1:
        items["agent.frame_stack"] = f"{agent.frame_stack} observations in a row"
    items |= {f"action.{part.name}": _action(part) for part in agent.action}
    for robot in program.robots:
        if robot.name in agent.robots:
            for layout in (robot.to_robot, robot.from_robot):
                items |= _message(layout)
    return items


def differences(
    first: Program, second: Program, *, words: tuple[str, str] = ("run", "scenario")
) -> list[str]:
    """Return one line for each item that the two, called by `words`, do not share; empty if the policies of
    one fit the other."""
    return compare_interfaces(interface(first), interface(second), words=words)


def compare_interfaces(
    old: Mapping[str, Mapping[str, str]],
    new: Mapping[str, Mapping[str, str]],
    *,
    words: tuple[str, str] = ("run", "scenario"),
) -> list[str]:
    """Return one line for each item in which two interfaces differ, as in `differences`."""
    return [
        line
        for name in dict.fromkeys((*old, *new))
        for line in _compared(old.get(name, {}), new.get(name, {}), words)
    ]


def _compared(old: Mapping[str, str], new: Mapping[str, str], words: tuple[str, str]) -> list[str]:
    first_word, second_word = words
    lines = [
        f"{name}: {first_word} {old.get(name, 'has none')}, {second_word} {new.get(name, 'has none')}"
        # A dict keeps the order of the scenario; a set of texts has another order in each process.
        for name in dict.fromkeys((*old, *new))
        if old.get(name) != new.get(name)
    ]
    # A policy takes the numbers of an observation by position.
    if not lines and list(old) != list(new):
        lines.append(f"order: {first_word} {', '.join(old)}; {second_word} {', '.join(new)}")
    return lines


def timing_differences(run: Program, scenario: Program) -> list[str]:
    """Return one line per setting that differs from training but does not break the policy: timing, timestep,
    action repeat."""
    circumstances = (
        ("timing", run.timing, scenario.timing),
        ("timestep", f"{run.world.timestep:g} s", f"{scenario.world.timestep:g} s"),
        ("action_repeat", str(run.action_repeat), str(scenario.action_repeat)),
    )
    return [
        f"trained with {name} {old}, evaluated with {new}" for name, old, new in circumstances if old != new
    ]


def _range(low: float, high: float, unit: str) -> str:
    return f"{low:g} .. {high:g} {unit}".rstrip()


def _observed(observed: ObservedNumber) -> str:
    text = "true or false" if observed.is_truth else _range(observed.low, observed.high, observed.unit)
    text += "" if observed.clip or observed.is_truth else ", not clipped"
    return f"{text}, {observed.history} in a row" if observed.history > 1 else text


def _action(part: Choices | ActionRange) -> str:
    if isinstance(part, ActionRange):
        size = f" for {', '.join(part.components)}" if part.components else ""
        return _range(part.low, part.high, part.unit) + size
    options = (
        f"{option.name} ({', '.join(f'{value:g}' for value in option.values)})" for option in part.options
    )
    return f"{' | '.join(options)} sets {', '.join(part.variables)}"


def _message(layout: MessageLayout) -> dict[str, str]:
    prefix = f"message {layout.direction.replace('_', ' ')} {layout.robot}"
    return {
        f"{prefix}.{field.name}": " ".join(filter(None, (field.dtype, _inside(field), field.unit)))
        for field in layout.fields
    }


def _inside(field: MessageField) -> str:
    """Return the components of a vector, the sides of a picture."""
    listed = field.components or tuple(map(str, field.shape))
    return f"[{', '.join(listed)}]" if listed else ""


# Readings that a policy needs


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
        if reading.function in {"age", "message_received"} or reading in self.sensed:
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

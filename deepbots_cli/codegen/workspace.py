"""The names and readers that the methods of a printed class share: its scenario, the names in its code, and
its reads of the engine.

Every `EngineRead` leaf becomes an item of the result of a bound reader. A reader is bound when printed code
first needs it, and is called once in each method that needs it, however many numbers are taken from it.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Container, Iterable, Iterator, Mapping, Sequence
from copy import copy
from typing import NamedTuple

from deepbots_cli.codegen.names import LOOP_VARIABLES, Constants, Names, quoted
from deepbots_cli.codegen.printer import Printer
from deepbots_cli.expressions.scalar import EngineRead, Name, Scalar, is_drawn, names_in, walk
from deepbots_cli.expressions.text import SCALAR, Target
from deepbots_cli.program import ENDED, EPISODE_RETURN, PREVIOUS_REWARD, Program, generated, qualified_name
from deepbots_cli.program.task import Script, action_names

# Readers of the engine

_KINDS = ("joints", "torques", "pose", "velocity")
_OF_COLUMNS = (
    *(*_KINDS, "clearance", "contact", "contacts", "collided"),
    *("contact_force", "contact_force_vector", "angular_momentum"),
)
"""The kinds of readers that engines with batches give as columns."""
_POSES = {"position": "pose", "orientation": "pose", "velocity": "velocity", "angular_velocity": "velocity"}
_RESULT_INDEX = {
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
CHANNEL_VALUES = ("age", "message_received")
"""The values of the channel, not of the engine."""
_SCALAR_READERS = {
    "clearance": "engine.clearance({0}, {1})",
    "contact": "engine.contact({0}, ({1},))",
    "collided": "engine.contact({0}, ground=False)",
    "contact_force": "engine.contact_force({0})",
    "path_distance": "self.ways.distance({0}, {1})",
    "path_bearing": "self.ways.bearing({0}, {1})",
    "reachable": "self.ways.reachable({0}, {1})",
    "visible": "self.{robot}.sees({sensor}, {body})",
}
"""The facts that are one number or truth value each, and the reader of each; {0} and {1} are parts of the
world."""
_VECTOR_READERS = {
    "contact_force_vector": "engine.contact_force_vector({0})",
    "angular_momentum": "engine.angular_momentum({robot})",
}
"""The facts that are vectors x y z, and the reader of each."""
# The reader of a line is called last, because it takes the position from the result of a pose reader.
_READER_ORDER = (*_KINDS, *_SCALAR_READERS, *_VECTOR_READERS, "line")


class ReaderKey(NamedTuple):
    """The kind of a reader, and the parts of the world that it is about."""

    kind: str
    parts: tuple[str, ...]


ReaderKeys = dict[ReaderKey, None]
"""The readers that a method calls, in order of first use."""


class Readers:
    """The readers of one class; one reader covers all joints of a robot."""

    def __init__(
        self, names: Names, constants: Constants, roots: Mapping[str, str], *, on_columns: bool = False
    ) -> None:
        """Create readers. `roots` has the full name of the root link of each robot, whose readers are named
        after the robot alone.

        For a batch (`on_columns`), facts that no engine gives as columns are read from the single worlds.
        """
        self._on_columns = on_columns
        self._names = names
        self._constants = constants
        self._short = {link: robot for robot, link in roots.items()}
        self._joints: dict[ReaderKey, list[str]] = {}
        """The joints that are read together, by their reader."""
        self._bound: ReaderKeys = {}

    # Reads of printed code

    def code(self, leaf: EngineRead, needs: ReaderKeys) -> str:
        """Return the code of one number."""
        kind = leaf.function
        item = _RESULT_INDEX.get(leaf.function)
        if kind in _POSES:
            pose = self._need(_POSES[kind], leaf.subjects[:1], needs)
            return f"{pose}[{item}][{_XYZ.index(leaf.component or 'x')}]"
        if kind in _SCALAR_READERS:
            return self._need(kind, leaf.subjects, needs)
        if kind in _VECTOR_READERS:
            return f"{self._need(kind, leaf.subjects, needs)}[{_XYZ.index(leaf.component or 'x')}]"
        if kind in ("cross_track_error", "arc_length"):
            self.pose(leaf.subjects[0], needs)
            return f"{self._need('line', leaf.subjects, needs)}[{item}]"
        code, index = self._joint(leaf, needs)
        return f"{code}[{index}]" if kind == "joint_torque" else f"{code}[{index}][{item}]"

    def pose(self, subject: str, needs: ReaderKeys) -> str:
        """Return the code of the position and the orientation of a body."""
        return self._need("pose", (subject,), needs)

    def vector(self, leaves: Sequence[EngineRead], needs: ReaderKeys) -> tuple[str, str] | None:
        """Return the code of a sequence and of the part that is taken from each item; None if the facts are
        read separately."""
        kind = leaves[0].function
        subjects = [leaf.subjects for leaf in leaves]
        if any(leaf.function != kind for leaf in leaves):
            return None
        if kind in _POSES or kind in _VECTOR_READERS:
            parts = "".join(leaf.component or "" for leaf in leaves)
            if len(set(subjects)) > 1 or parts != _XYZ[: 4 if kind == "orientation" else 3]:
                return None
            code = self._need(_POSES.get(kind, kind), leaves[0].subjects[:1], needs)
            return f"{code}[{_RESULT_INDEX[kind]}]" if kind in _POSES else code, ""
        if kind in ("joint_position", "joint_velocity", "joint_torque"):
            robot = subjects[0][0].partition(".")[0]
            names = [name.partition(".")[2] for (name,) in subjects]
            if any(name.partition(".")[0] != robot for (name,) in subjects) or len(names) < 2:
                return None
            key = _joint_reader(leaves[0], names)
            self._joints[key] = names
            return self._need(*key, needs), "" if kind == "joint_torque" else f"[{_RESULT_INDEX[kind]}]"
        if kind == "contact" and len(leaves) > 2 and len({subject[1:] for subject in subjects}) == 1:
            robot = subjects[0][0].partition(".")[0]
            if all(name.partition(".")[0] == robot and "." in name for name, *_ in subjects):
                links = (name.partition(".")[2] for name, *_ in subjects)
                return self._need("contacts", (robot, subjects[0][1], *links), needs), ""
        return None

    def _joint(self, leaf: EngineRead, needs: ReaderKeys) -> tuple[str, int]:
        single = _joint_reader(leaf, ())
        robot, _, name = leaf.subjects[0].partition(".")
        vectors = (
            key
            for key, names in self._joints.items()
            if name in names and (key.kind, key.parts[0]) == (single.kind, robot)
        )
        key = next(vectors, single)
        joints = self._joints.setdefault(key, [])
        joints += [] if name in joints else [name]
        return self._need(*key, needs), joints.index(name)

    def _need(self, kind: str, parts: tuple[str, ...], needs: ReaderKeys) -> str:
        key = ReaderKey(kind, parts)
        self._bound[key] = needs[key] = None
        return self._local(key)

    # The resulting code

    def bind_lines(self) -> list[str]:
        """Return statements that take the readers from `engine`."""
        return [
            f"self.{generated.reader(self._local(key))} = {self._reader(key)}"
            for key in self._sorted(self._bound)
        ]

    def call_lines(self, needs: ReaderKeys) -> list[str]:
        """Return statements that read once the facts that a method needs."""
        lines = []
        for key in self._sorted(needs):
            local = self._local(key)
            position = f"{self._local(ReaderKey('pose', key.parts[:1]))}[0]" if key.kind == "line" else ""
            many = key.kind == "contacts"
            reader = f"self.{generated.reader(local)}"
            lines.append(f"{local} = [a() for a in {reader}]" if many else f"{local} = {reader}({position})")
        return lines

    def start_lines(self) -> list[str]:
        """Return statements that begin an episode."""
        return [
            f"self.{generated.reader(self._local(key))}.reset()"
            for key in self._sorted(self._bound)
            if key.kind == "line"
        ]

    @property
    def needs_paths(self) -> bool:
        """Whether the class needs paths around obstacles."""
        return any(key.kind in ("path_distance", "path_bearing", "reachable") for key in self._bound)

    def _sorted(self, keys: ReaderKeys) -> list[ReaderKey]:
        return sorted(
            keys, key=lambda key: _READER_ORDER.index("contact" if key.kind == "contacts" else key.kind)
        )

    def _local(self, key: ReaderKey) -> str:
        parts = key.parts[: {"contacts": 2, "joints": 1, "torques": 1}.get(key.kind)]
        return self._names.identifier(key, *(self._short.get(part, part) for part in parts), key.kind)

    def _reader(self, key: ReaderKey) -> str:
        kind, parts = key
        body, _, link = parts[0].partition(".")
        if self._on_columns and kind not in _OF_COLUMNS:
            return f"self.each({quoted(generated.reader(self._local(key)))})"
        match kind:
            case "joints" | "torques":
                method = "joint_states" if kind == "joints" else "joint_torques"
                return (
                    f"engine.{method}({quoted(parts[0])},"
                    f" {self._constants.strings(tuple(self._joints[key]))})"
                )
            case "pose" | "velocity":
                return (
                    f"engine.{kind}({quoted(body)}, {quoted(link)})"
                    if link
                    else f"engine.{kind}({quoted(body)})"
                )
            case "line":
                return f"Follower(self.scenario.world.line({quoted(parts[1])}))"
            case "contacts":
                robot, target, *links = parts
                variable = LOOP_VARIABLES[0]
                touched = _SCALAR_READERS["contact"].format(f"({quoted(robot)}, {variable})", _part(target))
                return f"[{touched} for {variable} in {self._constants.strings(tuple(links))}]"
            case "visible":
                robot, _, sensor = parts[0].partition(".")
                return _SCALAR_READERS[kind].format(
                    robot=generated.robot(robot), sensor=quoted(sensor), body=quoted(parts[1])
                )
            case _:
                return (_SCALAR_READERS | _VECTOR_READERS)[kind].format(
                    *map(_part, parts), robot=quoted(body)
                )


def _joint_reader(leaf: EngineRead, names: Sequence[str]) -> ReaderKey:
    """Return the reader of certain joints that are read as a vector, or of all that are read one by one."""
    kind = "torques" if leaf.function == "joint_torque" else "joints"
    return ReaderKey(kind, (leaf.subjects[0].partition(".")[0], *names))


def _part(name: str) -> str:
    """Return a body or one of its links, as the port takes it."""
    body, _, link = name.partition(".")
    return f"({quoted(body)}, {quoted(link) if link else None})"


# Names shared by the methods of a class

_GOAL = ("achieved", "desired", "goal_reached")


class ClassPrinter(ABC):
    """A printed class: the meanings of its names, and the parts that its methods share."""

    begun_by_message: Container[tuple[str, str]] = ()
    """The calls of stateful functions whose memories begin with the first message, and not at the reset."""

    def __init__(self, scenario: Program, constants: Constants, target: Target) -> None:
        self.scenario = scenario
        self.constants = constants
        self.target = target
        self.names = Names()
        self.memories: dict[str, str] = {}
        """The code that makes each memory, by its attribute."""
        roots = {body.name: f"{body.name}.{body.model.root}" for body in scenario.world.robots}
        self.readers = Readers(self.names, constants, roots, on_columns=target is not SCALAR)

    @abstractmethod
    def scalar(self, leaf: Name | EngineRead, needs: ReaderKeys) -> str:
        """Return the code of one number."""

    @abstractmethod
    def vector(self, leaves: Sequence[Name]) -> str | None:
        """Return the code of a vector that consists of these components; None where they are of no one
        vector."""

    def bind_lines(self, *statements: str) -> list[str]:
        """Return statements that bind readers, the `statements`, and statements that make the memories of
        stateful functions."""
        return [
            *self.readers.bind_lines(),
            *statements,
            *(f"self.{name} = {code}" for name, code in self.memories.items()),
        ]


class SupervisorPrinter(ClassPrinter):
    """The printer of one supervisor class.

    `scripts` are the scripts that a batch computes; a single world computes all of them. `evaluated` are the
    expressions of every timestep; `sent` are the expressions of messages to robots, with values of the
    timestep before; `scripted` are the expressions of hand-written policies and of tests, which are called
    between two steps.
    """

    def __init__(
        self,
        scenario: Program,
        constants: Constants,
        target: Target = SCALAR,
        scripts: Sequence[Script] = (),
    ) -> None:
        super().__init__(scenario, constants, target)
        self.agent = scenario.agent
        self.per_world: dict[str, list[str]] = {}
        """The lines of methods that draw values in a single world, by their names, for a batch."""
        self.state: dict[str, None] = {}
        """The attributes with drawn values and values of the timestep before, in order of first use."""
        self.repeats_actions = scenario.action_repeat > 1
        """Whether a step of the agent has several timesteps, which are then a method of their own."""
        self.has_history = self.agent.frame_stack > 1 or any(
            entry.history > 1 for entry in self.agent.observation
        )
        """Whether the policy sees more than the numbers of the last step."""
        self.is_of_copy = self.agent.copies is not None and target is SCALAR
        """Whether this is the supervisor of one copy among several, whose world goes on for all of them at
        once; not in a batch."""
        self.tick = "self.timestep_count" if self.repeats_actions else "self.step_count"
        """Code that counts the timesteps of the episode."""
        self.choices = self.agent.choices
        self.ranges = self.agent.ranges
        conditions = [
            option.forbidden.scalar
            for part in self.choices
            for option in part.options
            if option.forbidden is not None
        ]
        self.scripted = [value for script in self.agent.scripts for value in script.scalars]
        self.scripted += [value for test in scenario.tests for value in (*test.scalars, *test.compared)]
        self._asked = [value for script in scripts for value in script.scalars]
        """The expressions that are computed between two steps."""
        if target is SCALAR:
            self._asked = self.scripted
        self.sent = [
            value for robot in scenario.robots for entry in robot.received for value in entry.scalars
        ]
        self.forbids_options = bool(conditions)
        """Whether an option of a choice may ever be forbidden."""
        self.settable = {
            id(value): full
            for entry in scenario.settable_draws
            for full, value in entry.numbers
            if is_drawn(value)
        }
        evaluated = [*self._values_of_timesteps(), *conditions, *self.scripted]
        self._used = {leaf.name for expression in evaluated for leaf in names_in(expression)}
        self._ages = {
            f"{robot.name}.{sensor}": f"{robot.name}.{field}"
            for robot in scenario.robots
            for sensor, field in robot.ages
        }
        self._parameters = {entry.name: entry.components for entry in scenario.parameters}
        self._components = self._named_components()
        self._results_of_agents = {
            qualified_name(agent, word): (agent, word)
            for agent in scenario.members
            for word in (PREVIOUS_REWARD, EPISODE_RETURN)
        }

    def _values_of_timesteps(self) -> Iterator[Scalar]:
        """Yield the expressions of every timestep, without conditions that forbid options."""
        agent = self.agent
        goal = self.agent.goal
        for entry in self.scenario.signals:
            yield from entry.scalars
        yield from (ending.scalar for ending in self.scenario.endings)
        yield from (term.scalar for term in agent.reward)
        for observed in agent.observation:
            yield from observed.value.scalars
        if goal is not None:
            yield from (*goal.achieved.scalars, *goal.targets)

    def _named_components(self) -> dict[str, Sequence[str]]:
        """Return the components of signals, emitted values, parts of the action, and goals."""
        components: dict[str, Sequence[str]] = {
            entry.name: entry.components for entry in self.scenario.signals
        }
        components |= {
            f"{robot.name}.{entry.name}": entry.components
            for robot in self.scenario.robots
            for entry in robot.emitted
        }
        components |= {
            f"{link.receiver}.{value.name}": value.components
            for link in self.scenario.links
            for value in link.values
        }
        components |= {part.name: part.components for part in self.ranges}
        components["previous_action"] = action_names(self.agent.action)
        if self.agent.goal is not None:
            components |= dict.fromkeys(("achieved", "desired"), self.agent.goal.components)
        return components

    @property
    def variables(self) -> list[tuple[str, Sequence[str]]]:
        """The action variables, with their components."""
        components = {part.name: part.components for part in self.ranges}
        return [(name, components.get(name, ())) for part in self.agent.action for name in part.variables]

    @property
    def action_names_read(self) -> list[tuple[str, Sequence[str]]]:
        """The action values that expressions of a timestep read, with their components: variables, and the
        action as the agent gave it."""
        return [*(v for v in self.variables if self.uses(v[0])), *self.agent_action_read]

    @property
    def agent_action_read(self) -> list[tuple[str, Sequence[str]]]:
        """The action as the agent gave it, if an expression of every timestep reads it."""
        return (
            [("previous_action", self._components["previous_action"])] if self.uses("previous_action") else []
        )

    def uses(self, name: str) -> bool:
        """Return whether an expression of every timestep, or a script after it, reads the named value."""
        return name in self._used

    def local(self, name: str) -> str:
        """Return the local variable with a named value during a timestep."""
        return self.names(name)

    # Of each of several agents

    def agents_that_use(self, *words: str) -> list[str]:
        """Return the agents of which an expression reads one of these values, such as `previous_reward`."""
        return [
            agent
            for agent in self.scenario.members
            if any(self.uses(qualified_name(agent, word)) for word in words)
        ]

    def reward_of(self, agent: str) -> str:
        """Return the attribute with the last reward of an agent."""
        return self.attribute(self.names.identifier(f"reward of {agent}", "reward", agent))

    def previous_reward_of(self, agent: str) -> str:
        """Return the attribute with the reward of an agent in the step before."""
        return self.attribute(self.names.identifier(f"previous reward of {agent}", PREVIOUS_REWARD, agent))

    def last_rewards(self) -> dict[str, str]:
        """Return the code of the reward of the last timestep, by the name that means it after the
        timestep."""
        of_agents = {
            qualified_name(agent, PREVIOUS_REWARD): self.reward_of(agent)
            for agent in self.agents_that_use(PREVIOUS_REWARD)
        }
        return {PREVIOUS_REWARD: "self.reward", **of_agents}

    @property
    def agents_alone(self) -> list[str]:
        """Those among several agents whose episode may end while others go on."""
        return [name for name, member in self.scenario.members.items() if member.alone]

    def ended_of(self, agent: str) -> str:
        """Return the attribute that is true from the end of the episode of an agent on."""
        return self.attribute(self.names.identifier(f"ended {agent}", ENDED, agent))

    def acts(self, agent: str) -> str:
        """Return the local that is true if an agent takes part in a timestep."""
        return self.names.identifier(f"acts {agent}", agent, "acts")

    def return_of(self, agent: str) -> str:
        """Return the attribute with the return of an agent."""
        return self.attribute(self.names.identifier(f"return of {agent}", EPISODE_RETURN, agent))

    def parameter(self, name: str) -> str:
        """Return the attribute with a drawn parameter."""
        return self.attribute(self.names.identifier(f"parameter {name}", "parameter", name))

    def present_count(self, group: str) -> str:
        """Return the attribute that counts the copies of a group that take part in the episode."""
        return self.attribute(self.names.identifier(f"present {group}", "present", group))

    def attribute(self, name: str) -> str:
        """Return the code of an attribute with a drawn value, or a value of the timestep before."""
        self.state[name] = None
        return f"self.{name}"

    def sent_names(self) -> list[str]:
        """Return the locals of one timestep that the messages of the next one contain: signals, and fields
        that robots sent."""
        names = self.names_read(self.sent)
        return [self.local(name) for name in self._results() if name in names]

    def stored_names(self) -> list[str]:
        """Return the names of the values that a timestep stores: those in messages, in `stored_signals` and
        in scripts, with parts of the action."""
        sent = self.names_read(self.sent)
        read_names = self.names_read(self._asked)
        if self.target is SCALAR:
            read_names |= self.scenario.stored_signals
        acted = [name for name, _ in (*self.variables, *self.agent_action_read) if name in read_names]
        ended = [
            name
            for name in (*(ending.name for ending in self.scenario.endings), *_GOAL)
            if name in read_names
        ]
        return [*(name for name in self._results() if name in sent or name in read_names), *acted, *ended]

    def storing_statements(self) -> list[str]:
        """Return statements that store the values of this timestep that the next message to a robot, or a
        script, uses."""
        return [
            f"{self.attribute(generated.last(local))} = {local}"
            for local in map(self.local, self.stored_names())
        ]

    def _results(self) -> list[str]:
        """Return the results of a timestep: signals, and the fields that robots sent."""
        sent = (f"{robot.name}.{entry.name}" for robot in self.scenario.robots for entry in robot.emitted)
        heard = (f"{link.receiver}.{value.name}" for link in self.scenario.links for value in link.values)
        return [*(entry.name for entry in self.scenario.signals), *sent, *heard]

    def names_read(self, expressions: Iterable[Scalar]) -> set[str]:
        """Return the names that expressions read, with the fields that carry the ages of readings."""
        nodes = [node for value in expressions for node in walk(value)]
        subjects = {
            node.subjects[0] for node in nodes if isinstance(node, EngineRead) and node.function == "age"
        }
        return {node.name for node in nodes if isinstance(node, Name)} | {
            self._ages[subject] for subject in subjects if subject in self._ages
        }

    def of_one_world(self) -> SupervisorPrinter:
        """Return the printer of code that runs in one world."""
        # The names stay shared: a batch takes its columns from attributes of the same names in single worlds.
        printer = copy(self)
        printer.target = SCALAR
        printer.state = {}
        return printer

    def printer(self) -> Printer:
        return Printer(self, settable=self.settable)

    # Meanings of the names in expressions

    def scalar(self, leaf: Name | EngineRead, needs: ReaderKeys) -> str:
        if isinstance(leaf, EngineRead):
            if leaf.function == "present":
                group, _, count = leaf.subjects[0].partition("#")
                return f"({self.present_count(group)} >= {count})"
            return (
                self._channel_value(leaf)
                if leaf.function in CHANNEL_VALUES
                else self.readers.code(leaf, needs)
            )
        match leaf.name:
            case "time":
                return f"({self.tick} * {self.scenario.world.timestep!r})"
            case "step":
                return "self.step_count"
            case "episode_return":
                return "self.episode_return"
            case "previous_reward":
                return "self.previous_reward" if self.repeats_actions else "self.reward"
        if leaf.name in self._results_of_agents:
            agent, word = self._results_of_agents[leaf.name]
            if word == EPISODE_RETURN:
                return self.return_of(agent)
            return self.previous_reward_of(agent) if self.repeats_actions else self.reward_of(agent)
        if leaf.component is None:
            return self._whole(leaf.name)
        components = self._parameters.get(leaf.name) or self._components[leaf.name]
        return f"{self._whole(leaf.name)}[{components.index(leaf.component)}]"

    def vector(self, leaves: Sequence[Name]) -> str | None:
        return whole_vector(leaves, self._parameters | self._components, self._whole)

    def _whole(self, name: str) -> str:
        return self.parameter(name) if name in self._parameters else self.local(name)

    def _channel_value(self, leaf: EngineRead) -> str:
        """Return values of the channel of a robot: the age of the message that the supervisor uses, and
        whether it arrived in this timestep."""
        name = leaf.subjects[0]
        if leaf.function == "age" and name in self._ages:
            return (
                f"({self._channel_value(EngineRead('age', (name.partition('.')[0],)))} +"
                f" {self.local(self._ages[name])})"
            )
        robot = next(robot for robot in self.scenario.robots if robot.name == name.partition(".")[0])
        if self.scenario.format != "none" and not robot.from_route.perfect:
            return f"self.{generated.channel(robot.name, 'from_robot')}.{leaf.function}"
        late = self.scenario.format != "none" and self.scenario.timing == "delayed"
        if leaf.function == "message_received":
            # A late message of the start is the first one, and the next one arrives in the second timestep.
            return f"({self.tick} != 1)" if late else "True"
        return f"({self.scenario.world.timestep!r} * ({self.tick} > 0))" if late else "0.0"


def whole_vector(
    leaves: Sequence[Name], components: Mapping[str, Sequence[str]], code: Callable[[str], str]
) -> str | None:
    """Return the code of a vector that is read as a whole, or of a slice of it; None for components that are
    no row of one vector."""
    first = leaves[0]
    names = list(components.get(first.name, ()))
    if (
        first.component is None
        or any(leaf.name != first.name for leaf in leaves)
        or first.component not in names
    ):
        return None
    start = names.index(first.component)
    if [leaf.component for leaf in leaves] != names[start : start + len(leaves)]:
        return None
    vector_code = code(first.name)
    return vector_code if len(leaves) == len(names) else f"{vector_code}[{start}:{start + len(leaves)}]"


def zeros(components: Sequence[str]) -> str:
    """Return the code of 0, once for each component."""
    if components:
        if len(components) == 1:
            return "(0.0,)"
        return f"(0.0,) * {len(components)}"
    return "0.0"

"""What all parts of the printed supervisor share: its scenario, the names in its code, and what it reads from the engine."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from copy import copy

from deepbots_cli.codegen.printer import Printer
from deepbots_cli.codegen.readers import ARRIVALS, Needs, Readers
from deepbots_cli.codegen.text import Constants, Names
from deepbots_cli.expressions.printer import SCALAR, Target
from deepbots_cli.expressions.scalar import Name, Scalar, World, is_drawn, names_in, walk
from deepbots_cli.program import Program
from deepbots_cli.program.robots import Direction, Robot
from deepbots_cli.program.task import ActionRange, Choices, action_names

_GOAL = ("achieved", "desired", "goal_reached")


class Workspace:
    """One per printed supervisor.

    `evaluated` are the expressions of every timestep; `sent` are those of messages to robots, with values of the
    timestep before; `scripted` are those of hand-written policies and of tests, which are called between two steps.
    """

    def __init__(self, scenario: Program, constants: Constants, target: Target = SCALAR) -> None:
        self.scenario = scenario
        self.target = target
        self.of_message: dict[str, str] = {}
        """For a batch: statements that draw a value for each message, by the method that holds each."""
        self.names = Names()
        self.constants = constants
        self.memories: dict[str, str] = {}
        self.readers = Readers(self.names, constants, root_links(scenario), on_columns=target is not SCALAR)
        self.choices = [part for part in scenario.policy.action if isinstance(part, Choices)]
        self.ranges = [part for part in scenario.policy.action if isinstance(part, ActionRange)]
        evaluated: list[Scalar] = [value for entry in scenario.signals for value in entry.scalars]
        evaluated += [ending.value.scalar for ending in scenario.endings]
        evaluated += [term.scalar for term in scenario.policy.reward]
        evaluated += [value for entry in scenario.policy.observation for value in entry.value.scalars]
        conditions = [option.forbidden.scalar for part in self.choices for option in part.options if option.forbidden is not None]
        goal = scenario.policy.goal
        evaluated += [*conditions, *((*goal.achieved.scalars, *goal.targets) if goal is not None else ())]
        self.scripted = [value for script in scenario.policy.scripts for value in script.scalars]
        self.scripted += [value for test in scenario.tests for value in (*test.scalars, *test.compared)]
        self.sent = [value for robot in scenario.robots for entry in robot.received for value in entry.scalars]
        self.forbids = bool(conditions)
        """Whether an option of a choice may ever be forbidden."""
        self.settable = {id(value): full for entry in scenario.settable for full, value in entry.numbers if is_drawn(value)}
        self._used = {leaf.name for expression in (*evaluated, *self.scripted) for leaf in names_in(expression)}
        self._ages = {f"{robot.name}.{sensor}": f"{robot.name}.{field}" for robot in scenario.robots for sensor, field in robot.ages}
        self._parameters = {entry.name: entry.components for entry in scenario.parameters}
        self._components = {entry.name: entry.components for entry in scenario.signals}
        self._components |= {f"{robot.name}.{entry.name}": entry.components for robot in scenario.robots for entry in robot.emitted}
        self._components |= {part.name: part.components for part in self.ranges}
        self._components["previous_action"] = action_names(scenario.policy.action)
        if goal is not None:
            self._components |= dict.fromkeys(("achieved", "desired"), goal.components)

    @property
    def repeats(self) -> bool:
        """Whether a step of the agent has several timesteps, which are then a method of their own."""
        return self.scenario.action_repeat > 1

    @property
    def remembers(self) -> bool:
        """Whether the policy sees more than the numbers of the last step."""
        return self.scenario.policy.frame_stack > 1 or any(entry.history > 1 for entry in self.scenario.policy.observation)

    @property
    def shares(self) -> bool:
        """Whether this is the supervisor of one copy among several, whose world goes on for all of them at once."""
        return self.scenario.policy.copies is not None

    @property
    def tick(self) -> str:
        """Code that counts the timesteps of the episode."""
        return "self.timestep_count" if self.repeats else "self.step_count"

    def is_direct(self, robot: Robot, direction: Direction) -> bool:
        """Whether each message arrives in the timestep in which it is sent: `delayed` timing makes either direction a timestep longer."""
        route = robot.to_route if direction == "to_robot" else robot.from_route
        return self.scenario.format == "none" or (route.perfect and self.scenario.timing == "immediate")

    @property
    def variables(self) -> list[tuple[str, Sequence[str]]]:
        """The action variables, with their components."""
        parts = self.scenario.policy.action
        return [(name, ()) if isinstance(part, Choices) else (name, part.components) for part in parts for name in _variables(part)]

    @property
    def acting(self) -> list[tuple[str, Sequence[str]]]:
        """What the expressions of a timestep read of the action, with its components: variables, and what the agent itself gave."""
        return [*(v for v in self.variables if self.uses(v[0])), *self.given]

    @property
    def given(self) -> list[tuple[str, Sequence[str]]]:
        """What the agent itself gave, where an expression of every timestep reads it."""
        return [("previous_action", self._components["previous_action"])] if self.uses("previous_action") else []

    def uses(self, name: str) -> bool:
        """Whether an expression of every timestep, or a script after it, reads the named value."""
        return name in self._used

    def local(self, name: str) -> str:
        """The local variable that holds a named value during a timestep."""
        return self.names(name)

    def parameter(self, name: str) -> str:
        """The attribute that holds a drawn parameter."""
        return f"self.{self.names.called(f'parameter {name}', 'parameter', name)}"

    def present(self, group: str) -> str:
        """The attribute that counts the copies of a group that take part in the episode."""
        return f"self.{self.names.called(f'present {group}', 'present', group)}"

    def sent_names(self) -> list[str]:
        """Locals of one timestep that the messages of the next one contain: signals, and fields that robots sent."""
        named = self.named(self.sent)
        return [self.local(name) for name in self._results() if name in named]

    def kept_names(self) -> list[str]:
        """Names of the values that a timestep stores: those in messages, in `kept` and in scripts, with parts of the action."""
        sent, read = self.named(self.sent), {*self.named(self.scripted), *self.scenario.kept} if self.target is SCALAR else set()
        acted = [name for name, _ in (*self.variables, *self.given) if name in read]
        ended = [name for name in (*(ending.name for ending in self.scenario.endings), *_GOAL) if name in read]
        return [*(name for name in self._results() if name in sent or name in read), *acted, *ended]

    def storing_statements(self) -> list[str]:
        """Statements that store the values of this timestep that the next message to a robot, or a script, uses."""
        return [f"self.last_{local} = {local}" for local in map(self.local, self.kept_names())]

    def _results(self) -> list[str]:
        """What a timestep comes to: signals, and the fields that robots sent."""
        sent = (f"{robot.name}.{entry.name}" for robot in self.scenario.robots for entry in robot.emitted)
        return [*(entry.name for entry in self.scenario.signals), *sent]

    def named(self, expressions: Iterable[Scalar]) -> set[str]:
        """The names that expressions read, with the fields that carry the ages of readings."""
        nodes = [node for value in expressions for node in walk(value)]
        asked = {node.subjects[0] for node in nodes if isinstance(node, World) and node.function == "age"}
        return {node.name for node in nodes if isinstance(node, Name)} | {self._ages[subject] for subject in asked if subject in self._ages}

    def of_one_world(self) -> Workspace:
        """The same for code that runs in one world."""
        other = copy(self)
        other.target = SCALAR
        return other

    def printer(self) -> Printer:
        return Printer(self, settable=self.settable)

    # What the names in expressions mean

    def scalar(self, leaf: Name | World, needs: Needs) -> str:
        if isinstance(leaf, World):
            return self._fact(leaf, needs)
        match leaf.name:
            case "time":
                return f"({self.tick} * {self.scenario.world.timestep!r})"
            case "step":
                return "self.step_count"
            case "episode_return":
                return "self.episode_return"
            case "previous_reward":
                return "self.previous_reward" if self.repeats else "self.reward"
        if leaf.component is None:
            return self._whole(leaf.name)
        components = self._parameters.get(leaf.name) or self._components[leaf.name]
        return f"{self._whole(leaf.name)}[{components.index(leaf.component)}]"

    def vector(self, leaves: Sequence[Name]) -> str | None:
        return whole_vector(leaves, self._parameters | self._components, self._whole)

    def _whole(self, name: str) -> str:
        return self.parameter(name) if name in self._parameters else self.local(name)

    def _fact(self, leaf: World, needs: Needs) -> str:
        if leaf.function == "present":
            group, _, count = leaf.subjects[0].partition("#")
            return f"({self.present(group)} >= {count})"
        return self._arrival(leaf) if leaf.function in ARRIVALS else self.readers.code(leaf, needs)

    def _arrival(self, leaf: World) -> str:
        """Values of the channel of a robot: the age of the message that the supervisor uses, and whether it arrived in this timestep."""
        name = leaf.subjects[0]
        if leaf.function == "age" and name in self._ages:
            return f"({self._arrival(World('age', (name.partition('.')[0],)))} + {self.local(self._ages[name])})"
        robot = next(robot for robot in self.scenario.robots if robot.name == name.partition(".")[0])
        if self.scenario.format != "none" and not robot.from_route.perfect:
            return f"self.from_{robot.name}.{leaf.function}"
        if leaf.function == "message_received":
            return "True"
        late = self.scenario.format != "none" and self.scenario.timing == "delayed"
        return f"({self.scenario.world.timestep!r} if {self.tick} else 0.0)" if late else "0.0"


def whole_vector(leaves: Sequence[Name], components: Mapping[str, Sequence[str]], code: Callable[[str], str]) -> str | None:
    """The code of a vector that is read as a whole, or of a slice of it; None for components that are no row of one vector."""
    first = leaves[0]
    known = list(components.get(first.name, ()))
    if first.component is None or any(leaf.name != first.name for leaf in leaves) or first.component not in known:
        return None
    start = known.index(first.component)
    if [leaf.component for leaf in leaves] != known[start : start + len(leaves)]:
        return None
    whole = code(first.name)
    return whole if len(leaves) == len(known) else f"{whole}[{start}:{start + len(leaves)}]"


def zeros(components: Sequence[str]) -> str:
    """The code of 0, once for each component."""
    return ("(0.0,)" if len(components) == 1 else f"(0.0,) * {len(components)}") if components else "0.0"


def root_links(scenario: Program) -> dict[str, str]:
    return {body.name: f"{body.name}.{body.model.root}" for body in scenario.world.robots}


def _variables(part: Choices | ActionRange) -> tuple[str, ...]:
    return part.variables if isinstance(part, Choices) else (part.name,)

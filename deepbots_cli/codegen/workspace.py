"""What all parts of the printed supervisor share: its scenario, the names in its code, and what it reads from the engine."""

from __future__ import annotations

from collections.abc import Iterable

from deepbots_cli.codegen.names import Names
from deepbots_cli.codegen.printer import Printer
from deepbots_cli.codegen.reads import ARRIVALS, Reads
from deepbots_cli.codegen.text import action_variables, flat
from deepbots_cli.expressions.scalar import Name, Scalar, World, is_drawn, names_in, walk
from deepbots_cli.program import Program
from deepbots_cli.program.robots import Robot
from deepbots_cli.program.task import Choices, action_names


class Workspace:
    """One per printed supervisor.

    `evaluated` are the expressions of every tick; `sent` those of messages to robots, which tell of the
    tick before; `scripted` those of hand-written policies, which are asked between two steps.
    """

    def __init__(self, scenario: Program) -> None:
        self.scenario = scenario
        self.names = Names()
        self.evaluated: list[Scalar] = [value for entry in scenario.signals for value in entry.scalars]
        self.evaluated += [ending.value.scalar for ending in scenario.endings]
        self.evaluated += [term.scalar for term in scenario.reward]
        self.evaluated += [value for entry in scenario.observation for value in entry.value.scalars]
        choices = [part for part in scenario.action if isinstance(part, Choices)]
        self._conditions = [option.forbidden.scalar for part in choices for option in part.options if option.forbidden is not None]
        self.evaluated += self._conditions
        if scenario.goal is not None:
            self.evaluated += [*scenario.goal.achieved.scalars, *scenario.goal.targets]
        self.scripted = [value for script in scenario.scripts for value in script.scalars]
        self.sent = [value for robot in scenario.robots for entry in robot.received for value in entry.scalars]
        required = scenario.reset.require
        self.reads = Reads([*self.evaluated, *self.sent, *self.scripted, *([] if required is None else [required.scalar])], self.names)
        self.variables = [variable for part in scenario.action for variable in action_variables(part)]
        self._used = {leaf.name for expression in (*self.evaluated, *self.scripted) for leaf in names_in(expression)}
        self._ages = {f"{robot.name}.{sensor}": f"{robot.name}.{field}" for robot in scenario.robots for sensor, field in robot.ages}
        self._parameters = {entry.name for entry in scenario.parameters}
        self.settable = {id(value): full for entry in scenario.settable for full, value in entry.numbers if is_drawn(value)}

    @property
    def repeats(self) -> bool:
        """Whether a step of the agent has several ticks, which are then a method of their own."""
        return self.scenario.agent.repeat > 1

    @property
    def remembers(self) -> bool:
        """Whether the policy sees more than the numbers of the last step."""
        return self.scenario.agent.stack > 1 or any(entry.history > 1 for entry in self.scenario.observation)

    @property
    def taken(self) -> list[tuple[str, str]]:
        """What the agent itself gave, number by number, where an expression of every tick reads it."""
        return [("previous_action", name) for name in action_names(self.scenario.action)] if self.uses("previous_action") else []

    @property
    def forbids(self) -> bool:
        """Whether an option of a choice may ever be forbidden."""
        return bool(self._conditions)

    @property
    def shares(self) -> bool:
        """Whether this is the supervisor of one copy among several, whose world goes on for all of them at once."""
        return self.scenario.agent.each is not None

    @property
    def tick(self) -> str:
        """Code that counts the ticks of the episode."""
        return "self.tick_count" if self.repeats else "self.step_count"

    def delivers_in_ticks(self, robot: Robot) -> bool:
        """Whether a message to this robot may arrive in another tick than the one that follows its sending."""
        late = self.scenario.timing == "paper" and self.repeats
        return self.scenario.format != "none" and (late or not robot.to_route.perfect)

    def uses(self, name: str) -> bool:
        """Whether an expression of every tick, or a script after it, reads the named value."""
        return name in self._used

    def local(self, name: str, component: str | None = None) -> str:
        """The local variable that holds a named value during a tick."""
        return self.names(name, component)

    def parameter(self, name: str, component: str | None = None) -> str:
        """The attribute that holds a drawn parameter."""
        return f"self.{self.names('parameter', name, component)}"

    def present(self, group: str) -> str:
        """The attribute that counts the copies of a group that take part in the episode."""
        return f"self.{self.names('present', group)}"

    def told(self) -> list[str]:
        """Locals of one tick that the messages of the next one tell: signals, and fields that robots sent."""
        told = self.named(self.sent)
        return [self.local(*name) for name in self._results() if name in told]

    def kept(self) -> list[tuple[str, str | None]]:
        """Names and components of what a tick keeps: that, and what scripts read of the tick and of the action before it."""
        told, read = self.named(self.sent), self.named(self.scripted)
        acted = [name for name in (*self.variables, *self.taken) if name in read]
        return [*(name for name in self._results() if name in told or name in read), *acted]

    def _results(self) -> list[tuple[str, str | None]]:
        """What a tick comes to: signals, and the fields that robots sent."""
        sent = ((f"{robot.name}.{name}", component) for robot in self.scenario.robots for name, component in flat(robot.emitted))
        return [*flat(self.scenario.signals), *sent]

    def named(self, expressions: Iterable[Scalar]) -> set[tuple[str, str | None]]:
        """The names that expressions read, with the fields that carry the ages of readings."""
        nodes = [node for value in expressions for node in walk(value)]
        found = {(node.name, node.component) for node in nodes if isinstance(node, Name)}
        asked = {node.subjects[0] for node in nodes if isinstance(node, World) and node.function == "age"}
        return found | {(self._ages[subject], None) for subject in asked if subject in self._ages}

    def printer(self, *, starting: bool = False, between: bool = False) -> Printer:
        """One for a method that runs in a tick: the first one (`starting`), any other, or `between` two steps."""
        resolve = self._resolve_between if between else self._resolve
        return Printer(resolve, self.names, self.scenario.world.timestep, starting=starting, settable=self.settable)

    def _resolve_between(self, leaf: Name | World) -> str:
        """Between two steps the reward of the last one is known."""
        return "self.reward" if leaf == Name("previous_reward") else self._resolve(leaf)

    def _resolve(self, leaf: Name | World) -> str:
        if isinstance(leaf, World):
            return self.fact(leaf)
        if leaf.name == "time":
            return f"({self.tick} * {self.scenario.world.timestep!r})"
        if leaf.name == "step":
            return "self.step_count"
        if leaf.name == "episode_return":
            return "self.episode_return"
        if leaf.name == "previous_reward":
            return "self.previous_reward" if self.repeats else "self.reward"
        if leaf.name in self._parameters:
            return self.parameter(leaf.name, leaf.component)
        return self.names(leaf.name, leaf.component)

    def fact(self, leaf: World) -> str:
        """The code of something that the world tells, after its reader was called."""
        if leaf.function == "present":
            group, _, number = leaf.subjects[0].partition("#")
            return f"({self.present(group)} >= {number})"
        return self._arrival(leaf) if leaf.function in ARRIVALS else self.reads.code(leaf)

    def _arrival(self, leaf: World) -> str:
        """What the channel of a robot tells: how old the message is that the supervisor goes by, and whether it came in this tick."""
        name = leaf.subjects[0]
        if leaf.function == "age" and name in self._ages:
            return f"({self._arrival(World('age', (name.partition('.')[0],)))} + {self.local(self._ages[name])})"
        robot = next(robot for robot in self.scenario.robots if robot.name == name.partition(".")[0])
        if self.scenario.format != "none" and not robot.from_route.perfect:
            return f"self.from_{robot.name}.{leaf.function}"
        if leaf.function == "fresh":
            return "True"
        late = self.scenario.format != "none" and self.scenario.timing == "paper"
        return f"({self.scenario.world.timestep!r} if {self.tick} else 0.0)" if late else "0.0"

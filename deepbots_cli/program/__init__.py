"""The checked scenario: one structure from the linter to the engine.

    Program
    ├── world                 timestep, ground, arena, robots as data, objects: the input of an engine
    ├── robots                controllers: sensors, emitted values, commands, message layouts, routes
    ├── parameters            values drawn per episode or more often (fixed ones are folded)
    ├── signals               augmentation and signals, in order of evaluation
    ├── agent                 robots, action, observation, goal, reward, success, scripts, training
    ├── action_repeat         control ticks in one step, for which each action is held
    ├── endings, truncation   the ends of an episode
    ├── reset, disturbances   the start of an episode, its variations and disturbances
    ├── evaluation
    ├── cases, curriculum     a complete program for each case and each stage of the curriculum
    └── levels                the levels of a curriculum in which each world has its own

values.py        Expression, the leaf of all of these
world.py         the input of an engine
robots.py        sensors, actuators, messages, controllers
task.py          agent, endings, training, evaluation, levels of a curriculum
resets.py        placements, randomized parameters; the draws of a reset, by name
identity.py      canonical JSON, digests, interfaces; what a value is made of; readings that a policy needs
topics.py        sensors and commands as fields of ROS 2 messages
generated.py     the names in the code that is generated from it

Everything is frozen, in SI units, and free of YAML and of any engine. Rules read the typed tree and the place
of an expression (`.typed`, `.span`), generated code its scalar trees (`.scalars`), which are made on first
use. `identity` writes a program as canonical JSON, whose digest identifies the scenario.

The program of all agents has a single agent, whose action, observation and reward are those of the agents in
a row, under the names `hunter__gas` of `gas` of the agent `hunter`. One supervisor therefore steps the world
once, and computes shared signals once. Each member has a program of its own, in which the robots of the other
agents have no controllers.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

from deepbots_cli.diagnostics.nearest import did_you_mean
from deepbots_cli.engine_kinds import DEFAULT_ENGINE
from deepbots_cli.errors import UsageError
from deepbots_cli.expressions.scalar import Name, Scalar, is_drawn, renamed
from deepbots_cli.program.resets import Disturbance, EpisodeDraws, Reset
from deepbots_cli.program.robots import Direction, Link, Robot, Timing
from deepbots_cli.program.task import (
    Agent,
    Choices,
    Criterion,
    Evaluation,
    Levels,
    ScenarioTest,
    Script,
    Truncation,
)
from deepbots_cli.program.values import Expression, Foreign, NamedScalars
from deepbots_cli.program.world import WorldModel
from deepbots_cli.records import dataclass

if TYPE_CHECKING:
    from deepbots_robot.topics import Topic


@dataclass(frozen=True, eq=False)
class Program:
    """A checked scenario, ready to be printed as Python and run.

    A field belongs to an agent if a second agent would need its own. All other fields are shared by all
    agents:

    - the world and the robots;
    - parameters and signals, which form one namespace;
    - the episode: reset, endings, truncation, and the `action_repeat`. A world is reset and stepped as a
      whole.

    `engine` is the engine that the scenario names, None for the default.
    `stored_signals` names the signals that the supervisor stores after each step, as `last_NAME`; only
    programs of `insight`, which explains episodes, have any. The compiler returns no `tests`: `deepbots test`
    adds those whose conditions the generated code computes. `supplied_by` has the supplier of each reading of
    the world for a real robot. `ros` has the topics of sensors and commands that the scenario names. `levels`
    is the curriculum of a level for each world, None without one.

    If the scenario has several agents, `members` has the program of each by name, and `agent` drives all
    robots: it has the actions, observations and rewards of all of them in a row. The program of one of them
    has the `others`, who act by themselves.
    `links` are the messages from robot to robot.
    """

    name: str
    summary: str
    language: int
    world: WorldModel
    robots: tuple[Robot, ...]
    format: str
    timing: Timing
    parameters: tuple[Expression, ...]
    signals: tuple[Expression, ...]
    agent: Agent
    endings: tuple[Expression, ...]
    truncation: Truncation
    reset: Reset
    action_repeat: int = 1
    evaluation: Evaluation = Evaluation()
    cases: tuple[EvaluationCase, ...] = ()
    curriculum: tuple[CurriculumStage, ...] = ()
    disturbances: tuple[Disturbance, ...] = ()
    engine: str | None = None
    stored_signals: frozenset[str] = frozenset()
    supplied_by: tuple[tuple[str, str], ...] = ()
    tests: tuple[ScenarioTest, ...] = ()
    ros: Mapping[str, Topic] = field(default_factory=dict)
    levels: Levels | None = None
    members: Mapping[str, Member] = field(default_factory=dict)
    others: Others | None = None
    links: tuple[Link, ...] = ()

    def digest_fields(self) -> dict[str, object]:
        """Return the fields that count for the digest. `agent` is in a mapping, as when the first digests
        were written."""
        left_out = {"agent", "ros", "stored_signals", "supplied_by", "tests"}
        # A later field counts only where a scenario uses it, so that older runs keep their digests.
        left_out |= {"engine"} if self.engine in (None, DEFAULT_ENGINE) else set()
        left_out |= {name for name in ("levels", "links", "members", "others") if not getattr(self, name)}
        counted = {
            name: value
            for name, value in vars(self).items()
            if name in self.__dataclass_fields__ and name not in left_out
        }
        return {**counted, "agents": {self.agent.name: self.agent}}

    @property
    def has_rivals(self) -> bool:
        """Whether several agents act that have no success in common."""
        return bool(self.members) and not self.defines_success

    @property
    def is_symmetric(self) -> bool:
        """Whether there are two agents, one of which mirrors the other, and each has as many successes and
        failures as the other."""
        if len(self.members) != 2:
            return False
        first, second = self.members.values()
        outcomes = [
            (len(member.program.agent.success), len(member.program.failures))
            for member in self.members.values()
        ]
        return second.names.mirrors == first.name and outcomes[0] == outcomes[1]

    @property
    def scripted_rivals(self) -> tuple[str, ...]:
        """The scripts against which the agents train by self-play."""
        training = self.agent.training
        of_agents = () if training is None else training.agents
        if not any(
            agent_training.self_play is not None and agent_training.self_play.scripts
            for _, agent_training in of_agents
        ):
            return ()
        return tuple(script.name for script in self.agent.scripts)

    def with_agent(self, **changes: Any) -> Program:
        """Return the program with fields of its agent changed."""
        return replace(self, agent=replace(self.agent, **changes))

    @cached_property
    def with_critic(self) -> Program:
        """The program of the worlds of a training: the observation has the values of the critic at its
        end."""
        if not self.agent.critic:
            return self
        agent = self.agent.with_critic
        if self.others is not None:
            return replace(self, agent=agent, others=self.others.with_critic)
        programs = {name: member.program.with_critic for name, member in self.members.items()}
        return self._with_members(agent, programs)

    def with_critic_of(self, name: str) -> Program:
        """Return the program of all agents in which only one of them has the values of its critic, too."""
        member = self.members[name]
        names = {qualified_name(name, entry.name) for entry in member.program.agent.critic}
        entries = tuple(entry for entry in self.agent.critic if entry.name in names)
        agent = replace(self.agent, critic=entries).with_critic
        programs = {key: entry.program for key, entry in self.members.items()}
        return self._with_members(agent, programs | {name: member.program.with_critic})

    def _with_members(self, agent: Agent, programs: Mapping[str, Program]) -> Program:
        """Return the program of all agents with other observations, given the agent of all and the program of
        each."""
        names = {name: member.names for name, member in self.members.items()}
        members = members_of(programs, names, agent)
        shared = {name: replace(member, policy=self.members[name].policy) for name, member in members.items()}
        return replace(self, agent=agent, members=shared)

    def is_direct(self, robot: Robot, direction: Direction) -> bool:
        """Return whether each message arrives in the timestep in which it is sent: `delayed` timing makes
        either direction a timestep longer."""
        route = robot.to_route if direction == "to_robot" else robot.from_route
        return self.format == "none" or (route.perfect and self.timing == "immediate")

    @property
    def python_functions(self) -> tuple[Foreign, ...]:
        """The functions of installed packages that rewards and endings call."""
        expressions = (*self.agent.reward, *self.endings)
        return tuple(value.foreign for value in expressions if value.foreign is not None)

    @property
    def computed_expressions(self) -> Iterator[Expression]:
        """The expressions of a step: conditions of choices, signals, observation, reward, endings, goal,
        scripts, messages."""
        for part in self.agent.action:
            if isinstance(part, Choices):
                yield from (option.forbidden for option in part.options if option.forbidden is not None)
        yield from self.signals
        yield from (entry.value for entry in self.agent.observation)
        yield from self.agent.reward
        yield from self.endings
        if self.agent.goal is not None:
            yield from (self.agent.goal.achieved, self.agent.goal.desired)
        for script in self.agent.scripts:
            for decided in script.parts:
                yield from decided.values
        for robot in self.robots:
            yield from robot.receive

    @property
    def settable_draws(self) -> tuple[NamedScalars, ...]:
        """Draws with a name, which `options` of `reset` may set: parameters, places and joints."""
        parameter_draws = (
            NamedScalars(value.name, value.components, value.scalars)
            for value in self.parameters
            if any(map(is_drawn, value.scalars))
        )
        return (*parameter_draws, *self.reset.drawn)

    @cached_property
    def draws(self) -> EpisodeDraws:
        """The draws of a reset."""
        return EpisodeDraws(self)

    @property
    def period(self) -> float:
        """Simulated time of one step, in s."""
        return self.world.timestep * self.action_repeat

    @property
    def successes(self) -> tuple[Expression, ...]:
        """The endings that are a success of the agent."""
        return tuple(ending for ending in self.endings if ending.name in self.agent.success)

    @cached_property
    def failures(self) -> frozenset[str]:
        """The names of the endings that are failures of the agent."""
        return frozenset(ending.name for ending in self.endings) - {*self.agent.success}

    @property
    def defines_success(self) -> bool:
        """Whether an episode can be a success at all."""
        return self.agent.goal is not None or bool(self.agent.success)

    def evaluation_episodes(self, case: str | None = None) -> int:
        """Return the number of episodes of an evaluation, or of a case of it.

        An evaluation has at least as many as `solved` requires.

        Raises:
            UsageError: There is no such case.
        """
        if case is not None:
            return self.case(case).episodes
        return max(
            self.evaluation.episodes, self.agent.solved.episodes if self.agent.solved is not None else 0
        )

    def case(self, name: str) -> EvaluationCase:
        """Return the case of the evaluation with that name.

        Raises:
            UsageError: There is none; the message lists the cases.
        """
        return self._named("case", name, self.cases)

    def stage(self, name: str) -> CurriculumStage:
        """Return the stage of the curriculum with that name."""
        return self._named("stage", name, self.curriculum)

    def variant(self, case: str | None, stage: str | None) -> Program:
        """Return the scenario with the settings of a case or of a stage; the scenario itself without either.

        Raises:
            UsageError: Both are given, or there is no such case or stage.
        """
        if case is not None and stage is not None:
            raise UsageError("a case and a stage cannot be combined")
        if case is not None:
            return self.case(case).program
        if stage is not None:
            return self.stage(stage).program
        return self

    @property
    def versions(self) -> dict[str, Program]:
        """The scenario itself, under the name "", and with the settings of each case and of each stage, by
        names for a sentence, such as "case `far`"."""
        cases = {f"case `{case.name}`": case.program for case in self.cases}
        return {"": self, **cases, **{f"stage `{stage.name}`": stage.program for stage in self.curriculum}}

    def script(self, name: str) -> Script:
        """Return the script with that name."""
        return self._named("script", name, self.agent.scripts)

    def _named(self, noun: str, name: str, entries: Sequence[Entry]) -> Entry:
        match = next((entry for entry in entries if entry.name == name), None)
        if match is None:
            names = [entry.name for entry in entries]
            if not names:
                raise UsageError(f"{self.name} has no {noun}s, so there is no '{name}'")
            hint = did_you_mean(name, names)
            raise UsageError(f"{self.name} has no {noun} '{name}'{hint}; there are: {', '.join(names)}")
        return match


@dataclass(frozen=True, eq=False)
class EvaluationCase:
    """The scenario under other conditions, to evaluate a policy in; `program` has neither cases nor
    stages."""

    name: str
    episodes: int
    program: Program


@dataclass(frozen=True, eq=False)
class CurriculumStage:
    """The scenario as it is while a stage of the curriculum lasts: until its criterion is met, or to the end
    of the training."""

    name: str
    until: Criterion | None
    program: Program


Entry = TypeVar("Entry", EvaluationCase, CurriculumStage, Script)


# Several agents


RANDOM, ZERO = "random", "zero"
"""Drivers of an agent besides its scripts."""
SEPARATOR = "__"

PREVIOUS_REWARD, EPISODE_RETURN = "previous_reward", "episode_return"
"""Values of an agent itself: they are made of its own reward terms."""
TERMINATED, ENDED = "terminated", "ended"
"""Values of an agent itself if its episode may end while others go on."""
_OWN_SECTIONS = frozenset({"action", "augment", "critic", "observation", "reward", "scripts"})
_SIGNALS = "signals"


def qualified_name(agent: str, name: str) -> str:
    """Return the name of something of an agent in the program of all agents."""
    return f"{agent}{SEPARATOR}{name}"


@dataclass(frozen=True)
class MemberNames:
    """The names of an agent in the program of all agents.

    Attributes:
        agent: The name of the agent.
        signals: Its own signals; signals of the file are the same for all agents.
        qualified: The names of its action variables and its own signals, and what they are called there.
        previous: The names of the numbers of its last action, and what they are called there.
        mirrors: The agent that it mirrors.
        ends_alone: Whether its episode may end while those of other agents go on.
    """

    agent: str
    signals: frozenset[str]
    qualified: Mapping[str, str]
    previous: Mapping[str, str]
    mirrors: str | None = None
    ends_alone: bool = False

    def scalars(self, scalars: Iterable[Scalar]) -> tuple[Scalar, ...]:
        return tuple(renamed(scalar, self._name, self._slot) for scalar in scalars)

    def expression(self, value: Expression, *, of_agent: bool) -> Expression:
        """Return a value with the names of the program of all; its own name is that of a value of the
        agent (`of_agent`), or one that all agents share."""
        noise = value.noise
        return replace(
            value,
            name=qualified_name(self.agent, value.name) if of_agent else value.name,
            owner=self._owner(value.owner),
            lowered=None if value.foreign is not None else self.scalars(value.scalars),
            noise=None if noise is None else replace(noise, std=self.expression(noise.std, of_agent=False)),
        )

    def signal(self, value: Expression) -> Expression:
        return self.expression(value, of_agent=value.name in self.signals)

    def _name(self, name: Name) -> Name:
        if name.name == "previous_action":
            return name._replace(component=self.previous[name.component or next(iter(self.previous))])
        of_agent = (PREVIOUS_REWARD, EPISODE_RETURN, *((TERMINATED, ENDED) if self.ends_alone else ()))
        if name.name in of_agent:
            return name._replace(name=qualified_name(self.agent, name.name))
        return name._replace(name=self.qualified.get(name.name, name.name))

    def _slot(self, slot: str) -> str:
        """Return the name of the memory or the stream of a value of the agent."""
        owner, mark, number = slot.partition("#")
        return f"{self._owner(owner)}{mark}{number}"

    def _owner(self, owner: str) -> str:
        section, _, name = owner.partition(".")
        is_own = section in _OWN_SECTIONS or (section == _SIGNALS and name.partition(".")[0] in self.signals)
        return f"agents.{self.agent}.{owner}" if is_own else owner


class AgentEnding(NamedTuple):
    """The end of the episode of one of several agents, while those of others went on: the endings that held,
    whether it was a success, and its last step."""

    endings: tuple[str, ...]
    is_success: bool
    step: int


@dataclass(frozen=True, eq=False)
class Member:
    """One of several agents.

    Attributes:
        name: Its name under `agents`.
        names: Its names in the program of all agents.
        program: The scenario as this agent has it: with its own action, observation, reward and training, and
            with the endings as they are for it.
        columns: The places of the numbers that it sees, among the numbers that all agents see.
        choices: The first choice of its action among those of all agents, and the one after its last.
        ranges: The first number of its ranges among those of all agents, and the one after its last.
        terms: The names of its reward terms in the program of all agents, by their own names.
        alone: The names of the endings that end its episode, while those of other agents go on.
        policy: The agent whose policy it has; None if it has one of its own.
    """

    name: str
    names: MemberNames
    program: Program
    columns: tuple[int, ...]
    choices: tuple[int, int]
    ranges: tuple[int, int]
    terms: Mapping[str, str]
    alone: frozenset[str] = frozenset()
    policy: str | None = None

    def reward(self, terms: Mapping[str, float]) -> float:
        """Return its reward, given the last value of each term of all agents."""
        return sum(map(terms.__getitem__, self.terms.values()))

    @property
    def defines_success(self) -> bool:
        """Whether an ending is a success of the agent."""
        return bool(self.program.agent.success)

    def has_succeeded(self, endings: Sequence[str]) -> bool:
        """Return whether an episode that these endings ended is a success for the agent: failure has
        precedence."""
        if not endings:
            return False
        success = self.program.agent.success
        return any(name in success for name in endings) and self.program.failures.isdisjoint(endings)

    def digest_fields(self) -> dict[str, object]:
        shared = {} if self.policy is None else {"policy": self.policy}
        return {"name": self.name, "program": self.program, **shared}


@dataclass(frozen=True, eq=False)
class Others:
    """The agents beside the one that a program is about.

    Attributes:
        world: The program of all agents.
        agent: The name of the agent that the program is about.
        drivers: Who acts for each other agent: the name of one of its scripts, `random` or `zero`, or the
            digest of a model.
        models: The files of the models that act for other agents.
    """

    world: Program
    agent: str
    drivers: Mapping[str, str]
    models: Mapping[str, Path] = field(default_factory=dict)

    @property
    def scripts(self) -> tuple[str, ...]:
        """The scripts that act for other agents, by their names in the program of all agents."""
        return tuple(
            qualified_name(name, driver)
            for name, driver in self.drivers.items()
            if driver not in (RANDOM, ZERO) and name not in self.models
        )

    @property
    def with_critic(self) -> Others:
        """The same agents in the worlds of a training, which compute what the critic of the agent sees."""
        return replace(self, world=self.world.with_critic_of(self.agent))

    @property
    def text(self) -> str:
        """Who acts for each other agent, such as `prey (flee)`."""
        return ", ".join(f"{name} ({self.models.get(name, driver)})" for name, driver in self.drivers.items())

    def digest_fields(self) -> dict[str, object]:
        return {"world": self.world, "agent": self.agent, "drivers": tuple(sorted(self.drivers.items()))}


def world_of(program: Program, others: Others) -> Program:
    """Return the program of all agents, which also computes the signals and tests that `program`, that of one
    agent, has in addition to those of the scenario."""
    member = others.world.members[others.agent]
    usual = {signal.name for signal in member.program.signals}
    further = [member.names.signal(signal) for signal in program.signals if signal.name not in usual]
    return replace(
        others.world,
        signals=(*others.world.signals, *further),
        stored_signals=frozenset(member.names.qualified.get(name, name) for name in program.stored_signals),
        engine=program.engine,
    )


def endings_alone(agent: str, programs: Mapping[str, Program]) -> frozenset[str]:
    """Return the names of the endings of an agent that do not end the episode of all agents."""
    endings = {name: frozenset(e.name for e in program.endings) for name, program in programs.items()}
    return endings[agent].difference(frozenset.intersection(*endings.values()))


def members_of(
    programs: Mapping[str, Program], names: Mapping[str, MemberNames], combined: Agent
) -> dict[str, Member]:
    """Return the agents with these programs and names, given the agent of the program of all."""
    positions = {
        (number.name, number.component, age): position
        for position, (index, age) in enumerate(combined.seen)
        for number in (combined.numbers[index],)
    }
    members: dict[str, Member] = {}
    choices = ranges = 0
    for name, program in programs.items():
        agent = program.agent
        entries = [(agent.numbers[index], age) for index, age in agent.seen]
        last_choice, last_range = choices + len(agent.choices), ranges + len(agent.range_names)
        members[name] = Member(
            name,
            names[name],
            program,
            tuple(
                positions[qualified_name(name, number.name), number.component, age] for number, age in entries
            ),
            (choices, last_choice),
            (ranges, last_range),
            {term.name: qualified_name(name, term.name) for term in agent.reward},
            endings_alone(name, programs),
        )
        choices, ranges = last_choice, last_range
    return members

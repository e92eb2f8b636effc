"""The agents of a scenario with several of them, and where the program of all has the parts of each agent.

The program of all agents has a single agent, whose action, observation and reward are those of the agents in
a row, under the names `hunter__gas` of `gas` of the agent `hunter`. One supervisor therefore steps the world
once, and computes shared signals once. Each member has a program of its own, in which the robots of the other
agents have no controllers.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from deepbots_cli.expressions.scalar import Name, Scalar, renamed
from deepbots_cli.program.task import Agent
from deepbots_cli.program.values import Expression

if TYPE_CHECKING:
    from deepbots_cli.program import Program

RANDOM, ZERO = "random", "zero"
"""Drivers of an agent besides its scripts."""
SEPARATOR = "__"

PREVIOUS_ACTION = "previous_action"
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
        if name.name == PREVIOUS_ACTION:
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

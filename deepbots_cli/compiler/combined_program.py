"""The program of several agents in one world, made of the programs of each of them.

Names that an agent defines itself (variables of its action, its signals, its reward terms, its scripts) get
the name of the agent before them. Everything else is the same for all agents.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import chain
from typing import TypeVar

from deepbots_cli.expressions.scalar import Const, Scalar, renamed
from deepbots_cli.program import Program
from deepbots_cli.program.members import MemberNames, endings_alone, members_of, qualified_name
from deepbots_cli.program.robots import Robot
from deepbots_cli.program.task import (
    ONLY_AGENT,
    ActionPart,
    ActionRange,
    Agent,
    Choices,
    Observation,
    Option,
    Script,
    ScriptedChoice,
    ScriptedRange,
    Solved,
    Training,
    action_names,
)
from deepbots_cli.program.values import Expression
from deepbots_cli.program.world import RobotBody
from deepbots_cli.scenario.agent import AgentOfSeveral

Named = TypeVar("Named", Robot, RobotBody)


def combined_program(
    programs: Mapping[str, Program],
    specs: Mapping[str, AgentOfSeveral],
    drivers: Mapping[str, str],
    mirrors: Mapping[str, str],
) -> Program:
    """Return the program of all agents.

    Args:
        programs: The program of each agent, by its name.
        specs: The sections of the agents.
        drivers: The agent that drives each robot; robots without one are the same in all programs.
        mirrors: The agent that another one mirrors exactly.
    """
    first = next(iter(programs.values()))

    def of_all(case: str | None, stage: str | None) -> Program:
        """Return the program of all agents in a case or a stage."""
        variants = {name: program.variant(case, stage) for name, program in programs.items()}
        return combined_program(variants, specs, drivers, mirrors)

    action = {
        name: [_action_part(name, part) for part in program.agent.action]
        for name, program in programs.items()
    }
    together = iter(action_names([*chain.from_iterable(action.values())]))
    names = {
        name: replace(
            _combined_names(name, program, specs[name], together, mirrors.get(name)),
            ends_alone=bool(endings_alone(name, programs)),
        )
        for name, program in programs.items()
    }
    renamings = {name: Renaming(program, names[name]) for name, program in programs.items()}
    agents = {name: renamings[name].agent(action[name]) for name in programs}
    combined = _combined_agent(agents)
    owners = {robot: programs[agent] for robot, agent in drivers.items()}
    bodies = (_named(owners.get(body.name, first).world.robots, body.name) for body in first.world.robots)
    program = replace(
        first,
        agent=combined,
        world=replace(first.world, robots=tuple(bodies)),
        robots=tuple(
            renamings[drivers[robot.name]].robot(_named(owners[robot.name].robots, robot.name))
            if robot.name in drivers
            else robot
            for robot in first.robots
        ),
        parameters=_united(program.parameters for program in programs.values()),
        signals=_united(renaming.signals() for renaming in renamings.values()),
        endings=_united(renaming.endings() for renaming in renamings.values()),
        reset=replace(
            first.reset,
            variations=tuple(
                {
                    (varied.what, varied.of, varied.value.owner): varied
                    for program in programs.values()
                    for varied in program.reset.variations
                }.values()
            ),
        ),
        supplied_by=tuple(
            dict(
                chain.from_iterable(agent_program.supplied_by for agent_program in programs.values())
            ).items()
        ),
        ros={name: topic for agent_program in programs.values() for name, topic in agent_program.ros.items()},
        cases=tuple(replace(case, program=of_all(case.name, None)) for case in first.cases),
        curriculum=tuple(replace(stage, program=of_all(None, stage.name)) for stage in first.curriculum),
    )
    members = members_of(programs, names, combined)
    shared = {name: replace(member, policy=specs[name].policy) for name, member in members.items()}
    return replace(program, members=shared)


def _combined_agent(agents: Mapping[str, Agent]) -> Agent:
    """Return the agent with the actions, observations and rewards of all in a row."""
    first = next(iter(agents.values()))
    success = tuple(name for name in first.success if all(name in agent.success for agent in agents.values()))
    combined = Agent(
        name=ONLY_AGENT,
        robots=tuple(chain.from_iterable(agent.robots for agent in agents.values())),
        action=tuple(chain.from_iterable(agent.action for agent in agents.values())),
        observation=tuple(chain.from_iterable(agent.observation for agent in agents.values())),
        reward=tuple(chain.from_iterable(agent.reward for agent in agents.values())),
        success=success,
        solved=_common_criterion(agents.values()) if success else None,
        training=_combined_training({name: agent.training for name, agent in agents.items()}),
        frame_stack=max(agent.frame_stack for agent in agents.values()),
        critic=tuple(chain.from_iterable(agent.critic for agent in agents.values())),
    )
    return replace(combined, scripts=tuple(_scripts(agents, combined.action)))


def _common_criterion(agents: Iterable[Agent]) -> Solved | None:
    """Return `solved` if it is a success rate that all agents have."""
    first, *other_criteria = (agent.solved for agent in agents)
    is_common = (
        first is not None
        and first.mean_return is None
        and all(criterion == first for criterion in other_criteria)
    )
    return first if is_common else None


def _combined_training(trainings: Mapping[str, Training | None]) -> Training | None:
    """Return the training of all agents in the same episodes; None if an agent has none."""
    of_agents = tuple((name, training) for name, training in trainings.items() if training is not None)
    if len(of_agents) < len(trainings):
        return None
    _, first = of_agents[0]
    algorithms = dict.fromkeys(training.algorithm for _, training in of_agents)
    return replace(
        first,
        algorithm="+".join(algorithms),
        hyperparameters=(),
        symmetry=None,
        patience=None,
        self_play=None,
        agents=of_agents,
    )


def _combined_names(
    agent: str, program: Program, spec: AgentOfSeveral, together: Iterator[str], mirrors: str | None
) -> MemberNames:
    """Return the names of an agent, which `mirrors` another one exactly.

    `together` yields the names of the numbers of the last action of all agents, from those of this agent on.
    """
    augmented = spec.augment if isinstance(spec.augment, Mapping) else {}
    signals = frozenset({*augmented, *spec.signals})
    variables = {name for part in program.agent.action for name in part.variables}
    return MemberNames(
        agent,
        signals,
        {name: qualified_name(agent, name) for name in sorted(variables | signals)},
        {name: next(together) for name in action_names(program.agent.action)},
        mirrors,
    )


class Renaming:
    """Gives the parts of one agent their names in the program of all."""

    def __init__(self, program: Program, names: MemberNames) -> None:
        self._program = program
        self._names = names

    def agent(self, action: Sequence[ActionPart]) -> Agent:
        """Return the agent with renamed parts; `action` has the names of the program of all."""
        agent = self._program.agent
        return replace(
            agent,
            action=tuple(
                replace(part, options=tuple(map(self._option, part.options)))
                if isinstance(part, Choices)
                else part
                for part in action
            ),
            observation=tuple(map(self._observation, agent.observation)),
            critic=tuple(map(self._observation, agent.critic)),
            reward=tuple(self._names.expression(term, of_agent=True) for term in agent.reward),
            scripts=tuple(
                Script(
                    qualified_name(self._names.agent, script.name), tuple(map(self._scripted, script.parts))
                )
                for script in agent.scripts
            ),
        )

    def signals(self) -> Iterator[Expression]:
        """Yield the signals: those of the agent renamed, shared ones as they are."""
        return map(self._names.signal, self._program.signals)

    def endings(self) -> Iterator[Expression]:
        """Yield the endings; one that ends the episode of this agent alone may use names of the agent."""
        return (self._names.expression(ending, of_agent=False) for ending in self._program.endings)

    def robot(self, robot: Robot) -> Robot:
        """Return a robot that the agent drives: its action variables have other names in its messages, and
        in its commands."""
        sent = {entry.name: self._names.qualified[entry.name] for entry in robot.variables}

        def in_robot(scalar: Scalar) -> Scalar:
            return renamed(scalar, lambda name: name._replace(name=sent.get(name.name, name.name)))

        return replace(
            robot,
            variables=tuple(replace(entry, name=sent[entry.name]) for entry in robot.variables),
            receive=tuple(
                replace(entry, lowered=self._names.scalars(entry.scalars)) for entry in robot.receive
            ),
            commands=tuple(
                replace(
                    command,
                    target=replace(command.target, lowered=tuple(map(in_robot, command.target.scalars))),
                )
                for command in robot.commands
            ),
        )

    def _observation(self, entry: Observation) -> Observation:
        noise = entry.noise
        return replace(
            entry,
            value=self._names.expression(entry.value, of_agent=True),
            noise=None
            if noise is None
            else replace(noise, std=self._names.expression(noise.std, of_agent=False)),
        )

    def _option(self, option: Option) -> Option:
        forbidden = option.forbidden
        return (
            option
            if forbidden is None
            else replace(option, forbidden=self._names.expression(forbidden, of_agent=False))
        )

    def _scripted(self, part: ScriptedChoice | ScriptedRange) -> ScriptedChoice | ScriptedRange:
        if isinstance(part, ScriptedRange):
            return replace(
                part, values=tuple(self._names.expression(value, of_agent=False) for value in part.values)
            )
        return replace(
            part,
            branches=tuple(
                (option, self._names.expression(condition, of_agent=False))
                for option, condition in part.branches
            ),
        )


def _action_part(agent: str, part: ActionPart) -> ActionPart:
    renamed = qualified_name(agent, part.name)
    if isinstance(part, ActionRange):
        return replace(part, name=renamed)
    return replace(
        part, name=renamed, variables=tuple(qualified_name(agent, variable) for variable in part.variables)
    )


def _named(entries: Iterable[Named], name: str) -> Named:
    return next(entry for entry in entries if entry.name == name)


def _united(several: Iterable[Iterable[Expression]]) -> tuple[Expression, ...]:
    """Return the values of all agents, each name once: a later one is made of earlier ones."""
    united: dict[str, Expression] = {}
    for value in chain.from_iterable(several):
        united.setdefault(value.name, value)
    return tuple(united.values())


def _scripts(agents: Mapping[str, Agent], action: Sequence[ActionPart]) -> Iterator[Script]:
    """Yield the scripts of all agents: each chooses the parts of its own agent, and the middle of every range
    and the first option of every choice of the others."""
    for agent in agents.values():
        part_names = {part.name for part in agent.action}
        for script in agent.scripts:
            parts = iter(script.parts)
            yield Script(
                script.name,
                tuple(
                    next(parts) if part.name in part_names else _idle(part, agent.reward[0])
                    for part in action
                ),
            )


def _idle(part: ActionPart, example: Expression) -> ScriptedChoice | ScriptedRange:
    """Return a decision that depends on nothing; `example` is any expression."""
    if isinstance(part, Choices):
        return ScriptedChoice((), part.options[0].name)
    middle = Const((part.low + part.high) / 2)
    value = replace(example, name="idle", text="", lowered=(middle,), foreign=None, noise=None)
    return ScriptedRange((value,), max(1, len(part.components)))

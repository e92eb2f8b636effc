"""Several agents in one world: the program of all of them, made of the programs of each, and their tests.

Names that an agent defines itself (variables of its action, its signals, its reward terms, its scripts) get
the name of the agent before them. Everything else is the same for all agents.

A test is about one agent, whose results it expects. It is compiled in the scenario of each agent, with the
driver or the actions of that agent there; the expectations are compiled in that of its own agent. The parts
are then combined to a test of the program of all agents.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import chain
from typing import TypeVar

from deepbots_cli.diagnostics import Findings
from deepbots_cli.document import Entry, MappingNode, Node, ScalarNode, SequenceNode
from deepbots_cli.document.load import TESTS
from deepbots_cli.document.nodes import entries_at, node_at
from deepbots_cli.expressions.scalar import Const, Scalar, renamed
from deepbots_cli.program import (
    RANDOM,
    ZERO,
    Member,
    MemberNames,
    Program,
    endings_alone,
    members_of,
    qualified_name,
)
from deepbots_cli.program.robots import Robot
from deepbots_cli.program.task import (
    ONLY_AGENT,
    ActionPart,
    ActionRange,
    Agent,
    Choices,
    FixedAction,
    Observation,
    Option,
    ScenarioTest,
    Script,
    ScriptedChoice,
    ScriptedRange,
    Solved,
    Training,
    action_names,
)
from deepbots_cli.program.values import Expression
from deepbots_cli.program.world import RobotBody
from deepbots_cli.scenario.fields import choices_help
from deepbots_cli.scenario.task import AgentOfSeveral

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


_AGENT = "agent"
_DRIVER = "driver"
_ACTIONS = "actions"
_EXPECT = "expect"
_PLACEHOLDER_EXPECTATION = "mean_return"
"""The key of an expectation that stands for those of another agent."""


class DividedTests:
    """The tests of a file, divided among its agents.

    Args:
        root: The file.
        scripts: The names of the scripts of each agent.
        findings: Takes names of agents and drivers that do not exist.
    """

    def __init__(self, root: MappingNode, scripts: Mapping[str, Sequence[str]], findings: Findings) -> None:
        self._written = entries_at(root, TESTS)
        self._scripts = scripts
        self._findings = findings
        self._agents = [*scripts]
        for entry in self._written.values():
            self._check(entry)

    def owner(self, test: str) -> str:
        """Return the agent that a test is about."""
        node = node_at(self._written[test].value, _AGENT)
        return node.text if isinstance(node, ScalarNode) else self._agents[0]

    def section_of(self, agent: str, section: Entry) -> Entry:
        """Return the section `tests` as it is for an agent."""
        assert isinstance(section.value, MappingNode)
        entries = {
            name: Entry(entry.key, self._part(name, agent, entry.key, entry.value))
            for name, entry in section.value.entries.items()
            if isinstance(entry.value, MappingNode)
        }
        return Entry(section.key, replace(section.value, entries=entries))

    def _part(self, test: str, agent: str, name: ScalarNode, test_node: MappingNode) -> MappingNode:
        entries = {key: entry for key, entry in test_node.entries.items() if key != _AGENT}
        if _DRIVER in entries:
            entries[_DRIVER] = Entry(entries[_DRIVER].key, self._driver(agent, test_node))
        elif _ACTIONS in entries:
            actions = [node_at(step, agent) for step in _steps(test_node)]
            first = next((item for item in actions if item is not None), None)
            key = entries.pop(_ACTIONS).key
            if first is None:
                entries[_DRIVER] = Entry(text_in_place_of(key, _DRIVER), text_in_place_of(key, ZERO))
            else:
                # Fills a step in which the agent has no action; `_combined_actions` replaces it by the
                # resting action.
                items = tuple(first if item is None else item for item in actions)
                entries[_ACTIONS] = Entry(key, SequenceNode(key.span, items))
        if agent != self.owner(test) and _EXPECT in entries:
            expected = {
                _PLACEHOLDER_EXPECTATION: Entry(
                    text_in_place_of(name, _PLACEHOLDER_EXPECTATION), name._replace(text="0", value=0)
                )
            }
            entries[_EXPECT] = Entry(entries[_EXPECT].key, MappingNode(name.span, expected))
        return replace(test_node, entries=entries)

    def _driver(self, agent: str, test_node: MappingNode) -> ScalarNode:
        """Return the driver of an agent: its script of the name that all agents share, else its first script,
        else `random`."""
        node = test_node.get(_DRIVER)
        scripts = self._scripts[agent]
        of_agent = node_at(node, agent)
        if isinstance(of_agent, ScalarNode):
            return of_agent
        if isinstance(node, ScalarNode) and node.text in (*scripts, RANDOM, ZERO):
            return node
        return text_in_place_of(test_node.entries[_DRIVER].key, next(iter(scripts), RANDOM))

    def _check(self, entry: Entry) -> None:
        if not isinstance(entry.value, MappingNode):
            return
        agent, driver = entry.value.get(_AGENT), entry.value.get(_DRIVER)
        keys = [step for step in (driver, *_steps(entry.value)) if isinstance(step, MappingNode)]
        names = [item.key for mapping in keys for item in mapping.entries.values()]
        names += [agent] if isinstance(agent, ScalarNode) else []
        self._report_unknown(names, "agent", self._agents)
        if isinstance(driver, ScalarNode):
            scripts = dict.fromkeys(
                name for agent_scripts in self._scripts.values() for name in agent_scripts
            )
            self._report_unknown([driver], "script", [*scripts, RANDOM, ZERO])
        for step in _steps(entry.value):
            if isinstance(step, ScalarNode):
                self._findings.add(
                    "DB103",
                    step.span,
                    "one action for several agents",
                    f"write `{{{', '.join(f'{name}: ...' for name in self._agents)}}}`",
                )

    def _report_unknown(self, nodes: Iterable[ScalarNode], noun: str, names: Sequence[str]) -> None:
        for node in nodes:
            if node.text not in names:
                report_unknown(self._findings, node, noun, names)

    def tests_of(self, agent: str, tests: Iterable[ScenarioTest]) -> tuple[ScenarioTest, ...]:
        """Return the tests that are about an agent."""
        return tuple(test for test in tests if self.owner(test.name) == agent)

    # The tests of all agents

    def combined(
        self, program: Program, tests: Mapping[str, Mapping[str, ScenarioTest]]
    ) -> Iterator[ScenarioTest]:
        """Yield the tests of the program of all agents, given those of each agent by name."""
        for name in self._written:
            owner = self.owner(name)
            parts = {agent: agent_tests[name] for agent, agent_tests in tests.items() if name in agent_tests}
            if len(parts) < len(self._agents):
                continue
            drivers = {agent: part.driver for agent, part in parts.items() if isinstance(part.driver, str)}
            combined = _with_combined_names(parts[owner], program.members[owner])
            if steps := _steps(self._written[name].value):
                actions = tuple(_combined_actions(program.members, parts, steps))
                yield replace(combined, driver=actions, steps=min(combined.steps, len(actions)))
            else:
                yield replace(combined, drivers=drivers)


def _with_combined_names(test: ScenarioTest, member: Member) -> ScenarioTest:
    """Return a test of one agent with the names of the program of all."""
    expected = tuple(
        replace(
            expectation,
            condition=None
            if expectation.condition is None
            else member.names.expression(expectation.condition, of_agent=False),
            compared=tuple(member.names.expression(value, of_agent=False) for value in expectation.compared),
        )
        for expectation in test.expected
    )
    return replace(test, expected=expected, agent=member.name)


def _combined_actions(
    members: Mapping[str, Member], parts: Mapping[str, ScenarioTest], steps: Sequence[Node]
) -> Iterator[FixedAction]:
    """Yield the actions of all agents, given those of each in the steps in which it has one."""
    drivers = {name: part.driver for name, part in parts.items() if not isinstance(part.driver, str)}
    resting = {name: _resting(member.program.agent.action) for name, member in members.items()}
    for number, step in enumerate(steps):
        actions = [
            resting[name] if node_at(step, name) is None else drivers[name][number] for name in members
        ]
        yield FixedAction(
            tuple(chain.from_iterable(action.choices for action in actions)),
            tuple(chain.from_iterable(action.ranges for action in actions)),
            ":".join(action.text for action in actions),
        )


def _resting(action: Sequence[ActionPart]) -> FixedAction:
    """Return the first option of each choice, and the middle of each range."""
    choices = tuple(0 for part in action if isinstance(part, Choices))
    ranges = tuple(0.0 for part in action if isinstance(part, ActionRange) for _ in part.names)
    words = [
        part.options[0].name if isinstance(part, Choices) else ":".join("0" for _ in part.names)
        for part in action
    ]
    return FixedAction(choices, ranges, ":".join(words))


def _steps(test: Node) -> tuple[Node, ...]:
    """Return the actions of a test, one for each step."""
    actions = node_at(test, _ACTIONS)
    return actions.items if isinstance(actions, SequenceNode) else ()


def report_unknown(findings: Findings, node: ScalarNode, noun: str, names: Sequence[str]) -> None:
    """Report that the text of a node is none of the `names`."""
    findings.add("DB201", node.span, f"there is no {noun} `{node.text}`", choices_help(node.text, [*names]))


def text_in_place_of(node: Node, text: str) -> ScalarNode:
    """Return a text at the place of a node."""
    return ScalarNode(node.span, text, text)

"""Tests of a scenario with several agents.

A test is about one agent, whose results it expects. It is compiled in the scenario of each agent, with the
driver or the actions of that agent there; the expectations are compiled in that of its own agent. The parts
are then combined to a test of the program of all agents.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import chain

from deepbots_cli.diagnostics import Findings
from deepbots_cli.document import Entry, MappingNode, Node, ScalarNode, SequenceNode
from deepbots_cli.document.load import TESTS
from deepbots_cli.document.nodes import entries_at
from deepbots_cli.program import Program
from deepbots_cli.program.members import RANDOM, ZERO, Member
from deepbots_cli.program.task import ActionPart, ActionRange, FixedAction, ScenarioTest
from deepbots_cli.scenario.fields.words import choices_help

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
        node = _get(self._written[test].value, _AGENT)
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
            actions = [_get(step, agent) for step in _steps(test_node)]
            first = next((item for item in actions if item is not None), None)
            key = entries.pop(_ACTIONS).key
            if first is None:
                entries[_DRIVER] = Entry(_scalar(key, _DRIVER), _scalar(key, ZERO))
            else:
                # Fills a step in which the agent has no action; `_combined_actions` replaces it by the
                # resting action.
                items = tuple(first if item is None else item for item in actions)
                entries[_ACTIONS] = Entry(key, SequenceNode(key.span, items))
        if agent != self.owner(test) and _EXPECT in entries:
            expected = {
                _PLACEHOLDER_EXPECTATION: Entry(
                    _scalar(name, _PLACEHOLDER_EXPECTATION), name._replace(text="0", value=0)
                )
            }
            entries[_EXPECT] = Entry(entries[_EXPECT].key, MappingNode(name.span, expected))
        return replace(test_node, entries=entries)

    def _driver(self, agent: str, test_node: MappingNode) -> ScalarNode:
        """Return the driver of an agent: its script of the name that all agents share, else its first script,
        else `random`."""
        node = test_node.get(_DRIVER)
        scripts = self._scripts[agent]
        of_agent = _get(node, agent)
        if isinstance(of_agent, ScalarNode):
            return of_agent
        if isinstance(node, ScalarNode) and node.text in (*scripts, RANDOM, ZERO):
            return node
        return _scalar(test_node.entries[_DRIVER].key, next(iter(scripts), RANDOM))

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
                headline = f"there is no {noun} `{node.text}`"
                self._findings.add("DB201", node.span, headline, choices_help(node.text, names))

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
            if steps := _steps_of(self._written[name]):
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
        actions = [resting[name] if _get(step, name) is None else drivers[name][number] for name in members]
        yield FixedAction(
            tuple(chain.from_iterable(action.choices for action in actions)),
            tuple(chain.from_iterable(action.ranges for action in actions)),
            ":".join(action.text for action in actions),
        )


def _resting(action: Sequence[ActionPart]) -> FixedAction:
    """Return the first option of each choice, and the middle of each range."""
    choices: list[int] = []
    ranges: list[float] = []
    words: list[str] = []
    for part in action:
        if isinstance(part, ActionRange):
            ranges += [0.0] * len(part.names)
            words += ["0"] * len(part.names)
        else:
            choices.append(0)
            words.append(part.options[0].name)
    return FixedAction(tuple(choices), tuple(ranges), ":".join(words))


def _steps_of(test: Entry) -> tuple[Node, ...]:
    return _steps(test.value) if isinstance(test.value, MappingNode) else ()


def _steps(test: MappingNode) -> tuple[Node, ...]:
    """Return the actions of a test, one for each step."""
    actions = test.get(_ACTIONS)
    return actions.items if isinstance(actions, SequenceNode) else ()


def _get(node: Node | None, key: str) -> Node | None:
    return node.get(key) if isinstance(node, MappingNode) else None


def _scalar(key: ScalarNode, text: str) -> ScalarNode:
    """Return a text at the place of a key."""
    return ScalarNode(key.span, text, text)

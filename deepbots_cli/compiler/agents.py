"""Several agents: the section `agents` divided into a scenario for each agent.

The scenario of an agent is the file with the keys of the agent at the top level, `endings` as successes and
failures of the agent, and the robots of other agents without controllers. It is checked like any scenario
with one agent, so every rule about action, observation and reward applies to each agent; nodes keep their
places in the file. `multi_agent.py` combines the programs.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path

from deepbots_cli.compiler.multi_agent import DividedTests, report_unknown, text_in_place_of
from deepbots_cli.compiler.training import words_pattern
from deepbots_cli.diagnostics import Finding, Findings, Label, Span
from deepbots_cli.document import Document, Entry, MappingNode, Node, ScalarNode, SequenceNode, files
from deepbots_cli.document.load import TESTS, settings_in
from deepbots_cli.document.nodes import entries_at, follow_dotted, node_at, to_data, without_paths
from deepbots_cli.expressions.scalar import names_in
from deepbots_cli.expressions.types import QUATERNION
from deepbots_cli.program import RANDOM, SEPARATOR, ZERO, Others, Program
from deepbots_cli.records import dataclass
from deepbots_cli.scenario.base import ListOf, MappingOf, Shape, chosen_shape, section_fields
from deepbots_cli.scenario.fields import BUILT_IN_NAMES, Word
from deepbots_cli.scenario.quantities import Solved
from deepbots_cli.scenario.scenario import with_whole_training
from deepbots_cli.scenario.task import ALL_AGENTS, AgentOfSeveral
from deepbots_cli.scenario.validate import validate

AGENTS = "agents"
ENDINGS = "endings"
ROLE = "role"
TRAIN = "train"
TRUNCATION = "truncation"
_OF_ALL = frozenset({AGENTS, ENDINGS, ROLE})
_CONTROLLER_KEYS = frozenset({"sensors", "actuators", "receive", "emit", "apply"})
_SIGNALS = "signals"
_LIKE = "like"
_POLICY = "policy"
_OWN_OF_MIRROR = frozenset({_LIKE, _POLICY, "robots", "scripts", "solved", TRAIN})
"""The keys that an agent which mirrors another one exactly may have."""
_KEYS_OF_AGENT = frozenset(AgentOfSeveral.model_fields) - {
    _LIKE,
    _POLICY,
    "robots",
    "frame_stack",
    _SIGNALS,
}
_COPIES = "a robot with copies", "write each robot; agents with `like` and `policy` have one policy"
_GOAL = "a `goal`", "put the target into the observation, and the distance to it into the reward"
_REQUIRED = ("action", "observation", "reward")
_MODEL_SUFFIX = ".zip"
_WORD_OF_LANGUAGE = rf"\b\w+(?=\s*\()|\b(?:{'|'.join(BUILT_IN_NAMES)})\b|(?<=\.)[{''.join(QUATERNION)}]\b"
"""A function, a built-in name, or a component."""
BEST_MODEL = "models/agent/best.zip"
"""The best model in the folder of a run."""


def has_several_agents(document: Document) -> bool:
    return document.root is not None and AGENTS in document.root.entries


@dataclass(frozen=True)
class AgentDocuments:
    """The scenario of each agent, the agent that drives each robot, the section of each agent, the agent that
    one mirrors exactly, and the tests."""

    documents: Mapping[str, Document]
    drivers: Mapping[str, str]
    sections: Mapping[str, AgentOfSeveral]
    mirrors: Mapping[str, str]
    tests: DividedTests


def divide(document: Document) -> AgentDocuments | None:
    """Return the scenarios of the agents; None after a finding that leaves none."""
    assert document.root is not None
    _report_unsupported(document)
    _report_joined_names(document)
    if document.findings.errors:
        return None
    root = with_whole_training(document.root)
    document = replace(document, root=root)
    agents = _Mirrors(document.findings, entries_at(root, AGENTS)).resolved()
    if document.findings.errors:
        return None
    sections = _sections(document, agents)  # first: a key that lacks may be there with a typo
    if sections is None or not _are_complete(document, agents):
        return None
    drivers = _drivers(document, agents, sections)
    _report_shared_names(document)
    mirrors = dict(_mirrors(document))
    _check_policies(document, sections, mirrors)
    tests = DividedTests(
        root, {name: [*section.scripts] for name, section in sections.items()}, document.findings
    )
    documents = {
        name: replace(
            document,
            root=_root_of(document, root, name, agents[name], drivers, tests),
            findings=Findings(document.findings.limit),
            agent=name,
        )
        for name in sections
    }
    return None if document.findings.errors else AgentDocuments(documents, drivers, sections, mirrors, tests)


def _report_unsupported(document: Document) -> None:
    """Report copies and goals, which only a scenario with one agent may have."""
    root = document.root
    agents = [(AGENTS, name) for name in entries_at(root, AGENTS)]
    robots = [("robots", name) for name in entries_at(root, "robots")]
    unsupported = [
        *((*path, "each", *_COPIES) for path in (("agent",), *agents)),
        *((*path, "count", *_COPIES) for path in robots),
        *((*path, "goal", *_GOAL) for path in ((), *agents)),
    ]
    for *path, key, subject, instead in unsupported:
        entry = entries_at(root, *path).get(key)
        if entry is not None:
            headline = f"{subject} together with several agents is not supported yet"
            document.findings.add("DB108", entry.key.span, headline, instead)
            return


def _mirrors(document: Document) -> Iterator[tuple[str, str]]:
    """Yield each agent that mirrors another one exactly, and this agent."""
    for name, entry in entries_at(document.root, AGENTS).items():
        section = entry.value
        if isinstance(section, MappingNode) and section.entries.keys() <= _OWN_OF_MIRROR:
            node = section.get(_LIKE)
            if isinstance(node, ScalarNode):
                yield name, node.text


def _check_policies(
    document: Document, sections: Mapping[str, AgentOfSeveral], mirrors: Mapping[str, str]
) -> None:
    """Report agents that share a policy with one that they do not mirror exactly."""
    for name in sections:
        node = node_at(document.root, AGENTS, name, _POLICY)
        if not isinstance(node, ScalarNode):
            continue
        other_agents = [agent for agent in sections if agent != name]
        if node.text not in other_agents:
            report_unknown(document.findings, node, "other agent", other_agents)
        elif mirrors.get(name) != node.text or _POLICY in entries_at(document.root, AGENTS, node.text):
            document.findings.add(
                "DB407",
                node.span,
                f"`{name}` cannot share the policy of `{node.text}`, because it does not mirror it exactly",
                f"write `like: {node.text}`, without an action, observation or reward of its own",
            )


def _sections(document: Document, agents: Mapping[str, MappingNode]) -> dict[str, AgentOfSeveral] | None:
    """Return the validated sections of the agents."""
    root = document.root
    assert root is not None
    for key in (_KEYS_OF_AGENT - {TRAIN}) & root.entries.keys():
        document.findings.add(
            "DB101",
            root.entries[key].key.span,
            f"`{key}` at the top level cannot be combined with `agents`",
            f"move `{key}` into the section of each agent",
        )
    resolved = {
        name: Entry(root_entry.key, agents.get(name, root_entry.value))
        for name, root_entry in entries_at(root, AGENTS).items()
    }
    section = root.entries[AGENTS]
    if isinstance(section.value, MappingNode):
        section = Entry(section.key, replace(section.value, entries=resolved))
    new_root = replace(root, entries={**root.entries, AGENTS: section})
    validated = Findings(document.findings.limit)
    spec = validate(new_root, validated)
    joined_findings(document.findings, ([finding] for finding in validated))
    if spec is None or spec.agents is None or document.findings.errors:
        return None
    return dict(spec.agents)


def _key_of(document: Document, agent: str) -> ScalarNode:
    """Return the name of an agent in the file."""
    return entries_at(document.root, AGENTS)[agent].key


def _are_complete(document: Document, agents: Mapping[str, MappingNode]) -> bool:
    """Return whether each agent has the keys that it needs; report those that lack."""
    for name, section in agents.items():
        model = node_at(document.root, AGENTS, name, _LIKE)
        if isinstance(model, ScalarNode) and model.text in agents:
            continue  # it lacks what the agent lacks that it mirrors
        lacking = [f"`{key}`" for key in _REQUIRED if key not in section.entries]
        if lacking:
            document.findings.add(
                "DB102",
                _key_of(document, name).span,
                f"the agent `{name}` has no {' and no '.join(lacking)}",
                "write them as at the top level of a scenario with one agent; or mirror another agent with"
                " `like`",
            )
    return not document.findings.errors


def _report_shared_names(document: Document) -> None:
    """Report signals of an agent that have the name of a signal of all agents."""
    shared = entries_at(document.root, _SIGNALS)
    for agent in entries_at(document.root, AGENTS):
        for name, entry in entries_at(document.root, AGENTS, agent, _SIGNALS).items():
            if name in shared:
                document.findings.add(
                    "DB202",
                    entry.key.span,
                    f"the signal `{name}` of `{agent}` is already a signal of all agents",
                    "give one of the two another name",
                    labels=(Label(shared[name].key.span, "first defined here"),),
                )


def _report_joined_names(document: Document) -> None:
    """Report agents and shared names that make a name of the program of all agents ambiguous: `a__b__gas`
    would be `b__gas` of the agent `a`, or `gas` of the agent `a__b`."""
    agents = entries_at(document.root, AGENTS)
    for name, entry in agents.items():
        if SEPARATOR in f"{name}_":
            document.findings.add(
                "DB105",
                entry.key.span,
                f"`{name}` cannot be the name of an agent",
                "choose a name without `__` that does not end in `_`; `__` joins an agent and its parts, as"
                " in `red__gas`",
            )
    for section in (_SIGNALS, "parameters"):
        for name, entry in entries_at(document.root, section).items():
            agent, separator, part = name.partition(SEPARATOR)
            if separator and agent in agents:
                document.findings.add(
                    "DB105",
                    entry.key.span,
                    f"`{name}` is the name of `{part}` of the agent `{agent}` in the scenario of all agents",
                    "choose a name without `__`",
                )


# Agents that mirror another one


def sections_of_agents(root: Node) -> dict[str, MappingNode]:
    """Return the section of each agent, without `like`."""
    return _Mirrors(Findings(), entries_at(root, AGENTS)).resolved()


class _Mirrors:
    """Resolves `like`."""

    def __init__(self, findings: Findings, entries: Mapping[str, Entry]) -> None:
        self._findings = findings
        self._written = entries
        self._resolved: dict[str, MappingNode] = {}
        self._reported: set[str] = set()

    def resolved(self) -> dict[str, MappingNode]:
        """Return the section of each agent, without `like`; an agent with a finding is left out."""
        for name in self._written:
            self._resolve(name, ())
        return {name: self._resolved[name] for name in self._written if name in self._resolved}

    def _resolve(self, name: str, above: tuple[str, ...]) -> MappingNode | None:
        section = self._written[name].value
        if name in self._resolved or name in self._reported or not isinstance(section, MappingNode):
            return self._resolved.get(name)
        node = section.get(_LIKE)
        if not isinstance(node, ScalarNode):
            self._resolved[name] = section
            return section
        if node.text in (*above, name):
            cycle = " -> ".join((*above, name, node.text))
            self._reported |= {*above, name}
            self._findings.add(
                "DB207",
                node.span,
                f"`{name}` mirrors itself",
                "write the keys of one of these agents",
                notes=(f"the cycle is {cycle}",),
            )
            return None
        if node.text not in self._written:
            report_unknown(self._findings, node, "agent", [*self._written])
            return None
        model = self._resolve(node.text, (*above, name))
        if model is None:
            return None
        swap = Swap(self._pairs(name, section, node.text, model))
        mirrored = swap.section(model)
        entries = {key: entry for key, entry in section.entries.items() if key != _LIKE}
        self._resolved[name] = replace(mirrored, span=section.span, entries={**mirrored.entries, **entries})
        return self._resolved[name]

    def _pairs(
        self, name: str, section: MappingNode, model_name: str, model: MappingNode
    ) -> list[tuple[str, str]]:
        """Return the names that change places: of the agents, and of their robots in order."""
        first, second = (
            [node.text for node in _named(of_agent.get("robots"))] for of_agent in (model, section)
        )
        return [(model_name, name), *zip(first, second, strict=False)]


class Swap:
    """Exchanges names in the section of an agent: in the keys and texts of the user, where a name ends at `_`,
    at `.` and at the ends of a word. The language has the same keys, words, functions and built-in names for
    every agent."""

    def __init__(self, pairs: Iterable[tuple[str, str]]) -> None:
        self._other = {a: b for pair in pairs for a, b in (pair, pair[::-1])}
        names = words_pattern(self._other).pattern
        self._words = re.compile(rf"{_WORD_OF_LANGUAGE}|(?P<name>{names})")

    def section(self, node: MappingNode, shape: Shape | None = AgentOfSeveral) -> MappingNode:
        """Return the mapping with exchanged names."""
        fields = section_fields(shape) if isinstance(shape, type) else {}
        item = shape.value if isinstance(shape, MappingOf) else None
        entries = {}
        for name, entry in node.entries.items():
            key = entry.key if name in fields else self._scalar(entry.key)
            entries[key.text] = Entry(key, self._node(entry.value, fields.get(name, item)))
        return replace(node, entries=entries)

    def _node(self, node: Node, shape: Shape | None) -> Node:
        """Return the tree with exchanged names; each text keeps its place in the file. Without a `shape`, the
        value has no place in the language."""
        if shape is not None:
            shape = chosen_shape(shape, to_data(node))
        match node:
            case ScalarNode():
                return node if isinstance(shape, Word | Solved) else self._scalar(node)
            case SequenceNode():
                item = shape.item if isinstance(shape, ListOf) else shape
                return replace(node, items=tuple(self._node(below, item) for below in node.items))
            case MappingNode():
                return self.section(node, shape)

    def _scalar(self, node: ScalarNode) -> ScalarNode:
        """Return the text with exchanged names; all letters of a name have the place of the first one."""
        names = [match for match in self._words.finditer(node.text) if match["name"]]
        if not isinstance(node.value, str) or not names:
            return node
        offset_of: Callable[[int], int] = (
            node.span.start.__add__ if node.offsets is None else node.offsets.__getitem__
        )
        text = ""
        offsets: list[int] = []
        end = 0
        for match in names:
            other = self._other[match["name"]]
            text += node.text[end : match.start()] + other
            offsets += map(offset_of, range(end, match.start()))
            offsets += [offset_of(match.start())] * len(other)
            end = match.end()
        text += node.text[end:]
        offsets += map(offset_of, range(end, len(node.text) + 1))
        return node._replace(text=text, value=text, offsets=offsets)


# Robots and endings


def _drivers(
    document: Document, agents: Mapping[str, MappingNode], sections: Mapping[str, AgentOfSeveral]
) -> dict[str, str]:
    """Return the agent that drives each robot."""
    root = document.root
    assert root is not None
    robots = list(entries_at(root, "robots"))
    drivers: dict[str, str] = {}
    spans: dict[str, Span] = {}
    for agent, section in sections.items():
        node = agents[agent].get("robots")
        items = node.items if isinstance(node, SequenceNode) else ()
        for robot, item in zip(section.robots, items, strict=False):
            span = item.span
            if robot not in robots:
                if isinstance(item, ScalarNode):
                    report_unknown(document.findings, item, "robot", robots)
            elif robot in drivers:
                document.findings.add(
                    "DB202",
                    span,
                    f"`{agent}` drives the robot `{robot}`, which `{drivers[robot]}` drives too",
                    "give each robot to one agent",
                    labels=(Label(spans[robot], "driven here"),),
                )
            else:
                drivers[robot], spans[robot] = agent, span
        if not section.robots:
            document.findings.add(
                "DB102",
                _key_of(document, agent).span,
                f"`{agent}` has no robots",
                "list the robots that it drives: `robots: [...]`",
            )
    return drivers


def _outcomes(document: Document, agent: str, agents: list[str]) -> MappingNode | None:
    """Return `termination` as it is for an agent."""
    root = document.root
    section = node_at(root, ENDINGS)
    if not isinstance(section, MappingNode):
        return None
    outcomes: dict[str, dict[str, Entry]] = {"success": {}, "failure": {}}
    for name, entry in section.entries.items():
        ending = entry.value
        when = ending.get("when") if isinstance(ending, MappingNode) else None
        if not isinstance(ending, MappingNode) or when is None:
            continue
        ends = ending.get("ends")
        ended = agents if ends is None else _agents_of(ends, agents, agents, document.findings)
        agents_by_outcome = {
            outcome: _agents_of(ending.get(outcome), ended, agents, document.findings) for outcome in outcomes
        }
        of_agent = [outcome for outcome in outcomes if agent in agents_by_outcome[outcome]]
        if not document.findings.errors:
            _report_outcome(document.findings, entry.key, agent, of_agent, is_ended=agent in ended)
        for outcome in of_agent[:1]:
            outcomes[outcome][name] = Entry(entry.key, when)
    entries = {
        outcome: Entry(text_in_place_of(section, outcome), replace(section, entries=conditions))
        for outcome, conditions in outcomes.items()
        if conditions
    }
    return replace(section, entries=entries)


def _agents_of(node: Node | None, members: list[str], agents: list[str], findings: Findings) -> list[str]:
    """Return the agents that are named, where `all` names every agent of `members`; report unknown names."""
    name_nodes = _named(node)
    for name_node in name_nodes:
        if name_node.text not in (*agents, ALL_AGENTS):
            report_unknown(findings, name_node, "agent", [*agents, ALL_AGENTS])
    texts = [name_node.text for name_node in name_nodes]
    return [name for name in agents if name in texts or (ALL_AGENTS in texts and name in members)]


def _report_outcome(
    findings: Findings, key: ScalarNode, agent: str, outcomes: list[str], *, is_ended: bool
) -> None:
    """Report an ending that is not exactly one outcome of an agent whose episode it ends."""
    if len(outcomes) > 1:
        findings.add(
            "DB202",
            key.span,
            f"`{key.text}` is a success and a failure of `{agent}`",
            f"name `{agent}` under `success` or under `failure`",
        )
    elif outcomes and not is_ended:
        findings.add(
            "DB202",
            key.span,
            f"`{key.text}` is a {outcomes[0]} of `{agent}`, whose episode it does not end",
            f"name `{agent}` under `ends`, or remove it from `{outcomes[0]}`",
        )
    elif not outcomes and is_ended:
        findings.add(
            "DB102",
            key.span,
            f"`{key.text}` does not say what it is for the agent `{agent}`",
            f"name `{agent}` under `success` or `failure`; `all` names all agents",
        )


def _named(node: Node | None) -> list[ScalarNode]:
    match node:
        case ScalarNode():
            return [node]
        case SequenceNode():
            return [item for item in node.items if isinstance(item, ScalarNode)]
        case _:
            return []


# The scenario of one agent


def _root_of(
    document: Document,
    root: MappingNode,
    agent: str,
    section: MappingNode,
    drivers: Mapping[str, str],
    tests: DividedTests,
) -> MappingNode:
    """Return the scenario of an agent, given that of all and the section of the agent."""
    agents = [*entries_at(root, AGENTS)]
    entries = {key: entry for key, entry in root.entries.items() if key not in _OF_ALL}
    entries |= {key: entry for key, entry in section.entries.items() if key in _KEYS_OF_AGENT}
    if (own_signals := section.entries.get(_SIGNALS)) is not None:
        entries[_SIGNALS] = _with_entries(entries.get(_SIGNALS), own_signals)
    if (termination := _outcomes(document, agent, agents)) is not None:
        key = text_in_place_of(root.entries[ENDINGS].key, "termination")
        entries["termination"] = Entry(key, termination)
    if (stack := section.entries.get("frame_stack")) is not None:
        settings = Entry(stack.key, replace(section, entries={"frame_stack": stack}))
        entries["agent"] = _with_entries(entries.get("agent"), settings)
    if (limits := entries.get(TRUNCATION)) is not None and isinstance(limits.value, MappingNode):
        entries[TRUNCATION] = Entry(limits.key, _limits_of(limits.value, agent, agents, document.findings))
    if (section_of_tests := entries.get(TESTS)) is not None:
        entries[TESTS] = tests.section_of(agent, section_of_tests)
    robots = entries.get("robots")
    if robots is not None and isinstance(robots.value, MappingNode):
        heard = set(_heard_robots(robots.value))
        bodies = {
            name: entry
            if drivers.get(name, agent) == agent
            else Entry(entry.key, _without_controller(entry.value, is_heard=name in heard))
            for name, entry in robots.value.entries.items()
        }
        entries["robots"] = Entry(robots.key, replace(robots.value, entries=bodies))
    divided = replace(root, entries=entries)
    foreign = [path for path in settings_in(divided) if _is_absent(divided, root, str(path[-1]))]
    without = without_paths(divided, foreign)
    assert isinstance(without, MappingNode)  # the root stays a mapping
    return without


def _is_absent(divided: MappingNode, root: MappingNode, path: str) -> bool:
    """Return whether a setting changes what only the scenario of another agent has: the controller of its
    robot."""
    steps, _, unresolved = follow_dotted(divided, path)
    is_robot = steps[:-1] == ("robots",)
    return is_robot and unresolved.split(".")[0] in entries_at(root, *steps)


def _limits_of(limits: MappingNode, agent: str, agents: list[str], findings: Findings) -> MappingNode:
    """Return `truncation` as it is for an agent: a limit that is not a success of the agent is a plain
    limit."""
    entries = {}
    for name, entry in limits.entries.items():
        limit = entry.value.get("limit") if isinstance(entry.value, MappingNode) else None
        if limit is None or not isinstance(entry.value, MappingNode):
            entries[name] = entry
            continue
        success = Entry(text_in_place_of(entry.key, "success"), text_in_place_of(entry.key, ALL_AGENTS))
        limit_entries = {**entry.value.entries, "success": success}
        is_success = agent in _agents_of(entry.value.get("success"), agents, agents, findings)
        entries[name] = Entry(entry.key, replace(entry.value, entries=limit_entries) if is_success else limit)
    return replace(limits, entries=entries)


def _with_entries(shared: Entry | None, part: Entry) -> Entry:
    """Return the section of an agent with the entries that all agents share before its own."""
    if shared is None or not isinstance(shared.value, MappingNode) or not isinstance(part.value, MappingNode):
        return part
    return Entry(part.key, replace(part.value, entries={**shared.value.entries, **part.value.entries}))


def _heard_robots(robots: MappingNode) -> Iterator[str]:
    """Yield the robots that send values to other robots."""
    for entry in robots.entries.values():
        for heard in entries_at(entry.value, "hear").values():
            if isinstance(heard.value, ScalarNode):
                yield heard.value.text.partition(".")[0]


def _without_controller(robot: Node, *, is_heard: bool) -> Node:
    """Return a robot of another agent: without a controller, except for what it sends to other robots."""
    if not isinstance(robot, MappingNode):
        return robot
    left_out = _CONTROLLER_KEYS - ({"sensors", "emit"} if is_heard else set())
    entries = {key: entry for key, entry in robot.entries.items() if key not in left_out}
    return replace(robot, entries=entries)


# Results


def report_own_names(
    document: Document, programs: Mapping[str, Program], sections: Mapping[str, AgentOfSeveral]
) -> None:
    """Report endings of all agents that use a name which is that of one agent alone."""
    of_each = [{ending.name for ending in program.endings} for program in programs.values()]
    of_all = set.intersection(*of_each) if of_each else set[str]()
    for agent, program in programs.items():
        augmented = sections[agent].augment
        names = {*sections[agent].signals, *(augmented if isinstance(augmented, Mapping) else ())}
        names |= {name for part in program.agent.action for name in part.variables}
        for ending in program.endings:
            used = names & {leaf.name for scalar in ending.scalars for leaf in names_in(scalar)}
            if used and ending.name in of_all:
                document.findings.add(
                    "DB201",
                    ending.span,
                    f"`{min(used)}` is a name of each agent, but `{ending.name}` is an ending of all",
                    "use a value under `signals` at the top level, or let the ending end the episode of one"
                    " agent with `ends`",
                )
                return


def report_foreign_values(
    document: Document, programs: Mapping[str, Program], drivers: Mapping[str, str]
) -> None:
    """Report that an agent uses what a robot of another agent sends, or what it hears."""
    spans: set[Span] = set()  # of which an agent that mirrors another one has the same
    for agent, program in programs.items():
        for value in program.computed_expressions:
            names = {leaf.name for scalar in value.scalars for leaf in names_in(scalar)}
            foreign = [name for name in sorted(names) if drivers.get(name.partition(".")[0], agent) != agent]
            heads = [name.partition(".") for name in foreign if "." in name]
            if heads and value.span not in spans:
                robot, _, sent = heads[0]
                headline, help = _foreign_words(robot, sent, drivers[robot], agent)
                document.findings.add("DB402", value.span, headline, help)
                spans.add(value.span)


def _foreign_words(robot: str, value: str, owner: str, agent: str) -> tuple[str, str]:
    return (
        f"`{robot}` sends `{value}` to its agent `{owner}`, and not to `{agent}`",
        "define a value of the world under `augment`, or let a robot of the agent `hear` it",
    )


def findings_of_other_agents(
    findings: Iterable[Finding], agent: str, drivers: Mapping[str, str]
) -> Iterator[Finding]:
    """Yield the findings of an agent. The help of an unknown name that is a value of a robot of another agent
    says who sends it."""
    for finding in findings:
        robot, dot, value = finding.span.text.partition(".")
        owner = drivers.get(robot, agent)
        is_written = (
            f"`{finding.span.text}`" in finding.headline
        )  # and no name that a mirrored agent has instead
        if finding.code == "DB402" and dot and owner != agent and is_written:
            headline, help = _foreign_words(robot, value, owner, agent)
            finding = replace(finding, headline=headline, help=help)
        yield finding


def joined_findings(findings: Findings, of_agents: Iterable[Iterable[Finding]]) -> None:
    """Add the findings of the agents to those of the file. What a rule finds at one place for several agents
    is one finding: an agent that mirrors another one has the same mistakes in other words."""
    reported: set[tuple[str, Span]] = set()
    for agent_findings in of_agents:
        of_agent = [finding for finding in agent_findings if (finding.code, finding.span) not in reported]
        for finding in of_agent:
            findings.append(finding)
        reported |= {(finding.code, finding.span) for finding in of_agent}


def with_sections(document: Document, documents: Mapping[str, Document]) -> Document:
    """Return the document with the `train` that deepbots has chosen for agents in their sections."""
    root = document.root
    section = node_at(root, AGENTS)
    if root is None or not isinstance(section, MappingNode):
        return document
    entries = dict(section.entries)
    for name, part in documents.items():
        train = part.root.entries.get(TRAIN) if part.root is not None else None
        entry = entries[name]
        if train is not None and isinstance(entry.value, MappingNode):
            keys = {**entry.value.entries, TRAIN: train}
            entries[name] = Entry(entry.key, replace(entry.value, entries=keys))
    agents = Entry(root.entries[AGENTS].key, replace(section, entries=entries))
    return replace(document, root=replace(root, entries={**root.entries, AGENTS: agents}))


def report_keys_of_several(document: Document) -> None:
    """Report the keys of several agents in a scenario without `agents`."""
    for *section, key in ((ENDINGS,), (ROLE,), ("train", "self_play"), ("train", "turns")):
        entry = entries_at(document.root, *section).get(key)
        if entry is not None:
            document.findings.add(
                "DB101",
                entry.key.span,
                f"`{key}` belongs to a scenario with several `agents`",
                "write `success` and `failure` under `termination`" if key == ENDINGS else "remove it",
            )


def played_agent(document: Document) -> str | None:
    """Return the agent that `role` names, None if there is none."""
    node = node_at(document.root, ROLE, "agent")
    return node.text if isinstance(node, ScalarNode) else None


def is_model(driver: str) -> bool:
    """Return whether a driver is the path of a run or of a model, and not a name."""
    return "/" in driver or driver.endswith(_MODEL_SUFFIX)


def models_of_others(document: Document) -> dict[str, Path]:
    """Return the files of the models that act for other agents, as far as they exist; report the others."""
    models: dict[str, Path] = {}
    for name, entry in entries_at(document.root, ROLE, "others").items():
        if isinstance(entry.value, ScalarNode) and is_model(entry.value.text):
            text = entry.value.text
            reference = text if text.endswith(_MODEL_SUFFIX) else f"{text}/{BEST_MODEL}"
            span = entry.value.span
            located = files.resolve_reference(reference, document.directory_of(span), document.roots)
            if isinstance(located, Path):
                models[name] = located
            else:
                document.findings.add("DB204", span, located.headline, located.help, notes=located.notes)
    return models


def program_among_others(
    document: Document, world: Program, agent: str, models: Mapping[str, Path]
) -> Program | None:
    """Return the program of one agent, beside which the others act by themselves; None after a finding.

    Args:
        document: The scenario.
        world: The program of all agents.
        agent: The agent.
        models: The files of models that act for other agents.
    """
    findings = document.findings
    names = list(world.members)
    agent_node = node_at(document.root, ROLE, "agent")
    if agent not in world.members:
        assert isinstance(agent_node, ScalarNode)
        report_unknown(findings, agent_node, "agent", names)
        return None
    drivers = {
        name: next((script.name for script in member.program.agent.scripts), RANDOM)
        for name, member in world.members.items()
        if name != agent
    }
    for name, entry in entries_at(document.root, ROLE, "others").items():
        if name not in drivers:
            report_unknown(findings, entry.key, "other agent", list(drivers))
        elif isinstance(entry.value, ScalarNode):
            scripts = [script.name for script in world.members[name].program.agent.scripts]
            if is_model(entry.value.text):
                if name in models:
                    drivers[name] = f"model {hashlib.sha256(models[name].read_bytes()).hexdigest()}"
                continue
            if entry.value.text not in (*scripts, RANDOM, ZERO):
                report_unknown(findings, entry.value, f"driver of `{name}`", [*scripts, RANDOM, ZERO])
            drivers[name] = entry.value.text
    return None if findings.errors else _with_others(world, agent, drivers, models)


def _with_others(
    world: Program, agent: str, drivers: Mapping[str, str], models: Mapping[str, Path]
) -> Program:
    """Return the program of an agent with the others, in each case and stage too."""
    program = world.members[agent].program
    return replace(
        program,
        others=Others(world, agent, drivers, models),
        cases=tuple(
            replace(case, program=_with_others(world.case(case.name).program, agent, drivers, models))
            for case in program.cases
        ),
        curriculum=tuple(
            replace(stage, program=_with_others(world.stage(stage.name).program, agent, drivers, models))
            for stage in program.curriculum
        ),
    )

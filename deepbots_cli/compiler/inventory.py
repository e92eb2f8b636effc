"""The names of a scenario by kind, for editors and for its JSON Schema."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from itertools import islice
from typing import NamedTuple

from deepbots_cli.compiler import CheckedScenario
from deepbots_cli.compiler.namespace import Namespace, Origin, RobotScope, ScenarioScope, SupervisorScope
from deepbots_cli.compiler.robots import ResolvedRobot
from deepbots_cli.diagnostics import Span
from deepbots_cli.document.nodes import (
    MappingNode,
    Node,
    NodePath,
    ScalarNode,
    SequenceNode,
    descend,
    node_at,
)
from deepbots_cli.expressions.types import Context, Kind
from deepbots_cli.robots.model import Joint
from deepbots_cli.scenario.fields import REFERENCE_KINDS, with_article
from deepbots_cli.scenario.json_schema import Names, OfferedNames, ScenarioNames
from deepbots_cli.scenario.task import ALL_AGENTS, DiscreteAction


class NameEntry(NamedTuple):
    """A name, its meaning (`a revolute joint`), and the place of its definition; None for a name that is part
    of the language."""

    name: str
    description: str
    span: Span | None = None


def namespace_at(checked: CheckedScenario, path: NodePath) -> Namespace | None:
    """Return the names that are visible at `path`, those of the first agent for a path that names none."""
    agent = next((str(step) for step in path if step in checked.agents), "")
    return checked.agents.get(agent, checked).namespace


def names_at(
    checked: CheckedScenario, kind: str, path: NodePath = (), *, is_pattern: bool = False
) -> list[NameEntry]:
    """Return the names that a `Reference` or a `Pattern` of this kind may take at `path` of the scenario;
    none if they are unknown.

    Inside of a robot its parts go by their short names, elsewhere by full ones, as `cart.pole_hinge`. Only a
    pattern and a kind that takes several links may name a group of links.
    """
    agent = next((str(step) for step in path if step in checked.agents), "")
    namespace = namespace_at(checked, path)
    is_by_agent = bool(checked.agents) and path[:1] == ("tests",) and path[2:3] == ("actions",)
    if namespace is None or (is_by_agent and kind == "option" and not agent):
        return []
    if is_by_agent:  # the step of a test names the agents, and below each its action
        kind, path = {"action": "agent", "choice": "action"}.get(kind, kind), path[:4]
    reference = REFERENCE_KINDS[kind]
    robot = str(path[1]) if path[:1] == ("robots",) and len(path) > 1 else ""
    match kind:
        case "choice" | "option":
            return _options(namespace, kind, path[2:] if path[:2] == ("agents", agent) else path)
        case "message field":
            fields = namespace.names_of(Origin.FIELD)
            return _defined(namespace, (name for name in fields if name.partition(".")[0] != robot))
        case "letter":
            cells = node_at(checked.document.root, *path[:3], "map")
            letters = cells.text.split() if isinstance(cells, ScalarNode) else []
            return [
                NameEntry(letter, "a letter of the map") for letter in dict.fromkeys(letters) if letter != "."
            ]
        case "value":
            return _defined(namespace, SupervisorScope(namespace, Context.OBSERVATION).names())
    has_everyone = kind == "agent" and path[:1] in (("endings",), ("truncation",))
    words = {**reference.words, **({ALL_AGENTS: "all agents"} if has_everyone else {})}
    takes_several = "links" in reference.parts and (is_pattern or reference.singular)
    parts = (*reference.parts, "link groups") if takes_several else reference.parts
    felt = namespace.walls if kind == "bodies or links" else ()  # by a touch sensor
    entries = (
        *_of_sections(namespace.values.root, reference.sections),
        *_of_sections(checked.document.root, reference.sections),  # those of all agents
        *_defined(namespace, felt),
        *_parts(namespace, "" if ("robots",) in reference.sections else robot, parts),
        *(NameEntry(word, meaning) for word, meaning in words.items()),
    )
    # Reversed, so that the first entry of a name replaces the later ones.
    return list({entry.name: entry for entry in reversed(entries)}.values())[::-1]


def _of_sections(root: Node | None, sections: Mapping[NodePath, str]) -> Iterator[NameEntry]:
    """Yield the keys of sections, or the names of their items."""
    for path, noun in sections.items():
        match node_at(root, *path):
            case MappingNode(entries=entries):
                yield from (NameEntry(name, noun, entry.key.span) for name, entry in entries.items())
            case SequenceNode(items=items):
                names = (item.get("name") for item in items if isinstance(item, MappingNode))
                yield from (
                    NameEntry(name.text, noun, name.span) for name in names if isinstance(name, ScalarNode)
                )


def _options(namespace: Namespace, kind: str, path: NodePath) -> list[NameEntry]:
    """Return the options of the action at `path`, or the components of a range for each member of a group."""
    only = [*namespace.scenario.action] if len(namespace.scenario.action) == 1 else [""]
    # scripts / NAME / ACTION, tests / NAME / actions / STEP / ACTION, and ACTION below the section `action`
    index = {"scripts": 2, "tests": 4}.get(str(*path[:1]), 1)
    name = str(path[index]) if len(path) > index else only[0]  # an action of one part needs no name
    part = namespace.scenario.action.get(name)
    if isinstance(part, DiscreteAction):
        return list(_of_sections(namespace.values.root, {("action", name, "choices"): "an option"}))
    if kind == "option" or part is None:
        return []
    symbol = namespace.resolve(name)
    components = symbol.type.components if symbol is not None and symbol.type is not None else None
    return [
        _keyed(namespace, ("action", name), f"a component of `{name}`", component)
        for component in components or ()
    ]


def definition(scope: ScenarioScope, name: str) -> NameEntry | None:
    """Return the entry of the dotted `name` of an expression, or of the longest part of it that has a
    meaning.

    On board of a robot its own sensors, poses and received fields come first.
    """
    robot = scope.robot if isinstance(scope, RobotScope) else None
    words = name.split(".")
    for length in range(len(words), 0, -1):
        part = ".".join(words[:length])
        entry = _on_board(scope.namespace, robot, part) or _anywhere(scope.namespace, part)
        if entry:
            return entry
    return None


def _on_board(namespace: Namespace, robot: str | None, name: str) -> NameEntry | None:
    resolved = namespace.robots.get(robot) if robot else None
    if resolved is None:
        return None
    tables = (
        (resolved.spec.sensors, "sensors", "a sensor"),
        (resolved.spec.poses, "poses", "a pose"),
        (resolved.spec.receive or {}, "receive", "received"),
    )
    return next(
        (
            _keyed(namespace, ("robots", resolved.name, key, name), noun)
            for table, key, noun in tables
            if name in table
        ),
        None,
    )


def _anywhere(namespace: Namespace, name: str) -> NameEntry | None:
    if name in namespace.definitions or name in namespace.walls:
        return _one_defined(namespace, name)
    robot, _, part_name = name.partition(".")
    if not part_name:
        return None
    sections = ("sensors", "groups", "joints", "links")
    return next((part for part in _parts(namespace, robot, sections) if part.name == part_name), None)


def _defined(namespace: Namespace, names: Iterable[str]) -> list[NameEntry]:
    """Return the names of the namespace; those of the language have no place."""
    return [_one_defined(namespace, name) for name in dict.fromkeys(names)]


def _one_defined(namespace: Namespace, name: str) -> NameEntry:
    if name in namespace.definitions:
        definition = namespace.definitions[name]
        path = definition.path
        # The options of a choice set this variable.
        if definition.origin is Origin.ACTION and path[-1] != name:
            node, _, steps = descend(namespace.values.root, (*path, "choices"))
            options = node.entries if isinstance(node, MappingNode) and steps > len(path) else {}
            setting = (
                option
                for option, entry in options.items()
                if isinstance(entry.value, MappingNode) and name in entry.value.entries
            )
            path = next(((*path, "choices", option, name) for option in setting), path)
        return _keyed(namespace, path, definition.origin.value, name)
    if name in namespace.walls:  # the arena, whose name the language gives
        return _keyed(namespace, ("world", name), "the walls of the arena")
    return NameEntry(name, "built in")


def _keyed(namespace: Namespace, path: NodePath, noun: str, name: str | None = None) -> NameEntry:
    return NameEntry(name or str(path[-1]), noun, namespace.values.key_span(path))


def _parts(namespace: Namespace, robot: str, sections: tuple[str, ...]) -> Iterator[NameEntry]:
    """Yield the parts of robots, by short names of one `robot`, or by full names of all."""
    for resolved in [namespace.robots.get(robot)] if robot else namespace.robots.values():
        if resolved is not None:
            for part in _parts_of(namespace, resolved, sections):
                yield part if robot else part._replace(name=f"{resolved.name}.{part.name}")


def _parts_of(namespace: Namespace, robot: ResolvedRobot, sections: tuple[str, ...]) -> Iterator[NameEntry]:
    home: NodePath = ("robots", robot.name)
    if "sensors" in sections:
        for name, sensor in robot.spec.sensors.items():
            yield _keyed(namespace, (*home, "sensors", name), f"a sensor ({sensor.type})")
    if "actuators" in sections:
        for name, actuator in robot.spec.actuators.items():
            yield _keyed(namespace, (*home, "actuators", name), f"an actuator ({actuator.type})")
    for name, (kind, members) in robot.groups.items():
        if "groups" in sections or ("joints" if kind is Kind.JOINTS else "link groups") in sections:
            yield _keyed(namespace, (*home, "groups", name), f"{kind.description} ({', '.join(members)})")
    if "joints" in sections:
        for joint in robot.model.moving_joints:
            yield NameEntry(
                joint.name, f"{with_article(joint.type)} joint", robot.file.joint_spans.get(joint.name)
            )
    if "links" in sections:
        for link in robot.link_names:
            yield NameEntry(link, "a link", robot.file.link_spans.get(link))


# The schema has a list once for each key that takes it, and for each robot.
_MAX_NAMES = 500
_MAX_ROBOTS = 12

_ON_BOARD = frozenset({"actuator", "joint", "joints", "link", "links", "sensor"})
"""The kinds whose names differ between robots."""
_SUPERVISED = {
    "signal": Context.SIGNAL,
    "reward": Context.REWARD,
    "ending": Context.ENDING,
    "forbid": Context.FORBID,
    "script": Context.SCRIPT,
    "test": Context.TEST,
    "goal": Context.GOAL,
    "receive": Context.RECEIVE,
}


def scenario_names(checked: CheckedScenario) -> ScenarioNames:
    """Return the names of a scenario, of all its agents; none if its text could not be read."""
    agents: list[NodePath] = [("agents", agent) for agent in checked.agents] or [()]
    namespaces = [namespace for agent in agents if (namespace := namespace_at(checked, agent)) is not None]
    if not namespaces:
        return ScenarioNames()
    everywhere = {
        kind: _offer(_joined(_named(checked, kind, agent) for agent in agents))
        for kind in REFERENCE_KINDS
        if kind not in _ON_BOARD
    }
    choices = {
        option: "an option"
        for namespace in namespaces
        for part in namespace.scenario.action.values()
        if isinstance(part, DiscreteAction)
        for option in part.choices
    }
    is_whole = all(
        all(namespace.robots.values())
        and not any(path[:1] == ("robots",) for path in namespace.scenario.pruned)
        for namespace in namespaces
    )
    everywhere["choice"] = _offer(choices)
    everywhere["joints"] = _offer(
        _joined(_named(checked, "joints", agent) for agent in agents), only=is_whole
    )
    everywhere |= _expressions(namespaces)
    robots = {robot.name: robot for namespace in namespaces for robot in namespace.resolved_robots}
    actions = [action for namespace in namespaces for action in namespace.scenario.action]
    return ScenarioNames(
        everywhere,
        {
            name: _names_on_board(checked, robot, actions)
            for name, robot in islice(robots.items(), _MAX_ROBOTS)
        },
    )


def _joined(names: Iterable[Mapping[str, str]]) -> dict[str, str]:
    """Return the names of all agents; those of the first one come first."""
    return {name: meaning for of_agent in names for name, meaning in of_agent.items()}


def _offer(descriptions: Mapping[str, str], *, only: bool = False) -> OfferedNames:
    return OfferedNames(descriptions if len(descriptions) <= _MAX_NAMES else {}, only)


def _expressions(namespaces: Iterable[Namespace]) -> Names:
    """Return the names that an expression of the supervisor may use, by kind of expression."""
    offers: dict[str, dict[str, str]] = {}
    for namespace in namespaces:
        scopes = {word: SupervisorScope(namespace, context).names() for word, context in _SUPERVISED.items()}
        parameters = dict.fromkeys(("require", "parameter"), namespace.names_of(Origin.PARAMETER))
        for word, names in (scopes | parameters).items():
            offers.setdefault(f"{word} expression", {}).update(_describe_names(namespace, names))
    return {word: _offer(names) for word, names in offers.items()}


def _describe_names(namespace: Namespace, names: Iterable[str]) -> dict[str, str]:
    """Return each name with its meaning, and a parameter with its value."""
    origins = {name: origin.value if (origin := namespace.origin(name)) else "built in" for name in names}
    return {
        name: f"{meaning}: {namespace.scenario.parameters[name]}"
        if name in namespace.scenario.parameters
        else meaning
        for name, meaning in origins.items()
    }


def _names_on_board(checked: CheckedScenario, robot: ResolvedRobot, actions: Iterable[str]) -> Names:
    """Return the parts of one robot by their short names; those of its file are checked, and patterns over
    them never are."""
    home: NodePath = ("robots", robot.name)
    groups = dict.fromkeys(robot.spec.groups, "a group")
    joints = (
        groups
        | _named(checked, "joints", home)
        | {joint.name: _described(joint) for joint in robot.model.moving_joints}
    )
    links = groups | _named(checked, "links", home)
    sensors, actuators = _named(checked, "sensor", home), _named(checked, "actuator", home)
    received = dict.fromkeys(robot.spec.receive or {}, "received") | dict.fromkeys(actions, "an action")
    parts = {
        **dict.fromkeys(("joint", "joints", "joint pattern"), _offer(joints, only=True)),
        "link": _offer(_named(checked, "link", home), only=True),
        **dict.fromkeys(("links", "link pattern"), _offer(links, only=True)),
        "joint or link pattern": _offer(links | joints, only=True),
    }
    poses = dict.fromkeys(robot.spec.poses, "a pose")
    names_by_word = {"emit": sensors, "apply": received | sensors | poses}
    return {
        **parts,
        "sensor": _offer(sensors),
        "actuator": _offer(actuators),
        **{f"{word} expression": _offer(names) for word, names in names_by_word.items()},
    }


def _named(checked: CheckedScenario, kind: str, path: NodePath = ()) -> dict[str, str]:
    return {entry.name: entry.description for entry in names_at(checked, kind, path)}


def _described(joint: Joint) -> str:
    """Return a joint in a few words: `revolute, -0.5 .. 0.5 rad`."""
    lower, upper = joint.limit.lower, joint.limit.upper
    unit = "m" if joint.type == "prismatic" else "rad"
    return (
        joint.type if lower is None or upper is None else f"{joint.type}, {lower:.4g} .. {upper:.4g} {unit}"
    )

"""The names of a scenario by kind, for editors and for its JSON Schema."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import NamedTuple

from deepbots_cli.compiler import CheckedScenario
from deepbots_cli.compiler.evaluation import PLAIN_DRIVERS
from deepbots_cli.compiler.namespace import Namespace, Origin, SupervisorScope
from deepbots_cli.compiler.robots import ResolvedRobot
from deepbots_cli.diagnostics import Span
from deepbots_cli.document.nodes import MappingNode, NodePath, descend
from deepbots_cli.expressions.types import Context, Kind
from deepbots_cli.robots.model import Joint
from deepbots_cli.scenario.agent import DiscreteAction
from deepbots_cli.scenario.fields import with_article
from deepbots_cli.scenario.json_schema import Names, OfferedNames, ScenarioNames
from deepbots_cli.scenario.scenario import Scenario

_OF_ROBOTS = {
    "joint": ("joints",),
    "joints": ("joints",),
    "link": ("links",),
    "links": ("links",),
    "joint or link": ("joints", "links"),
    "sensor": ("sensors",),
    "actuator": ("actuators",),
    "sensor, reading or actuator": ("sensors", "actuators"),
    "group": ("groups", "actuators"),
    "bodies or links": ("links",),
    "body or link": ("links",),
    "body": (),
    "bodies": (),
}
"""The parts of a robot that each kind may name."""
_ORIGINS = {
    "robot": (Origin.ROBOT,),
    "line": (Origin.LINE,),
    "object": (Origin.OBJECT,),
    "setting": (Origin.PARAMETER,),
    "parameter or signal": (Origin.PARAMETER, Origin.SIGNAL),
}


class NameEntry(NamedTuple):
    """A name, its meaning (`a revolute joint`), and the place of its definition; None for a name that is part
    of the language."""

    name: str
    description: str
    span: Span | None = None


def names_at(checked: CheckedScenario, kind: str, path: NodePath = ()) -> list[NameEntry]:
    """Return the names that a `Reference` or a `Pattern` of this kind may take at `path` of the scenario;
    none if they are unknown.

    Inside of a robot its parts go by their short names, elsewhere by full ones, as `cart.pole_hinge`.
    """
    namespace = checked.namespace
    if namespace is None or checked.spec is None:
        return []
    if kind in _OF_ROBOTS:
        return list(_of_robots(namespace, kind, path))
    if kind in ("action", "choice", "option", "layout", *_OF_TESTS):
        return _keys(namespace, kind, path)
    if kind == "region":
        return [NameEntry("arena", "the floor of the arena")]
    if kind == "value":
        return _defined(namespace, SupervisorScope(namespace, Context.OBSERVATION).names())
    return _defined(namespace, namespace.names_of(*_ORIGINS.get(kind, ())))


def _of_robots(namespace: Namespace, kind: str, path: NodePath) -> Iterator[NameEntry]:
    robot = str(path[1]) if path[:1] == ("robots",) and len(path) > 1 else None
    if kind.startswith(("body", "bodies")):
        yield from _bodies(namespace)
        robot = None
    if kind == "bodies or links":  # the parts that a touch sensor feels
        yield NameEntry("ground", "the ground")
        yield from _defined(namespace, namespace.walls)
    yield from _parts(namespace, robot, _OF_ROBOTS[kind])


def _keys(namespace: Namespace, kind: str, path: NodePath) -> list[NameEntry]:
    """Return the names that are keys of one section."""
    if kind == "action":
        return [_keyed(namespace, ("action", name), "an action") for name in namespace.scenario.action]
    if kind == "layout":
        return [
            _keyed(namespace, ("reset", "layouts", name), "a layout")
            for name in namespace.scenario.reset.layouts
        ]
    if kind in _OF_TESTS:
        return _of_tests(namespace, kind)
    only = [*namespace.scenario.action] if len(namespace.scenario.action) == 1 else [""]
    name = action_at(path) or only[0]  # an action of one part needs no name
    part = namespace.scenario.action.get(name)
    if isinstance(part, DiscreteAction):
        return [
            _keyed(namespace, ("action", name, "choices", option), "an option") for option in part.choices
        ]
    if kind == "option":
        return []
    symbol = namespace.resolve(name) if part is not None else None  # a range for each member of a group
    components = symbol.type.components if symbol is not None and symbol.type is not None else None
    return [
        _keyed(namespace, ("action", name), f"a component of `{name}`", component)
        for component in components or ()
    ]


def action_at(path: NodePath) -> str:
    """Return the action that a place of a script, of an action of a test or of the section `action` belongs
    to; empty for none."""
    index = {"scripts": 2, "tests": 4}.get(str(path[0]), 1) if path else 1
    return str(path[index]) if len(path) > index else ""


_OF_TESTS = ("driver", "case", "stage", "ending")


def _of_tests(namespace: Namespace, kind: str) -> list[NameEntry]:
    """Return the names that a test may use."""
    spec = namespace.scenario
    limits = spec.truncation.model_fields_set if spec.truncation else ()
    keys: dict[str, list[tuple[NodePath, str, str]]] = {
        "driver": [(("scripts", name), "a script", name) for name in spec.scripts],
        "case": [
            (("evaluation", "cases", name), "a case of the evaluation", name)
            for name in spec.evaluation.cases
        ],
        "stage": [
            (("curriculum", index, "name"), "a stage of the curriculum", stage.name)
            for index, stage in enumerate(spec.stages)
        ],
        "ending": [(("truncation", name), "a limit", name) for name in limits],
    }
    free = {"driver": [NameEntry(name, "actions without a script") for name in PLAIN_DRIVERS]}
    endings = _defined(namespace, namespace.names_of(Origin.ENDING)) if kind == "ending" else []
    return [*endings, *(_keyed(namespace, *key) for key in keys[kind]), *free.get(kind, ())]


def definition(checked: CheckedScenario, name: str, robot: str | None = None) -> NameEntry | None:
    """Return the entry of the dotted `name` of an expression, or of the longest part of it that has a
    meaning.

    On board of `robot` its own sensors, poses and received fields come first.
    """
    namespace = checked.namespace
    words = name.split(".")
    for length in range(len(words) if namespace is not None else 0, 0, -1):
        part = ".".join(words[:length])
        entry = namespace and (_on_board(namespace, robot, part) or _anywhere(namespace, part))
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


def _bodies(namespace: Namespace) -> list[NameEntry]:
    return _defined(namespace, namespace.names_of(Origin.ROBOT, Origin.OBJECT))


def _parts(namespace: Namespace, robot: str | None, sections: tuple[str, ...]) -> Iterator[NameEntry]:
    """Yield the parts of robots, by short names of one `robot`, or by full names of all."""
    for resolved in [namespace.robots.get(robot)] if robot else namespace.robots.values():
        if resolved is not None:
            for part in _parts_of(namespace, resolved, sections):
                yield (
                    part if robot or resolved is None else part._replace(name=f"{resolved.name}.{part.name}")
                )


def _parts_of(namespace: Namespace, robot: ResolvedRobot, sections: tuple[str, ...]) -> Iterator[NameEntry]:
    home: NodePath = ("robots", robot.name)
    if "sensors" in sections:
        for name, sensor in robot.spec.sensors.items():
            yield _keyed(namespace, (*home, "sensors", name), f"a sensor ({sensor.type})")
    if "actuators" in sections:
        for name, actuator in robot.spec.actuators.items():
            yield _keyed(namespace, (*home, "actuators", name), f"an actuator ({actuator.type})")
    for name, (kind, members) in robot.groups.items():
        if "groups" in sections or ("joints" if kind is Kind.JOINTS else "links") in sections:
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

_PLACES: Mapping[str, NodePath] = {
    "body": ("reset", "place"),
    "body or link": ("disturbances",),
    "bodies": ("robots",),
    "bodies or links": ("robots",),
    "robot": ("agent", "each"),
    "group": ("action",),
    "line": ("reset", "place"),
    "object": ("reset", "place"),
    "layout": ("reset", "layout"),
    "setting": ("curriculum",),
    "action": ("scripts",),
    **dict.fromkeys(_OF_TESTS, ("tests",)),
    "value": ("observation",),
    "parameter or signal": ("augment",),
}
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
    """Return the names of a scenario; none if its text could not be read."""
    namespace, spec = checked.namespace, checked.spec
    if namespace is None or spec is None:
        return ScenarioNames()
    everywhere = {kind: _offer(_named(checked, kind, path)) for kind, path in _PLACES.items()}
    choices = {
        option: "an option"
        for part in spec.action.values()
        if isinstance(part, DiscreteAction)
        for option in part.choices
    }
    is_whole = all(namespace.robots.values()) and not any(path[:1] == ("robots",) for path in spec.pruned)
    everywhere["choice"] = _offer(choices)
    everywhere["joints"] = _offer(_named(checked, "joints"), only=is_whole)
    everywhere |= _expressions(namespace)
    robots = namespace.resolved_robots[:_MAX_ROBOTS]
    return ScenarioNames(everywhere, {robot.name: _names_on_board(checked, robot, spec) for robot in robots})


def _offer(descriptions: Mapping[str, str], *, only: bool = False) -> OfferedNames:
    return OfferedNames(descriptions if len(descriptions) <= _MAX_NAMES else {}, only)


def _expressions(namespace: Namespace) -> Names:
    """Return the names that an expression of the supervisor may use, by kind of expression."""
    scopes = {word: SupervisorScope(namespace, context).names() for word, context in _SUPERVISED.items()}
    parameters = dict.fromkeys(("require", "parameter"), namespace.names_of(Origin.PARAMETER))
    return {
        f"{word} expression": _offer(_describe_names(namespace, names))
        for word, names in (scopes | parameters).items()
    }


def _describe_names(namespace: Namespace, names: Iterable[str]) -> dict[str, str]:
    """Return each name with its meaning, and a parameter with its value."""
    origins = {name: origin.value if (origin := namespace.origin(name)) else "built in" for name in names}
    return {
        name: f"{meaning}: {namespace.scenario.parameters[name]}"
        if name in namespace.scenario.parameters
        else meaning
        for name, meaning in origins.items()
    }


def _names_on_board(checked: CheckedScenario, robot: ResolvedRobot, spec: Scenario) -> Names:
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
    received = dict.fromkeys(robot.spec.receive or {}, "received") | dict.fromkeys(spec.action, "an action")
    parts = {
        **dict.fromkeys(("joint", "joints", "joint pattern"), _offer(joints, only=True)),
        **dict.fromkeys(("link", "links", "link pattern"), _offer(links, only=True)),
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

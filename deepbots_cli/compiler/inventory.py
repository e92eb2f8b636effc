"""The names of a scenario by what they stand for, and where each is defined: for editors, which offer them and lead there."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import NamedTuple

from deepbots_cli.compiler import Checked
from deepbots_cli.compiler.namespace import Namespace, Origin
from deepbots_cli.compiler.robots import RobotScene
from deepbots_cli.compiler.scopes import SupervisorScope
from deepbots_cli.diagnostics import Span
from deepbots_cli.document.nodes import Mapping, Path, descend
from deepbots_cli.expressions.types import Context, Kind
from deepbots_cli.scenario.fields import article
from deepbots_cli.scenario.scenario import Scenario
from deepbots_cli.scenario.task import DiscreteAction

_OF_ROBOTS = {
    "joint": ("joints",),
    "joints": ("joints",),
    "link": ("links",),
    "links": ("links",),
    "joint or link": ("joints", "links"),
    "sensor": ("sensors",),
    "actuator": ("actuators",),
    "group": ("groups", "actuators"),
    "bodies or links": ("links",),
    "body or link": ("links",),
    "body": (),
}
"""Which parts of a robot each kind may name."""
_ORIGINS = {
    "robot": (Origin.ROBOT,),
    "line": (Origin.LINE,),
    "object": (Origin.OBJECT,),
    "setting": (Origin.PARAMETER,),
    "parameter or signal": (Origin.PARAMETER, Origin.SIGNAL),
}


class Named(NamedTuple):
    """A name, what it stands for (`a revolute joint`), and where it is defined; None for what the language gives."""

    name: str
    what: str
    span: Span | None = None


def names(checked: Checked, kind: str, path: Path = ()) -> list[Named]:
    """What a `Reference` or a `Pattern` of this kind may name at `path`, a place of the scenario; nothing where that is not known.

    Inside of a robot its parts go by their short names, elsewhere by full ones, as `cart.pole_hinge`.
    """
    if checked.namespace is None or checked.spec is None:
        return []
    if kind in _OF_ROBOTS:
        return list(_of_robots(checked.namespace, kind, path))
    if kind in ("action", "choice", "option", "layout"):
        return _keys(checked.namespace, checked.spec, kind, path)
    return [Named("arena", "the floor of the arena")] if kind == "region" else _of_namespace(checked.namespace, kind, path)


def _of_robots(namespace: Namespace, kind: str, path: Path) -> Iterator[Named]:
    robot = str(path[1]) if path[:1] == ("robots",) and len(path) > 1 else None
    if kind.startswith(("body", "bodies")):
        yield from _bodies(namespace)
        robot = None
    if kind == "bodies or links":  # what a touch sensor feels
        yield Named("ground", "the ground")
        yield from _defined(namespace, namespace.walls)
    yield from _parts(namespace, robot, _OF_ROBOTS[kind])


def _keys(namespace: Namespace, spec: Scenario, kind: str, path: Path) -> list[Named]:
    """Names that are keys of one section."""
    if kind == "action":
        return [_keyed(namespace, ("action", name), "an action") for name in spec.action]
    if kind == "layout":
        return [_keyed(namespace, ("reset", "layouts", name), "a layout") for name in spec.reset.layouts]
    name = str(path[2] if path[:1] == ("scripts",) and len(path) > 2 else path[1] if len(path) > 1 else "")
    part = spec.action.get(name)
    if isinstance(part, DiscreteAction):
        return [_keyed(namespace, ("action", name, "choices", option), "an option") for option in part.choices]
    if kind == "option":
        return []
    symbol = namespace.settle(name) if part is not None else None  # a range for each member of a group
    components = symbol.type.components if symbol is not None and symbol.type is not None else None
    return [_keyed(namespace, ("action", name), f"a component of `{name}`", component) for component in components or ()]


def _of_namespace(namespace: Namespace, kind: str, path: Path) -> list[Named]:
    if kind == "value":
        return _defined(namespace, SupervisorScope(namespace, Context.OBSERVATION).names())
    return _defined(namespace, namespace.named(*_ORIGINS.get(kind, ())))


def definition(checked: Checked, name: str, robot: str | None = None) -> Named | None:
    """What the dotted `name` of an expression, or the longest part of it that means something, leads to.

    On board of `robot` its own sensors, poses and received fields come first.
    """
    namespace = checked.namespace
    words = name.split(".")
    for length in range(len(words) if namespace is not None else 0, 0, -1):
        part = ".".join(words[:length])
        found = namespace and (_on_board(namespace, robot, part) or _anywhere(namespace, part))
        if found:
            return found
    return None


def _on_board(namespace: Namespace, robot: str | None, name: str) -> Named | None:
    scene = namespace.robots.get(robot) if robot else None
    if scene is None:
        return None
    own = (
        (scene.spec.sensors, "sensors", "a sensor"),
        (scene.spec.poses, "poses", "a pose"),
        (scene.spec.receive or {}, "receive", "received"),
    )
    return next((_keyed(namespace, ("robots", scene.name, key, name), what) for table, key, what in own if name in table), None)


def _anywhere(namespace: Namespace, name: str) -> Named | None:
    if name in namespace.definitions or name in namespace.walls:
        return _one_defined(namespace, name)
    robot, _, rest = name.partition(".")
    if not rest:
        return None
    sections = ("sensors", "groups", "joints", "links")
    return next((part for part in _parts(namespace, robot, sections) if part.name == rest), None)


def _defined(namespace: Namespace, known: Iterable[str]) -> list[Named]:
    """Names of the namespace; those that the language gives stand nowhere."""
    return [_one_defined(namespace, name) for name in dict.fromkeys(known)]


def _one_defined(namespace: Namespace, name: str) -> Named:
    if name in namespace.definitions:
        return _by_definition(namespace, name)
    if name in namespace.walls:  # the arena, whose name the language gives
        return _keyed(namespace, ("world", name), "the walls of the arena")
    return Named(name, "built in")


def _by_definition(namespace: Namespace, name: str) -> Named:
    found = namespace.definitions[name]
    path = found.path
    if found.origin is Origin.ACTION and path[-1] != name:  # a variable that the options of a choice set
        node, _, steps = descend(namespace.values.root, (*path, "choices"))
        options = node.entries if isinstance(node, Mapping) and steps > len(path) else {}
        setting = (option for option, entry in options.items() if isinstance(entry.value, Mapping) and name in entry.value.entries)
        path = next(((*path, "choices", option, name) for option in setting), path)
    return _keyed(namespace, path, found.origin.value, name)


def _keyed(namespace: Namespace, path: Path, what: str, name: str | None = None) -> Named:
    return Named(name or str(path[-1]), what, namespace.values.key_span(path))


def _bodies(namespace: Namespace) -> list[Named]:
    return _defined(namespace, namespace.named(Origin.ROBOT, Origin.OBJECT))


def _parts(namespace: Namespace, robot: str | None, sections: tuple[str, ...]) -> Iterator[Named]:
    """What robots are made of, by short names of one `robot`, or by full names of all."""
    scenes = [namespace.robots.get(robot)] if robot else namespace.robots.values()
    for scene in scenes:
        for part in _parts_of(namespace, scene, sections) if scene is not None else ():
            yield part if robot or scene is None else part._replace(name=f"{scene.name}.{part.name}")


def _parts_of(namespace: Namespace, scene: RobotScene, sections: tuple[str, ...]) -> Iterator[Named]:
    home: Path = ("robots", scene.name)
    for name, sensor in scene.spec.sensors.items() if "sensors" in sections else ():
        yield _keyed(namespace, (*home, "sensors", name), f"a sensor ({sensor.type})")
    for name, actuator in scene.spec.actuators.items() if "actuators" in sections else ():
        yield _keyed(namespace, (*home, "actuators", name), f"an actuator ({actuator.type})")
    for name, (kind, members) in scene.groups.items():
        if "groups" in sections or ("joints" if kind is Kind.JOINTS else "links") in sections:
            yield _keyed(namespace, (*home, "groups", name), f"{kind.words} ({', '.join(members)})")
    for joint in scene.model.moving_joints if "joints" in sections else ():
        yield Named(joint.name, f"{article(joint.type)} joint", scene.file.joint_spans.get(joint.name))
    for link in scene.link_names if "links" in sections else ():
        yield Named(link, "a link", scene.file.link_spans.get(link))

"""The names of a scenario as its JSON Schema lists them; from whatever could be read of a file with errors."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from deepbots_cli.compiler import Checked
from deepbots_cli.compiler.inventory import names
from deepbots_cli.compiler.namespace import Namespace, Origin
from deepbots_cli.compiler.robots import RobotScene
from deepbots_cli.compiler.scopes import SupervisorScope
from deepbots_cli.document.nodes import Path
from deepbots_cli.expressions.types import Context
from deepbots_cli.robots.model import Joint
from deepbots_cli.scenario.json_schema import Known, Names, Offer
from deepbots_cli.scenario.scenario import Scenario
from deepbots_cli.scenario.task import DiscreteAction

# What is listed stands in the schema once for each key that takes it, and for each robot.
_MOST_NAMES = 500
_MOST_ROBOTS = 12

_PLACES: Mapping[str, Path] = {
    "body": ("reset", "place"),
    "body or link": ("disturbances",),
    "bodies or links": ("robots",),
    "robot": ("agent", "each"),
    "group": ("action",),
    "line": ("reset", "place"),
    "object": ("reset", "place"),
    "layout": ("reset", "layout"),
    "setting": ("curriculum",),
    "action": ("scripts",),
    "value": ("observation",),
    "parameter or signal": ("augment",),
}
_SUPERVISED = {
    "signal": Context.SIGNAL,
    "reward": Context.REWARD,
    "ending": Context.ENDING,
    "forbid": Context.FORBID,
    "script": Context.SCRIPT,
    "goal": Context.GOAL,
    "receive": Context.RECEIVE,
}


def known(checked: Checked) -> Known:
    """What is known of the names of a scenario; nothing where its text could not be read."""
    namespace, spec = checked.namespace, checked.spec
    if namespace is None or spec is None:
        return Known()
    everywhere = {kind: _offer(_named(checked, kind, path)) for kind, path in _PLACES.items()}
    choices = {option: "an option" for part in spec.action.values() if isinstance(part, DiscreteAction) for option in part.choices}
    is_whole = all(namespace.robots.values()) and not any(path[:1] == ("robots",) for path in spec.pruned)
    everywhere["choice"] = _offer(choices)
    everywhere["joints"] = _offer(_named(checked, "joints"), only=is_whole)
    everywhere |= _expressions(namespace, spec)
    scenes = [scene for scene in namespace.robots.values() if scene is not None]
    return Known(everywhere, {scene.name: _on_board(checked, scene, spec) for scene in scenes[:_MOST_ROBOTS]})


def _offer(said: Mapping[str, str], *, only: bool = False) -> Offer:
    return Offer(said if len(said) <= _MOST_NAMES else {}, only)


def _expressions(namespace: Namespace, spec: Scenario) -> Names:
    """Where an expression of the supervisor is due, the names that may stand in it."""
    scopes = {word: SupervisorScope(namespace, context).names() for word, context in _SUPERVISED.items()}
    parameters = dict.fromkeys(("require", "parameter"), namespace.named(Origin.PARAMETER))
    return {f"{word} expression": _offer(_said(namespace, spec, found)) for word, found in (scopes | parameters).items()}


def _said(namespace: Namespace, spec: Scenario, found: Iterable[str]) -> dict[str, str]:
    """Each name with what it stands for, and a parameter with its value."""
    origins = {name: origin.value if (origin := namespace.origin(name)) else "built in" for name in found}
    return {name: f"{what}: {spec.parameters[name]}" if name in spec.parameters else what for name, what in origins.items()}


def _on_board(checked: Checked, scene: RobotScene, spec: Scenario) -> Names:
    """The parts of one robot by their short names; those of its file are checked, and patterns over them never are."""
    home: Path = ("robots", scene.name)
    groups = dict.fromkeys(scene.spec.groups, "a group")
    joints = groups | _named(checked, "joints", home) | {joint.name: _described(joint) for joint in scene.model.moving_joints}
    links = groups | _named(checked, "links", home)
    sensors, actuators = _named(checked, "sensor", home), _named(checked, "actuator", home)
    received = dict.fromkeys(scene.spec.receive or {}, "received") | dict.fromkeys(spec.action, "an action")
    parts = {
        **dict.fromkeys(("joint", "joints", "joint pattern"), _offer(joints, only=True)),
        **dict.fromkeys(("link", "links", "link pattern"), _offer(links, only=True)),
        "joint or link pattern": _offer(links | joints, only=True),
    }
    poses = dict.fromkeys(scene.spec.poses, "a pose")
    own = {"emit": sensors, "apply": received | sensors | poses}
    return {
        **parts,
        "sensor": _offer(sensors),
        "actuator": _offer(actuators),
        **{f"{word} expression": _offer(found) for word, found in own.items()},
    }


def _named(checked: Checked, kind: str, path: Path = ()) -> dict[str, str]:
    return {found.name: found.what for found in names(checked, kind, path)}


def _described(joint: Joint) -> str:
    """A joint in a few words: `revolute, -0.5 .. 0.5 rad`."""
    lower, upper = joint.limit.lower, joint.limit.upper
    unit = "m" if joint.type == "prismatic" else "rad"
    return joint.type if lower is None or upper is None else f"{joint.type}, {lower:.4g} .. {upper:.4g} {unit}"

"""Two scenarios compared by meaning: what `deepbots diff` shows.

A compiled scenario is taken apart into items. An item has a path in the words of the language, the group of differences that it
belongs to, and a value as plain data: dictionaries, lists, text and numbers of twelve digits. Items whose values differ are changes,
which show what both scenarios say there.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Any, Literal, NamedTuple

from deepbots_cli import canonical, interface
from deepbots_cli.cli.sources import Opened
from deepbots_cli.cli.tables import cell, formula
from deepbots_cli.expressions.scalar import Const, Draw, Scalar
from deepbots_cli.program import Program
from deepbots_cli.program.resets import RandomizedParameter
from deepbots_cli.program.world import RobotBody, WorldModel

VALUE = " value"
"""Marks the meaning of an item, apart from the range that a policy relies on: `observation.speed value`."""
LOOK = "look of "
_LOOKS = ("colour", "visuals")
_AXES = {"rpy": "roll pitch yaw"} | dict.fromkeys(("", "xyz", "size", "axis", "spacing", "scale"), "x y z")
"""Names of the three components of a member, and of a whole value such as gravity."""
_LISTED = 3
_NAME = re.compile(r"[a-z_][a-z0-9_]*")


class Group(StrEnum):
    """The consequence of a difference, the gravest first."""

    policy = "policy"
    task = "task"
    world = "world"
    training = "training"
    cosmetic = "cosmetic"

    @property
    def rank(self) -> int:
        return list(Group).index(self)


class Item(NamedTuple):
    """A part of a scenario; `value` is plain data."""

    group: Group
    value: Any


Kind = Literal["changed", "added", "removed"]


@dataclass(frozen=True)
class Change:
    """`one` and `other` are the texts of both sides; `through` names the parameters that differ where the texts are the same."""

    path: str
    group: Group
    kind: Kind
    one: str
    other: str
    through: tuple[str, ...] = ()


def changes(one: Opened, other: Opened) -> list[Change]:
    """All differences, the gravest group first; empty if both scenarios compile to the same, except for the paths of files."""
    found = [*_of_items(one, other), *_of_variants(one, other)]
    if not found and canonical.digest(one.ir) != canonical.digest(other.ir):
        here, there = (_plain(_without_paths(side.ir)) for side in (one, other))
        cosmetic = "last digits" if here == there else "order of keys" if _unordered(here) == _unordered(there) else None
        found = [Change(cosmetic or "other parts", Group.cosmetic if cosmetic else Group.task, "changed", "", "")]
    gravest: dict[str, Change] = {}
    for change in sorted(found, key=lambda change: change.group.rank):
        gravest.setdefault(change.path, change)
    return list(gravest.values())


def _of_items(one: Opened, other: Opened) -> Iterator[Change]:
    before, after, altered = items(one.ir), items(other.ir), _altered_parameters(one, other)
    for path in dict.fromkeys((*before, *after)):
        old, new = before.get(path), after.get(path)
        if old and new and old.value == new.value:
            continue
        if path.startswith("order of ") and not (old and new and sorted(old.value) == sorted(new.value)):
            continue  # names that only one of them has are changes of their own
        shown = path.removesuffix(VALUE)
        section, _, name = shown.partition(".")
        if section == "signals" and any(name in side.names("augment") for side in (one, other)):
            shown = f"augment.{name}"
        written = f"{shown.removeprefix(LOOK)}.colour" if shown.startswith(LOOK) else shown
        texts = one.wording(written), other.wording(written)
        used = _NAME.findall(texts[0]) if texts[0] == texts[1] else ()
        through = tuple(name for name in altered if name in used)
        kind = "changed" if all(texts) else _kind(old is not None, new is not None)
        if texts[0] == texts[1] and not through:
            texts = _differing_values(old, new)
        yield Change(shown, min((item.group for item in (old, new) if item), key=lambda group: group.rank), kind, *texts, through)


def _of_variants(one: Opened, other: Opened) -> Iterator[Change]:
    """Cases and stages, by what each changes in its scenario."""
    for section, before, after in (
        ("evaluation.cases", _variants(one.ir, one.ir.cases), _variants(other.ir, other.ir.cases)),
        ("curriculum", _variants(one.ir, one.ir.curriculum), _variants(other.ir, other.ir.curriculum)),
    ):
        for name in dict.fromkeys((*before, *after)):
            if before.get(name) != after.get(name):
                kind: Literal["changed", "added", "removed"] = (
                    "added" if name not in before else "removed" if name not in after else "changed"
                )
                yield Change(
                    f"{section}.{name}", Group.training, kind, one.wording(f"{section}.{name}"), other.wording(f"{section}.{name}")
                )
        if before.keys() == after.keys() and list(before) != list(after):
            yield Change(f"order of {section}", Group.training, "changed", ", ".join(before), ", ".join(after))


def _kind(before: bool, after: bool) -> Kind:
    return "changed" if before and after else "removed" if before else "added"


def _variants(scenario: Program, entries: Iterable[Any]) -> dict[str, object]:
    base = items(scenario)
    found: dict[str, object] = {}
    for entry in entries:
        made = items(entry.program)
        changed = {path: made.get(path) for path in {**base, **made} if base.get(path) != made.get(path)}
        found[entry.name] = (getattr(entry, "episodes", None), _plain(getattr(entry, "until", None)), changed)
    return found


def _altered_parameters(one: Opened, other: Opened) -> list[str]:
    """The parameters whose texts differ, and those computed from them."""
    names = dict.fromkeys((*one.names("parameters"), *other.names("parameters")))
    texts = {name: (one.wording(f"parameters.{name}"), other.wording(f"parameters.{name}")) for name in names}
    altered = [name for name, (here, there) in texts.items() if here != there]
    while more := [name for name in texts if name not in altered and set(altered) & set(_NAME.findall(texts[name][0]))]:
        altered += more
    return altered


# Items


def items(scenario: Program) -> dict[str, Item]:
    """The items of a scenario by path, without its cases and stages; entries of the same path are one item."""
    placeless = _without_paths(scenario)
    found: dict[str, Item] = {}
    for group, section in ((Group.policy, _policy), (Group.task, _task), (Group.world, _world), (Group.training, _training)):
        for path, value, *other in section(placeless):
            item = Item(other[0] if other else group, _plain(value))
            known = found.get(path)
            found[path] = Item(min(known.group, item.group, key=lambda group: group.rank), [known.value, item.value]) if known else item
    return found


Entry = tuple[str, object] | tuple[str, object, Group]
"""A path, what stands there, and the group where it is not that of the section."""


def _policy(scenario: Program) -> Iterator[Entry]:
    """What a policy relies on: ranges, choices, messages."""
    agreed = interface.interface(scenario)
    for name, text in agreed.items():
        match = re.match(r"message (to|from) robot ([^.]+)\.(.*)", name)
        section = "receive" if match and match[1] == "to" else "emit"
        yield f"robots.{match[2]}.{section}.{match[3]}" if match else "goal.range" if name.startswith("goal") else name, text
    yield "order of what is observed, done and sent", tuple(agreed)


def _task(scenario: Program) -> Iterator[Entry]:
    """Sensors, actuators, observation, reward and endings."""
    for observed in scenario.numbers:
        yield f"observation.{observed.full_name}{VALUE}", observed.scalar
        if observed.noise is not None:
            yield f"observation.{observed.name}.noise", observed.noise
    yield from ((f"observation.{image.name}{VALUE}", image.value.scalar) for image in scenario.images)
    for part in scenario.action:
        forbidden = tuple((option.name, option.forbidden.scalar) for option in getattr(part, "options", ()) if option.forbidden)
        if forbidden:
            yield f"action.{part.name}.forbid", forbidden
    if (goal := scenario.goal) is not None:
        known = {"achieved": goal.achieved.scalars, "desired": goal.targets, "within": goal.within, "noise": goal.achieved.noise}
        yield from ((f"goal.{key}", value) for key, value in known.items() if value is not None)
    yield from _named("signals", scenario.signals)
    yield from _named("reward", scenario.reward)
    yield from ((f"termination.{ending.outcome}.{ending.name}", ending) for ending in scenario.endings)
    yield "order of endings", tuple(ending.name for ending in scenario.endings)
    yield "truncation.max_steps", scenario.truncation.max_steps
    yield "truncation.max_time", scenario.truncation.max_time
    for robot in scenario.robots:
        parts = {"sensors": robot.sensors, "actuators": robot.actuators, "receive": robot.received}
        for section, entries in (parts | {"emit": robot.emitted, "apply": robot.commands}).items():
            yield from _named(f"robots.{robot.name}.{section}", entries, VALUE)
        for layout in (robot.to_robot, robot.from_robot):
            yield f"order of fields {layout.direction} {robot.name}", tuple(field.name for field in layout.fields), Group.policy


def _world(scenario: Program) -> Iterator[Entry]:
    """World, bodies, routes of messages, and starts."""
    world, reset = scenario.world, scenario.reset
    seen = any(sensor.optics for robot in scenario.robots for sensor in robot.sensors)
    for name in ("timestep", "substeps", "gravity", "ground", "arena", "terrain", "light"):
        yield from _with_look(f"world.{name}", getattr(world, name), seen)
    for line in world.lines:
        yield from _with_look(f"world.lines.{line.name}", line, seen)
    for body in world.objects:
        yield from _with_look(f"objects.{body.name.partition('#')[0]}", body, seen)
    for robot in world.robots:
        yield from _body(robot, seen)
    yield "messages.format", scenario.format
    yield "messages.timing", scenario.timing
    for controller in scenario.robots:
        yield "messages.to_robot", controller.to_route
        yield "messages.from_robot", controller.from_route
    yield "agent.repeat", scenario.agent.repeat
    if scenario.agent.each is not None:
        yield f"robots.{scenario.agent.each.robot}.count", scenario.agent.each
    yield from _named("parameters", scenario.parameters)
    yield from _named("disturbances", scenario.disturbances)
    yield from ((f"reset.place.{place.body}", place) for place in reset.placements)
    yield "order of reset.place", tuple(place.body for place in reset.placements)
    for start in reset.joint_starts:
        yield from ((f"reset.set.{start.robot}.{joint}", (position, velocity)) for joint, position, velocity in start.states)
    yield from ((_path_of_draw(entry, world), entry.scalars) for entry in reset.variations)
    yield from ((f"objects.{group.name}.count", group) for group in reset.groups)
    yield from _named("reset.layouts", reset.layouts)
    yield from ((f"reset.{name}", getattr(reset, name)) for name in ("settle", "require", "attempts"))


def _body(robot: RobotBody, seen: bool) -> Iterator[Entry]:
    here, model = f"robots.{robot.name}", robot.model
    yield f"{here}.base", "fixed" if robot.fixed_base else "free"
    yield f"{here}.pose", robot.pose
    yield f"{here}.urdf", model.root
    yield f"name of {here}.urdf", model.name, Group.cosmetic
    touches = any(link.collisions for link in model.links)
    for link in model.links:
        yield from _with_look(f"{here}.links.{link.name}", link, seen or not touches)
    yield from _named(f"{here}.joints", model.joints)


def _path_of_draw(entry: RandomizedParameter, world: WorldModel) -> str:
    """Where a value that is drawn per episode is written; a drawn colour belongs to the look of its body."""
    if entry.what == "colour":
        body, link = entry.of
        is_robot = any(robot.name == body for robot in world.robots)
        return f"{LOOK}robots.{body}.links.{link}" if is_robot else f"{LOOK}objects.{body.partition('#')[0]}"
    first = entry.scalars[0]
    if isinstance(first, Draw):
        return first.stream.partition("#")[0].partition(":")[0]
    return " of ".join(filter(None, (f"drawn {entry.what}", ".".join(filter(None, entry.of)))))


def _training(scenario: Program) -> Iterator[Entry]:
    """Training, evaluation and scripts; and the names of the scenario."""
    yield "name", scenario.name, Group.cosmetic
    yield "summary", scenario.summary, Group.cosmetic
    yield "solved", scenario.solved
    yield "evaluation.episodes", scenario.evaluation.episodes
    if (training := scenario.training) is not None:
        for name in ("algorithm", "total_timesteps", "environments", "action_noise", "replay"):
            yield f"train.{name}", getattr(training, name)
        yield "train.policy.hidden", training.policy.hidden
        yield "train.policy.activation", training.policy.activation
        yield from ((f"train.{entry.name}", entry.value) for entry in training.hyperparameters)
    yield from _named("scripts", scenario.scripts)


def _named(section: str, entries: Iterable[Any], suffix: str = "") -> Iterator[Entry]:
    return ((f"{section}.{entry.name}{suffix}", entry) for entry in entries)


def _with_look(path: str, value: object, seen: bool) -> Iterator[Entry]:
    """What acts, and what only shows; a look counts as the world where a camera sees it or nothing else has a size."""
    acting, looks = _without_looks(_plain(value))
    yield path, acting
    if looks:
        yield f"{LOOK}{path}", looks, Group.world if seen else Group.cosmetic


def _without_looks(data: Any) -> tuple[Any, list[Any]]:
    """Plain data without colours and visuals, and these."""
    if not isinstance(data, dict | list):
        return data, []
    pairs = list(data.items() if isinstance(data, dict) else enumerate(data))
    looks = [value for key, value in pairs if key in _LOOKS and value]
    kept = {}
    for key, value in pairs:
        if key not in _LOOKS:
            kept[key], more = _without_looks(value)
            looks += more
    return (kept if isinstance(data, dict) else list(kept.values())), looks


# Plain data


def _without_paths(scenario: Program) -> Program:
    return canonical.with_files(scenario, lambda file: replace(file, path=""))


def _plain(value: Any) -> Any:
    """A value as plain data: expressions as text, floats to twelve digits, records as dictionaries, named entries by name."""
    if isinstance(value, Const):
        value = value.value
    if isinstance(value, Scalar):
        return formula(value)
    if isinstance(value, float):
        return float(f"{value:.12g}")
    members = canonical.members(value)
    if members is not None:
        return {"kind": type(value).__name__.lower(), **{name: _plain(member) for name, member in members.items()}}
    if isinstance(value, Mapping):
        return {name: _plain(member) for name, member in value.items()}
    if not isinstance(value, tuple | list):
        return value
    if value and all(type(entry) is tuple and len(entry) == 2 and isinstance(entry[0], str) for entry in value):
        return {name: _plain(member) for name, member in value}
    return [_plain(entry) for entry in value]


def _unordered(data: Any) -> Any:
    if isinstance(data, dict):
        return {key: _unordered(value) for key, value in data.items()}
    return sorted(map(_unordered, data), key=json.dumps) if isinstance(data, list) else data


def _differing_values(old: Item | None, new: Item | None) -> tuple[str, str]:
    """The values that differ, where the texts of the scenarios say nothing of them: a default, or another file.

    An item that only one scenario has is shown by a few values at most, since a link has dozens.
    """
    here, there = (dict(_leaves(item.value)) if item else {} for item in (old, new))
    differing = [name for name in dict.fromkeys((*here, *there)) if here.get(name) != there.get(name)]
    if len(differing) > _LISTED and not (old and new):
        return "", ""
    rest = f", ... {len(differing)} in all" if len(differing) > _LISTED else ""
    one, other = (", ".join(f"{name} {leaves[name]}".strip() for name in differing[:_LISTED] if name in leaves) for leaves in (here, there))
    return (one + rest if one else "", other + rest if other else "")


def _leaves(data: Any, path: str = "") -> Iterator[tuple[str, str]]:
    """The single values in plain data, each with its path there."""
    if isinstance(data, dict):
        for key, value in data.items():
            yield from _leaves(value, f"{path}.{key}".strip("."))
    elif isinstance(data, list) and not all(isinstance(entry, str) for entry in data):
        axes = _AXES.get(path.rpartition(".")[2], "").split() if all(isinstance(entry, float) for entry in data) else []
        keys = axes if len(axes) == len(data) else [""] if len(data) == 1 else range(len(data))
        for index, value in zip(keys, data, strict=True):
            yield from _leaves(value, f"{path}.{index}".strip("."))
    elif data is not None:
        text = ", ".join(data) if isinstance(data, list) else f"{data:.12g}" if isinstance(data, float) else cell(data)
        yield path, text

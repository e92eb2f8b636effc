"""The differences between two compiled scenarios, value by value.

A compiled scenario is flattened to values by path, such as
`world/robots/cart/model/links/pole/inertial/mass`. `_PATHS` maps the path of a value that differs to its path
in the language, `robots.cart.links.pole`, and to the group of the difference. A change has the texts of both
scenarios at this path.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import field, replace
from enum import StrEnum
from fnmatch import fnmatchcase
from itertools import chain
from typing import Any, Literal

from deepbots_cli.document import Node, SequenceNode, inline_text
from deepbots_cli.document.nodes import entries_at, follow_dotted, node_at
from deepbots_cli.expressions.scalar import Const, Draw, Scalar, names_in
from deepbots_cli.expressions.text import formula_text, value_text
from deepbots_cli.program import Program, identity
from deepbots_cli.program.resets import JointStart, RandomizedParameter, Reset
from deepbots_cli.program.robots import Robot, Route
from deepbots_cli.program.task import Agent, Network, Training, Truncation
from deepbots_cli.program.world import RobotBody, WorldModel
from deepbots_cli.records import dataclass
from deepbots_cli.robots.model import RobotModel

Kind = Literal["changed", "added", "removed"]
APPEARANCE_PREFIX = "look of "

_PERIOD = ("world.timestep", "action_repeat", "agent.action_repeat")
_ACTING = ("robots.", "observation.", "action.", "goal.range", "goal.noise", "agent.frame_stack", *_PERIOD)


class Effect(StrEnum):
    """The effect of a difference, the most serious first."""

    policy = "policy"
    task = "task"
    world = "world"
    training = "training"
    cosmetic = "cosmetic"


@dataclass(frozen=True)
class WrittenScenario:
    """A compiled scenario with its text after includes and settings; `root` is None if there is no text."""

    program: Program
    root: Node | None

    def text_at(self, path: str) -> str:
        """Return the text at a path, on one line; empty if there is none. A stage of the curriculum is found
        by its name."""
        node = self._written(path)
        return "" if node is None else inline_text(node)

    def text_at_key(self, path: str, key: str) -> str:
        """Return the text at a key of the mapping at a path; the key may have dots."""
        entry = entries_at(self._written(path)).get(key)
        return "" if entry is None else inline_text(entry.value)

    def text_of_value(self, path: str) -> str:
        """Return the text at a path; for a mapping, the values without their keys."""
        entries = entries_at(self._written(path))
        return (
            " ".join(inline_text(entry.value) for entry in entries.values())
            if entries
            else self.text_at(path)
        )

    def members(self, robot: str, name: str) -> list[str]:
        """Return the patterns of joints and links in a group of a robot; the name itself if it is no
        group."""
        reached: list[str] = []
        waiting = [name]
        expanded: set[str] = set()
        while waiting:
            name = waiting.pop(0)
            group = self._written(f"robots.{robot}.groups.{name}")
            if group is None or name in expanded:
                reached.append(name)
            else:
                expanded.add(name)
                waiting += [
                    inline_text(item)
                    for item in (group.items if isinstance(group, SequenceNode) else (group,))
                ]
        return reached

    def keys_at(self, path: str) -> list[str]:
        """Return the keys that are written at a path."""
        return list(entries_at(self._written(path)))

    def _written(self, path: str) -> Node | None:
        words = path.split(".")
        if words[0] == "curriculum" and len(words) > 1:
            names = [stage.name for stage in self.program.curriculum]
            return node_at(self.root, "curriculum", names.index(words[1])) if words[1] in names else None
        _, node, unresolved = follow_dotted(self.root, path) if self.root else ((), None, path)
        return None if unresolved else node


@dataclass(frozen=True)
class Change:
    """A difference between two scenarios; `one` and `other` are the texts of both sides.

    `through` has the parameters, and the poses and groups of robots, behind them that differ, and the texts
    of each on both sides.
    """

    path: str
    group: Effect
    kind: Kind
    one: str
    other: str
    through: Mapping[str, tuple[str, str]] = field(default_factory=dict)

    @property
    def lines(self) -> list[str]:
        """The texts of both sides, or the text of both, and further changes of its meaning."""
        if self.through and self.one == self.other:
            return [f"      {self.one}", f"      {self.by}"]
        if self.kind == "changed" and not (self.one or self.other):
            return []
        sides = (("-", self.one, "added"), ("+", self.other, "removed"))
        texts = [
            f"    {mark} {text or '(not written)'}" for mark, text, absent in sides if self.kind != absent
        ]
        return [*texts, f"      also {self.by}"] if self.through else texts

    @property
    def text(self) -> str:
        """The change on one line: `robots.leg.apply.hip: 0.5 * hip -> 0.75 * hip`."""
        if self.through and self.one == self.other:
            return f"{self.path}: {self.by}"
        sides = [side or "(not written)" for side in (self.one, self.other)]
        return f"{self.path}: {' -> '.join(sides)}" if self.one or self.other else self.path

    @property
    def by(self) -> str:
        """The parameters and poses that change the meaning of the text."""
        listed = (
            f"{name}: {first or '(not written)'} -> {second or '(not written)'}"
            for name, (first, second) in self.through.items()
        )
        prefix = (
            ""
            if any(" " in name for name in self.through)
            else f"the parameter{'s' * (len(self.through) > 1)} "
        )
        return f"changed by {prefix}{', '.join(listed)}"


@dataclass(frozen=True)
class Meanings:
    """The differences between two scenarios that limit the comparison of their policies.

    Attributes:
        acting: The meaning of an observation or an action: robots, sensors, actuators, `apply`, observation,
            action, control period. Policies for which these differ need each their own scenario.
        returns: The terms of a return: reward, endings, limits of an episode, goal, control period.
        success: The meaning of success.
        reward: The reward alone.
    """

    acting: tuple[Change, ...] = ()
    returns: tuple[Change, ...] = ()
    success: tuple[Change, ...] = ()
    reward: tuple[Change, ...] = ()


def compared_meanings(first: WrittenScenario, second: WrittenScenario) -> Meanings:
    """Return the differences that limit the comparison of the policies of two scenarios."""
    changes = [
        change
        for change in scenario_changes(first, second)
        if change.group not in (Effect.cosmetic, Effect.training)
    ]
    acting, returns, success, reward = (set[str]() for _ in range(4))
    for program in (first.program, second.program):
        agent = program.agent
        acting |= _names_behind(program, (program.robots, agent.observation, agent.action, agent.goal))
        returns |= _names_behind(program, (agent.reward, program.endings, agent.goal))
        reward |= _names_behind(program, agent.reward)
        endings = tuple(ending for ending in program.endings if ending.name in agent.success)
        success |= _names_behind(program, (endings, agent.goal))

    def about(prefixes: tuple[str, ...], names: set[str]) -> tuple[Change, ...]:
        paths = {f"{section}.{name}" for name in names for section in ("augment", "signals", "parameters")}
        return tuple(change for change in changes if change.path.startswith(prefixes) or change.path in paths)

    fits = tuple(change for change in changes if change.group is Effect.policy)
    other_changes = tuple(change for change in about(_ACTING, acting) if change not in fits)
    return Meanings(
        fits + other_changes,
        about(("reward.", "termination.", "truncation.", "goal.", *_PERIOD), returns),
        about(("termination.success.", "goal."), success),
        about(("reward.",), reward),
    )


def _names_behind(program: Program, parts: object) -> set[str]:
    """Return the names of the signals and parameters that parts of a program read, and the names that these
    read in turn."""
    definitions = {entry.name: entry for entry in (*program.signals, *program.parameters)}
    names: set[str] = set()
    waiting = set(_names_read(parts))
    while waiting:
        name = waiting.pop()
        if name in definitions and name not in names:
            names.add(name)
            waiting |= set(_names_read(definitions[name]))
    return names


def _names_read(part: object) -> Iterator[str]:
    if isinstance(part, Scalar):
        yield from (leaf.name for leaf in names_in(part))
        return
    members = identity.record_members(part)
    if members is None and isinstance(part, Mapping):
        members = dict(part)
    for inner in part if isinstance(part, tuple) else (members or {}).values():
        yield from _names_read(inner)


_LOOKS_PATH = r"(?=/(?:.*/)?(?:color|visuals)\b)"
_AGENT = r"agents/[^/]+/"
_PATHS: tuple[tuple[str, str, Effect], ...] = (
    # the path of a value in a compiled scenario, the first that matches; its path in the language; its group
    (_AGENT + r"observation/([^/]+)/noise", r"observation.\1.noise", Effect.task),
    (_AGENT + r"observation/([^/]+)", r"observation.\1", Effect.task),
    (_AGENT + r"action/([^/]+)/options(?=/.*/forbidden)", r"action.\1.forbid", Effect.task),
    (_AGENT + r"action/([^/]+)", r"action.\1", Effect.policy),
    (_AGENT + r"copies/([^/]+)", r"robots.\1.count", Effect.world),
    (rf"(?:{_AGENT})?(action_repeat|frame_stack)", r"agent.\1", Effect.world),
    (_AGENT + r"goal/achieved/noise", "goal.noise", Effect.task),
    (_AGENT + r"goal/(?:low|high)", "goal.range", Effect.policy),
    (_AGENT + r"goal/(\w+)", r"goal.\1", Effect.task),
    (r"signals/([^/]+)", r"signals.\1", Effect.task),
    (_AGENT + r"reward/([^/]+)", r"reward.\1", Effect.task),
    (r"endings/(\w+)/([^/]+)", r"termination.\1.\2", Effect.task),
    (r"truncation/(\w+)", r"truncation.\1", Effect.task),
    (r"robots/[^/]+/(to|from)_route", r"messages.\1_robot", Effect.world),
    (r"robots/([^/]+)/commands/([^/]+)", r"robots.\1.apply.\2", Effect.task),
    (r"robots/([^/]+)/variables/([^/]+)", r"robots.\1.receive.\2", Effect.task),
    (r"robots/([^/]+)/(\w+)/([^/]+)", r"robots.\1.\2.\3", Effect.task),
    (r"(name|summary)", r"\1", Effect.cosmetic),
    (
        r"world/robots/([^/]+)/model/links/([^/]+)" + _LOOKS_PATH,
        APPEARANCE_PREFIX + r"robots.\1.links.\2",
        Effect.cosmetic,
    ),
    (r"world/objects/([^/#]+)[^/]*" + _LOOKS_PATH, APPEARANCE_PREFIX + r"objects.\1", Effect.cosmetic),
    (r"world/lines/([^/]+)" + _LOOKS_PATH, APPEARANCE_PREFIX + r"world.lines.\1", Effect.cosmetic),
    (r"world/(\w+)" + _LOOKS_PATH, APPEARANCE_PREFIX + r"world.\1", Effect.cosmetic),
    (r"world/(?!robots|objects|lines)(\w+)", r"world.\1", Effect.world),
    (r"world/robots/([^/]+)/model/name", r"name of robots.\1.urdf", Effect.cosmetic),
    (r"world/robots/([^/]+)/model/root", r"robots.\1.urdf", Effect.world),
    (r"world/robots/([^/]+)/model/(\w+)/([^/]+)", r"robots.\1.\2.\3", Effect.world),
    (r"world/robots/([^/]+)/fixed_base", r"robots.\1.base", Effect.world),
    (r"world/robots/([^/]+)/(\w+)", r"robots.\1.\2", Effect.world),
    (r"world/objects/([^/#]+)[^/]*", r"objects.\1", Effect.world),
    (r"world/lines/([^/]+)", r"world.lines.\1", Effect.world),
    (r"(format|timing)", r"messages.\1", Effect.world),
    (r"(parameters|disturbances)/([^/]+)", r"\1.\2", Effect.world),
    (r"reset/variations/([^/]+)", r"\1", Effect.world),
    (r"reset/placements/([^/]+)", r"reset.place.\1", Effect.world),
    (r"reset/joint_starts/([^/]+)/states/([^/]+)", r"reset.joints.\1.\2", Effect.world),
    (r"reset/groups/([^/]+)", r"objects.\1.count", Effect.world),
    (r"reset/layouts/([^/]+)", r"reset.layouts.\1", Effect.world),
    (r"reset/(\w+)", r"reset.\1", Effect.world),
    (_AGENT + "(solved)", r"\1", Effect.training),
    (r"evaluation/(\w+)", r"evaluation.\1", Effect.training),
    (
        _AGENT + r"training/(algorithm|total_timesteps|environments|action_noise|replay|normalize|device)",
        r"train.\1",
        Effect.training,
    ),
    (_AGENT + "training/teacher", "train.teacher", Effect.training),
    (_AGENT + r"training/network/(\w+)", r"train.network.\1", Effect.training),
    (_AGENT + r"training/hyperparameters/([^/]+)", r"train.\1", Effect.training),
    (_AGENT + r"scripts/([^/]+)", r"scripts.\1", Effect.training),
)
_AXES = {"rpy": ("roll", "pitch", "yaw")} | dict.fromkeys(
    ("xyz", "size", "axis", "spacing", "scale", "gravity"), ("x", "y", "z")
)
_CONTAINER_RECORDS = (
    Program,
    WorldModel,
    RobotBody,
    RobotModel,
    Robot,
    Route,
    Agent,
    Truncation,
    Reset,
    JointStart,
    Training,
    Network,
)
"""The records that only contain other records; their class is not compared."""
_JOINT_STATE = r"joint_starts/[^/]+/states/[^/]+$"
_NAME = r"[a-z_][a-z0-9_]*"
_MAX_LISTED = 3


def scenario_changes(first: WrittenScenario, second: WrittenScenario) -> list[Change]:
    """Return all differences, the most serious group first; empty if both scenarios compile to the same
    program, except for paths of files."""
    changes = [
        *_interface_changes(first, second),
        *_value_changes(first, second),
        *_variant_changes(first, second),
        *_order_changes(first.program, second.program),
    ]
    if not changes and identity.digest(first.program) != identity.digest(second.program):
        path = (
            "last digits" if list(values(first.program)) == list(values(second.program)) else "order of keys"
        )
        changes = [Change(path, Effect.cosmetic, "changed", "", "")]
    by_path: dict[str, Change] = {}
    for change in sorted(changes, key=lambda change: list(Effect).index(change.group)):
        # Components of an observation replace the entry of the whole observation.
        parts = [
            same_group
            for path, same_group in by_path.items()
            if path.startswith(f"{change.path}.") and same_group.group is not change.group
        ]
        if change.path not in by_path and not parts:
            by_path[change.path] = change
    return list(by_path.values())


def _interface_changes(first: WrittenScenario, second: WrittenScenario) -> Iterator[Change]:
    """Yield the differences in the interface of a policy: ranges, choices and messages."""
    before, after = (identity.interface(side.program)[side.program.agent.name] for side in (first, second))
    for name in dict.fromkeys((*before, *after)):
        if before.get(name) != after.get(name):
            path = (
                "goal.range"
                if name.startswith("goal")
                else re.sub(r"^message to robot ([^.]+)\.", r"robots.\1.receive.", name)
            )
            path = re.sub(r"^message from robot ([^.]+)\.", r"robots.\1.emit.", path)
            old, new = ({"": side[name]} if name in side else {} for side in (before, after))
            yield _change(path, Effect.policy, old, new, first, second)


def _value_changes(first: WrittenScenario, second: WrittenScenario) -> Iterator[Change]:
    before, after = values(first.program), values(second.program)
    items: dict[tuple[int, str, Effect], tuple[dict[str, str], dict[str, str]]] = {}
    for raw in dict.fromkeys((*before, *after)):
        item, detail = _translated(raw, first.program, second.program)
        for side, values_of_side in zip(items.setdefault(item, ({}, {})), (before, after), strict=True):
            if raw in values_of_side:
                side[detail] = values_of_side[raw]
    for (_, path, group), (old, new) in sorted(items.items(), key=lambda item: item[0][0]):
        if old != new:
            yield _change(path, group, old, new, first, second)


def _translated(raw: str, *scenarios: Program) -> tuple[tuple[int, str, Effect], str]:
    """Return the rank, the path in the language and the group of the item that a value belongs to, and its
    path from there."""
    for rank, (pattern, template, group) in enumerate(_PATHS):
        if match := re.match(pattern, raw):
            path = match.expand(template)
            if path.startswith(APPEARANCE_PREFIX) and any(_is_seen(path, scenario) for scenario in scenarios):
                group = Effect.world
            return (rank, path, group), raw[match.end() :].strip("/").replace("/", ".")
    return (len(_PATHS), raw.replace("/", "."), Effect.task), ""


def _is_seen(path: str, scenario: Program) -> bool:
    """Return whether a robot has a camera, or the look belongs to a robot that has no other shapes."""
    name = path.removeprefix(APPEARANCE_PREFIX).split(".")[1]
    bodies = [
        body
        for body in scenario.world.robots
        if path.startswith(f"{APPEARANCE_PREFIX}robots.") and body.name == name
    ]
    shapeless = any(not any(link.collisions for link in body.model.links) for body in bodies)
    return shapeless or any(sensor.optics for robot in scenario.robots for sensor in robot.sensors)


def _change(
    path: str,
    group: Effect,
    old: Mapping[str, str],
    new: Mapping[str, str],
    first: WrittenScenario,
    second: WrittenScenario,
) -> Change:
    """Return the change at a path: the texts of both scenarios, or the compiled values that differ where the
    texts do not."""
    section, _, name = path.partition(".")
    if section == "signals" and any(name in side.keys_at("augment") for side in (first, second)):
        path = f"augment.{name}"
    text_path = (
        f"{path.removeprefix(APPEARANCE_PREFIX)}.color" if path.startswith(APPEARANCE_PREFIX) else path
    )
    texts = first.text_at(text_path), second.text_at(text_path)
    entry = None if any(texts) else (_entry_of_joint(path, first) or _entry_of_joint(path, second))
    if entry is not None:
        texts = first.text_at(entry), second.text_at(entry)
    kind = "changed" if all(texts) else _kind(bool(old), bool(new))
    excluded = {name} if section == "parameters" else set[str]()
    through = _altered_names(texts[0], first, second, excluded)
    if texts[0] != texts[1]:
        reached = _altered_names(texts[1], first, second, excluded) if all(texts) else {}
        shared = {name: sides for name, sides in through.items() if name in reached}
        return Change(entry or path, group, kind, *texts, shared)
    if through:
        return Change(entry or path, group, kind, *texts, through)
    return Change(path, group, kind, *_differing(old, new))


def _entry_of_joint(path: str, scenario: WrittenScenario) -> str | None:
    """Return the entry of `reset.joints` with a joint that has no entry of its own: the entry of a group or
    of a pattern."""
    if not path.startswith("reset.joints."):
        return None
    robot, joint = path.split(".")[2:4]
    for key in scenario.keys_at("reset.joints"):
        owner, _, name = key.partition(".")
        if owner == robot and any(fnmatchcase(joint, pattern) for pattern in scenario.members(robot, name)):
            return f"reset.joints.{key}"
    return None


def _kind(before: bool, after: bool) -> Kind:
    if before and after:
        return "changed"
    if before:
        return "removed"
    return "added"


def _differing(old: Mapping[str, str], new: Mapping[str, str]) -> tuple[str, str]:
    """Yield the first few values that differ; none of an item with many values that only one scenario has."""
    names = [name for name in dict.fromkeys((*old, *new)) if old.get(name) != new.get(name)]
    if len(names) > _MAX_LISTED and not (old and new):
        return "", ""
    more = [f"... {len(names)} in all"] if len(names) > _MAX_LISTED else []
    listed = [
        [f"{name} {side[name]}".strip() for name in names[:_MAX_LISTED] if name in side]
        for side in (old, new)
    ]
    return ", ".join([*listed[0], *more] if listed[0] else []), ", ".join(
        [*listed[1], *more] if listed[1] else []
    )


def _altered_names(
    text: str, first: WrittenScenario, second: WrittenScenario, excluded: set[str]
) -> dict[str, tuple[str, str]]:
    """Return the parameters, and the poses and groups of robots, whose texts differ: those in a text and
    those behind them.

    Each name has both of its texts. A pose is called `the pose stand`, and a group `the group legs`.
    `excluded` are names that are not looked up.
    """
    altered: dict[str, tuple[str, str]] = {}
    met = set(excluded)
    waiting = [text]
    while waiting:
        names = [name for name in dict.fromkeys(re.findall(_NAME, waiting.pop(0))) if name not in met]
        met |= {*names}
        for name in names:
            for called, before, after in _definitions(name, first, second):
                if before != after:
                    altered[called] = before, after
            sides = [side.text_of_value(path) for path in _places(name, first) for side in (first, second)]
            waiting += dict.fromkeys(filter(None, sides))
    return altered


def _places(name: str, scenario: WrittenScenario) -> list[str]:
    """Return the places where a parameter or a pose of this name is written."""
    return [f"parameters.{name}", *(f"robots.{robot}.poses.{name}" for robot in scenario.keys_at("robots"))]


def _definitions(
    name: str, first: WrittenScenario, second: WrittenScenario
) -> Iterator[tuple[str, str, str]]:
    """Yield the definitions of a name (a parameter, poses, groups): the words for it in a sentence, and both
    of its texts."""
    for path in _places(name, first):
        yield (f"the pose {name}" if ".poses." in path else name), *_differing_entries(path, first, second)
    for robot in first.keys_at("robots"):
        sides = [", ".join(side.members(robot, name)) for side in (first, second)]
        yield f"the group {name}", sides[0], sides[1]


def _differing_entries(path: str, first: WrittenScenario, second: WrittenScenario) -> tuple[str, str]:
    """Return the texts at a path; of two mappings, the entries that differ."""
    keys = [side.keys_at(path) for side in (first, second)]
    if not all(keys):
        return first.text_at(path), second.text_at(path)
    entries = {
        key: (first.text_at_key(path, key), second.text_at_key(path, key))
        for key in dict.fromkeys(chain(*keys))
    }
    differing = {key: sides for key, sides in entries.items() if sides[0] != sides[1]}
    before, after = (
        ", ".join(f"{key}: {sides[side]}" for key, sides in differing.items() if sides[side])
        for side in (0, 1)
    )
    return f"{{{before}}}" if before else "", f"{{{after}}}" if after else ""


def _variant_changes(first: WrittenScenario, second: WrittenScenario) -> Iterator[Change]:
    """Yield the differences of cases and stages, by the values that each changes in its scenario."""
    for section, before, after in (
        (
            "evaluation.cases",
            _variants(first.program, first.program.cases),
            _variants(second.program, second.program.cases),
        ),
        (
            "curriculum",
            _variants(first.program, first.program.curriculum),
            _variants(second.program, second.program.curriculum),
        ),
    ):
        for name in dict.fromkeys((*before, *after)):
            if before.get(name) != after.get(name):
                path = f"{section}.{name}"
                yield Change(
                    path,
                    Effect.training,
                    _kind(name in before, name in after),
                    first.text_at(path),
                    second.text_at(path),
                )
    if first.program.levels != second.program.levels:
        had, has = first.program.levels is not None, second.program.levels is not None
        texts = first.text_at("curriculum"), second.text_at("curriculum")
        yield Change("curriculum", Effect.training, _kind(had, has), *texts)


def _variants(scenario: Program, entries: Iterable[Any]) -> dict[str, object]:
    base = values(scenario)
    variants: dict[str, object] = {}
    for entry in entries:
        variant_values = values(entry.program)
        changed = {
            path: variant_values.get(path)
            for path in {**base, **variant_values}
            if base.get(path) != variant_values.get(path)
        }
        variants[entry.name] = {"set": changed, **dict(_leaves(replace(entry, program=None), ""))}
    return variants


def _order_changes(first: Program, second: Program) -> Iterator[Change]:
    """Yield the same names in another order, where the order has a meaning."""
    before, after = dict(_orders(first)), dict(_orders(second))
    for (path, group), names in before.items():
        new_names = after.get((path, group), names)
        if names != new_names and sorted(names) == sorted(new_names):
            yield Change(path, group, "changed", ", ".join(names), ", ".join(new_names))


def _orders(scenario: Program) -> Iterator[tuple[tuple[str, Effect], list[str]]]:
    yield (
        ("order of what is observed, done and sent", Effect.policy),
        list(identity.interface(scenario)[scenario.agent.name]),
    )
    yield ("order of endings", Effect.task), [ending.name for ending in scenario.endings]
    yield ("order of reset.place", Effect.world), [place.body for place in scenario.reset.placements]
    yield ("order of evaluation.cases", Effect.training), [case.name for case in scenario.cases]
    yield ("order of curriculum", Effect.training), [stage.name for stage in scenario.curriculum]


# Values by path


def values(scenario: Program) -> dict[str, str]:
    """Return every value of a scenario as text, by path; without cases, stages and paths of files."""
    kinds = dict.fromkeys(scenario.failures, "failure") | dict.fromkeys(scenario.agent.success, "success")
    leaves = _leaves(
        replace(scenario.with_agent(robots=(), success=()), cases=(), curriculum=(), levels=None), ""
    )
    texts: dict[str, str] = {}
    for path, text in leaves:
        path = re.sub(r"^endings/(\w+)", lambda match: f"endings/{kinds[match[1]]}/{match[1]}", path)
        while path in texts:  # two entries of one name, such as two of `reset.joints` for one robot
            path += "#"
        texts[path] = text
    return texts


def _leaves(value: Any, path: str) -> Iterator[tuple[str, str]]:
    """Yield the single values in a record, with their paths; numbers to twelve digits, since units are
    converted in floats."""
    value = value.value if isinstance(value, Const) else value
    members = None if isinstance(value, Scalar) else identity.record_members(value)
    if members is not None and "scalars" in members:
        members = {
            "": members["scalars"],
            **{name: members[name] for name in ("noise", "foreign", "redraw") if name in members},
        }
    elif members is not None:
        kind = {} if type(value) in _CONTAINER_RECORDS else {"kind": type(value).__name__.lower()}
        key = path.rpartition("/")[2]
        members = kind | {
            name: member
            for name, member in members.items()
            if name not in ("name", "body", "robot") or member != key
        }
    entries = None if members is None else [*members.items()]
    if (
        members is None
        and isinstance(value, tuple)
        and not isinstance(value, Scalar)
        and not all(isinstance(item, str) for item in value)
    ):
        entries = _keyed(value, path)
    elif members is None and isinstance(value, Mapping):
        entries = [*value.items()]
    if entries is not None:
        for name, member in entries:
            yield from _leaves(member, f"{path}/{name}".strip("/"))
    elif path.endswith("/fixed_base"):
        yield path, "fixed" if value else "free"
    elif isinstance(value, Scalar):
        yield path, formula_text(value)
    elif isinstance(value, float):
        yield path, f"{value:.12g}"
    elif value not in (None, ()):
        yield path, value_text(list(value)) if isinstance(value, tuple) else value_text(value)


def _keyed(entries: tuple[Any, ...], path: str) -> list[tuple[str, Any]]:
    """Return the entries of a list with their names where they have one, or with axis or position."""
    if re.search(_JOINT_STATE, path):
        return [*zip(("position", "velocity"), entries[1:], strict=True)]
    axes = _AXES.get(path.rpartition("/")[2], ())
    if len(entries) == len(axes):
        return [*zip(axes, entries, strict=True)]
    return [
        (_key(entry) or (str(index) if len(entries) > 1 else ""), entry)
        for index, entry in enumerate(entries)
    ]


def _key(entry: Any) -> str:
    if isinstance(entry, Scalar):
        return ""
    if isinstance(entry, RandomizedParameter):
        return _path_of_draw(entry)
    if isinstance(entry, tuple):
        return entry[0] if entry and isinstance(entry[0], str) else ""
    return next((str(getattr(entry, key)) for key in ("name", "body", "robot") if hasattr(entry, key)), "")


def _path_of_draw(entry: RandomizedParameter) -> str:
    """Return the path in the language of a value that is drawn per episode."""
    body, *links = (part.partition("#")[0] for part in entry.of) if entry.of else ("",)
    if entry.what == "color":
        return (
            f"{APPEARANCE_PREFIX}robots.{body}.links.{links[0]}"
            if links and links[0]
            else f"{APPEARANCE_PREFIX}objects.{body}"
        )
    first = entry.scalars[0]
    if isinstance(first, Draw):
        return first.stream.partition("#")[0].partition(":")[0]
    return " of ".join(filter(None, (f"drawn {entry.what}", ".".join(filter(None, entry.of)))))

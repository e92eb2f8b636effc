"""Robot files with the changes of the scenario: names, patterns and groups of links and joints, and the
quantities of joints."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from fnmatch import fnmatchcase
from pathlib import Path as FilePath
from typing import TYPE_CHECKING

from deepbots_cli.compiler.texts import SourceText
from deepbots_cli.compiler.values import ValueReader
from deepbots_cli.diagnostics import Edit, Finding, Findings, Fix, Span
from deepbots_cli.diagnostics.nearest import nearest_word
from deepbots_cli.document import Document, files, shipped
from deepbots_cli.document.nodes import MappingNode, descend
from deepbots_cli.expressions import intervals, syntax
from deepbots_cli.expressions.dimensions import (
    ANGLE,
    FORCE,
    LENGTH,
    MASS,
    NUMBER,
    TIME,
    TORQUE,
    UNITS,
    Dimension,
    Unit,
)
from deepbots_cli.expressions.intervals import Interval, single
from deepbots_cli.expressions.types import SPACE, Context, Kind, Known, Scope, Subject, Symbol, ValueType
from deepbots_cli.frames import IDENTITY_FRAME, Frame, compose
from deepbots_cli.frames import frame as pose_frame
from deepbots_cli.program.resets import OfJoint, OfLink
from deepbots_cli.program.world import JointParameter, LinkParameter
from deepbots_cli.records import dataclass
from deepbots_cli.robots import packages
from deepbots_cli.robots.kinematics import with_inertia_of_shapes, with_mass_of_shapes
from deepbots_cli.robots.model import (
    ZERO,
    Joint,
    Limit,
    Link,
    RobotModel,
    Vector,
    with_center,
    with_color,
    with_density,
    with_friction,
    with_inertia,
    with_joint,
    with_link,
    with_mass,
    with_scale,
)
from deepbots_cli.robots.reader import RobotFile, read
from deepbots_cli.scenario.actuators import Actuator
from deepbots_cli.scenario.base import Section
from deepbots_cli.scenario.fields import Scalar, choices_help
from deepbots_cli.scenario.robots import JointOverride, LinkOverride
from deepbots_cli.scenario.robots import Robot as RobotSpec
from deepbots_cli.scenario.sensors import Camera
from deepbots_cli.scenario.training import AUTO

if TYPE_CHECKING:
    from deepbots_cli.compiler.namespace import Namespace


def joint_dimension(joint: Joint) -> Dimension:
    """Return the dimension of a joint's position: a length for a sliding joint, else an angle."""
    return LENGTH if joint.type == "prismatic" else ANGLE


def effort_dimension(joint: Joint) -> Dimension:
    """Return the dimension of a joint's effort: a force for a sliding joint, else a torque."""
    return FORCE if joint.type == "prismatic" else TORQUE


def _armature_dimension(joint: Joint) -> Dimension:
    """Return the dimension of a joint's armature: a mass for a sliding joint, else a moment of inertia."""
    return MASS if joint.type == "prismatic" else MASS * LENGTH**2


def joint_interval(joint: Joint) -> Interval:
    """Return the positions that the limits of the joint leave."""
    lower, upper = joint.limit.lower, joint.limit.upper
    return Interval(-math.inf if lower is None else lower, math.inf if upper is None else upper)


def joint_moves_link(model: RobotModel, joint: Joint, link: str) -> bool:
    """Return whether the link moves when the joint does, with the joints that follow it."""
    moved = [joint, *map(model.joint, model.followers_of(joint.name))]
    return any(link in model.links_below(each.child) for each in moved)


def rigid_root(model: RobotModel, link: str) -> tuple[str, Frame]:
    """Return the link that carries another by fixed joints alone, farthest towards the root; and the other's
    frame in its frame."""
    above = {joint.child: joint for joint in model.joints if not joint.moves}
    frame = IDENTITY_FRAME
    for _ in model.joints:  # ends for a forged model with a cycle, too
        joint = above.get(link)
        if joint is None:
            break
        link = joint.parent
        frame = compose(pose_frame(joint.origin), frame)
    return link, frame


NameGroup = tuple[Kind, tuple[str, ...]]
"""Joints or links, and the short names of its members."""


def expand_patterns(
    names: Sequence[str], patterns: str | Iterable[str], groups: Mapping[str, NameGroup]
) -> tuple[tuple[str, ...], list[str]]:
    """Return the names that match patterns and groups, in order, without repeats; and the patterns without a
    match."""
    matching: dict[str, None] = {}
    missing = []
    for pattern in [patterns] if isinstance(patterns, str) else patterns:
        matched = (
            tuple(member for member in groups[pattern][1] if member in names)
            if pattern in groups
            else matching_names(names, pattern)
        )
        if not matched:
            missing.append(pattern)
        matching.update(dict.fromkeys(matched))
    return tuple(matching), missing


def matching_names(names: Iterable[str], pattern: str) -> tuple[str, ...]:
    """Return the one of this name; or those that fit `pattern` (`*`, `?`, `[abc]`; upper and lower case
    differ), in their given order."""
    candidates = tuple(names)
    return (
        (pattern,)
        if pattern in candidates
        else tuple(name for name in candidates if fnmatchcase(name, pattern))
    )


def report_unmatched(values: ValueReader, span: Span, pattern: str, noun: str, names: Sequence[str]) -> None:
    """Report DB206 for a pattern, DB302 or DB201 for a plain name, with the existing names."""
    if not set(pattern) & set("*?["):
        values.report_unknown(span, noun, pattern, names, "DB302" if noun == "joint" else "DB201")
    else:
        suggestion = _without_regular_expression(pattern, names) or _similar_pattern(pattern, names)
        help = (
            f"did you mean `{suggestion}`? {choices_help('', names)}"
            if suggestion
            else choices_help(pattern, names)
        )
        if ".*" in pattern:
            help = f"patterns are not regular expressions: `*` stands for any characters; {help}"
        fix = Fix.replacing(span, pattern, suggestion, safe=False) if suggestion else None
        values.add("DB206", span, f"`{pattern}` matches no {noun}", help, fix=fix)


def _without_regular_expression(pattern: str, names: Sequence[str]) -> str | None:
    """Return `*_toe` for `.*_toe`; None if this matches nothing either."""
    plain = pattern.strip("^$").replace(".*", "*")
    return plain if plain != pattern and matching_names(names, plain) else None


def _similar_pattern(pattern: str, names: Sequence[str]) -> str | None:
    """Return the pattern like `*_end` or `beginning_*` that matches a name and is most similar to `pattern`;
    None if there is none, or `pattern` is of another form."""
    word = pattern.strip("*")
    if set(word) & set("*?[") or pattern not in (f"*{word}", f"{word}*"):
        return None
    underscores = ((name, at) for name in names for at, letter in enumerate(name) if letter == "_")
    if pattern.startswith("*"):
        similar = nearest_word(word, sorted({name[at:] for name, at in underscores}))
        return f"*{similar}" if similar else None
    similar = nearest_word(word, sorted({name[: at + 1] for name, at in underscores}))
    return f"{similar}*" if similar else None


def report_missing_joint(
    values: ValueReader, span: Span, pattern: str, model: RobotModel, movable_names: Sequence[str]
) -> None:
    """Report a joint where one of the `movable_names` is needed: it does not exist, it cannot move, or it
    follows another one."""
    matched = matching_names((joint.name for joint in model.joints), pattern)
    if matched and matched[0] in model.followers:
        report_follower(values, span, matched[0], model)
    elif matched and matched[0] in movable_names:
        names = ", ".join(f"`{name}`" for name in matched)
        help = f"name a joint or a group of `groups`; the pattern matches {names}"
        values.add("DB303", span, f"`{pattern}` is a pattern, and a name is needed here", help)
    elif matched:
        joints = {joint.name for joint in model.joints}
        report_motionless_joint(
            values, span, model.joint(matched[0]), [name for name in movable_names if name in joints]
        )
    else:
        report_unmatched(values, span, pattern, "joint", movable_names)


def report_follower(values: ValueReader, span: Span, joint: str, model: RobotModel) -> None:
    """Report DB303 for a joint that follows another one where one is moved on its own."""
    leader = model.followers[joint].joint
    values.add(
        "DB303",
        span,
        f"the joint `{joint}` follows `{leader}` and cannot be moved on its own",
        f"use `{leader}`, which moves both joints; patterns and groups skip `{joint}`",
    )


def report_motionless_joint(
    values: ValueReader, span: Span, joint: Joint, movable_names: Sequence[str]
) -> None:
    names = ", ".join(f"`{name}`" for name in movable_names)
    help = f"joints that move are {names}" if names else "no joint of this robot can move"
    values.add("DB303", span, f"the joint `{joint.name}` cannot move: it is {joint.type}", help)


# Limits of the robot file

_NUMBER = r"[-+]?[0-9.][0-9_.]*(?:[eE][-+]?[0-9]+)?"
_DIGITS = 4


def warn_beyond_limits(
    values: ValueReader,
    text: SourceText,
    dimension: Dimension,
    allowed: Interval,
    description: str,
    actual: Interval,
    help: str,
) -> None:
    """Report DB304: `description` is `actual`, which is not all within the range that the robot file allows
    for the value that is written in `text`."""
    tree = values.parsed(text)
    numbers = list(_numbers(tree)) if tree else []
    units = [
        number.unit for number in numbers if number.unit is not None and number.unit.dimension == dimension
    ]
    if units:
        unit = units[0]
    elif dimension == ANGLE:
        unit = UNITS["deg"]
    else:
        unit = Unit(str(dimension), dimension)

    def in_unit(interval: Interval) -> str:
        low, high = (f"{end / unit.to_si(1.0):.{_DIGITS}g}" for end in interval)
        return low if low == high else f"{low} .. {high}"

    if allowed.low == -math.inf:
        limits = f"at most {in_unit(single(allowed.high))}"
    elif allowed.high == math.inf:
        limits = f"at least {in_unit(single(allowed.low))}"
    else:
        limits = in_unit(allowed)
    headline = f"{description} {in_unit(actual)} {unit.text}, but the robot file allows {limits} {unit.text}"
    values.add("DB304", text.span, headline, help, fix=_clamping_fix(text, numbers, allowed))


def _clamping_fix(text: SourceText, numbers: list[syntax.Number], allowed: Interval) -> Fix | None:
    """Return the fix that puts each number at the limit that it exceeds; None if the numbers have another
    meaning, or none would be left to draw from."""
    values = [_clamped(number, allowed) for number in numbers]
    if not values or (len(values) > 1 and values[0] >= values[1]):
        return None
    edits = []
    for number, value in zip(numbers, values, strict=True):
        match = re.compile(_NUMBER).match(text.text, number.start)
        if match is None:
            return None
        span = text.part(*match.span())
        # The text of a quoted value may differ from its source, which the fix edits.
        if span.text != match.group():
            return None
        if value != number.value:
            edits.append(Edit(span, f"{value:.{_DIGITS}g}"))
    return Fix(tuple(edits), safe=False) if edits else None


def _clamped(number: syntax.Number, allowed: Interval) -> float:
    factor = number.unit.to_si(1.0) if number.unit else 1.0
    low, high = (end / factor for end in allowed)
    # Rounding to a few digits must not lead beyond the limit again.
    if number.value < low:
        return _rounded(low, math.ceil)
    if number.value > high:
        return _rounded(high, math.floor)
    return number.value


def _numbers(tree: syntax.Node) -> Iterator[syntax.Number]:
    """Yield the number of a text with a single one, or the two ends that it is drawn from; otherwise none."""
    match tree:
        case syntax.Number():
            yield tree
        case syntax.Call(
            function="uniform", args=(syntax.Range(low=syntax.Number() as low, high=syntax.Number() as high),)
        ):
            yield from (low, high)


def _rounded(limit: float, inwards: Callable[[float], int]) -> float:
    """Return a limit with a few digits, and not beyond itself."""
    rounded = float(f"{limit:.{_DIGITS}g}")
    if math.isclose(rounded, limit, rel_tol=1e-9) or limit == 0.0:
        return rounded
    digits = _DIGITS - 1 - math.floor(math.log10(abs(limit)))
    scale = 10.0**digits
    return inwards(limit * scale) / scale


# Overrides

# Keys of an override, by their names in `with_friction` and in the table of variations.
_CONTACT: Mapping[str, tuple[str, LinkParameter]] = {
    "friction": ("lateral", "lateral_friction"),
    "spinning_friction": ("spinning", "spinning_friction"),
    "rolling_friction": ("rolling", "rolling_friction"),
    "restitution": ("restitution", "restitution"),
}


_UNKNOWN = Symbol("urdf", None, refusal="the robot file does not state this value")


@dataclass(frozen=True)
class Overrides:
    """The changes that the scenario makes to a robot. A drawn value is drawn for each link or joint that a
    pattern means."""

    robot: str
    groups: Mapping[str, NameGroup]
    namespace: Namespace

    @property
    def values(self) -> ValueReader:
        return self.namespace.values

    def apply(self, model: RobotModel, spec: RobotSpec) -> RobotModel:
        """Return the model with all changes that can be made; the others have findings."""
        links, joints = [link.name for link in model.links], [joint.name for joint in model.joints]
        moving = [joint.name for joint in model.moving_joints]
        centers: dict[str, LinkOverride] = {}
        inertias: dict[str, LinkOverride] = {}
        for pattern, change in spec.links.items():
            for name in self._members(links, pattern, change, "link"):
                model = self._change_link(model, model.link(name), change)
                centers |= {name: change} if change.com is not None else {}
                inertias |= {name: change} if change.inertia is not None else {}
        # Of two patterns that match a link, the later one counts, as for values that are not relative.
        for name, change in centers.items():
            model = self._move_center(model, model.link(name), change)
        for name, change in inertias.items():
            model = self._scale_inertia(model, model.link(name), change)
        for pattern, joint_change in spec.joints.items():
            for name in self._members(joints, pattern, joint_change, "joint"):
                joint = model.joint(name)
                if joint.moves:
                    model = self._change_joint(model, joint, joint_change)
                elif name == pattern:
                    report_motionless_joint(
                        self.values, self.values.key_span(joint_change.path), joint, moving
                    )
        return model

    def _members(
        self, names: list[str], pattern: str, change: LinkOverride | JointOverride, noun: str
    ) -> tuple[str, ...]:
        members, missing = expand_patterns(names, pattern, self.groups)
        if missing:
            kind = Kind.LINKS if noun == "link" else Kind.JOINTS
            groups = [name for name, (kind_of_group, _) in self.groups.items() if kind_of_group is kind]
            span = self.values.key_span(change.path)
            report_unmatched(self.values, span, pattern, noun, [*groups, *names])
        return members

    def _scope(self, dimension: Dimension = NUMBER, urdf: float | None = None) -> Scope:
        """Return the scope of a change of a value that is called `urdf` and comes from the robot file."""
        symbol = (
            _UNKNOWN if urdf is None else Symbol("urdf", ValueType(dimension, interval=single(urdf)), (urdf,))
        )
        return self.namespace.scope(Context.FIELD, {"urdf": symbol})

    def _change_link(self, model: RobotModel, link: Link, change: LinkOverride) -> RobotModel:
        subject = OfLink(self.robot, link.name)
        # The mass scales with the volume, so a mass that the scenario gives replaces the scaled one.
        factors = self.namespace.fields.triple(change, "scale", known=Known.EPISODE)
        if factors:
            model = self._accepted(model, with_scale(model, link.name, factors), change, "scale")
        if change.density is not None:
            model = self._change_density(model, link.name, change)
        elif change.mass is not None:
            model = self._change_mass(model, model.link(link.name), change)
        contact = {
            field: self.namespace.fields.scalar_or_randomized(
                change, key, parameter, subject, None, scope=self._scope()
            )
            for key, (field, parameter) in _CONTACT.items()
        }
        model = with_friction(model, link.name, **contact)
        paint = self.namespace.fields.color(change, subject)
        return with_color(model, link.name, paint) if paint else model

    def _change_density(self, model: RobotModel, link: str, change: LinkOverride) -> RobotModel:
        if change.mass is not None:
            self.values.add_at_key(
                "DB202",
                (*change.path, "density"),
                "`mass` and `density` cannot be combined",
                "keep one of the two",
            )
            return model
        shapes = model.link(link).collisions or model.link(link).visuals
        if not shapes and link != change.path[-1]:
            return model  # a pattern means the links that have a shape
        density = self.namespace.fields.fixed(change, "density", scope=self._scope(), known=Known.EPISODE)
        # A mass that an earlier pattern lets an episode draw would replace that of the density.
        self.namespace.fields.variations[:] = [
            drawn
            for drawn in self.namespace.fields.variations
            if (drawn.what, drawn.of) != ("mass", OfLink(self.robot, link))
        ]
        return (
            self._accepted(model, with_density(model, link, density), change, "density") if density else model
        )

    def _change_mass(self, model: RobotModel, link: Link, change: LinkOverride) -> RobotModel:
        if _lacks_mass(link, change):
            return model
        subject = OfLink(self.robot, link.name)
        scope = self._scope(MASS, link.inertial.mass if link.inertial else None)
        mass = self.namespace.fields.scalar_or_randomized(change, "mass", "mass", subject, None, scope=scope)
        if mass == 0 and not self.namespace.fields.is_randomized("mass", subject):
            self.values.add(
                "DB105", self.values.field(change, "mass").span, "`mass` is 0 kg", "write more than 0 kg"
            )
        if not mass:
            return model
        states_mass = link.inertial is not None and link.inertial.mass > 0.0
        with_new = with_mass if states_mass else with_mass_of_shapes
        return self._accepted(model, with_new(model, link.name, mass), change, "mass")

    def _move_center(self, model: RobotModel, link: Link, change: LinkOverride) -> RobotModel:
        if _lacks_mass(link, change):
            return model
        subject = OfLink(self.robot, link.name)
        fields = self.namespace.fields
        offset = fields.vector_or_randomized(change, "com", "center_of_mass", subject, per_component=SPACE)
        if offset is None:
            return model
        varies = fields.is_randomized("center_of_mass", subject)
        fixed: Vector = ZERO if varies else (offset[0], offset[1], offset[2])
        model = self._accepted(model, with_center(model, link.name, fixed), change, "com")
        return with_link(model, replace(model.link(link.name), center_varies=varies))

    def _scale_inertia(self, model: RobotModel, link: Link, change: LinkOverride) -> RobotModel:
        if _lacks_mass(link, change):
            return model
        if change.inertia == AUTO:
            return self._accepted(model, with_inertia_of_shapes(model, link.name), change, "inertia")
        subject = OfLink(self.robot, link.name)
        fields = self.namespace.fields
        factor = fields.scalar_or_randomized(change, "inertia", "inertia", subject, None)
        if factor is None:
            return model
        fixed = 1.0 if fields.is_randomized("inertia", subject) else factor
        return self._accepted(model, with_inertia(model, link.name, fixed), change, "inertia")

    def _accepted(self, old: RobotModel, new: RobotModel | str, change: LinkOverride, key: str) -> RobotModel:
        """Return the changed model, or the old one with a finding that gives the reason."""
        if isinstance(new, str):
            self.values.add("DB105", self.values.field(change, key).span, new)
            return old
        return new

    def _change_joint(self, model: RobotModel, joint: Joint, change: JointOverride) -> RobotModel:
        position = joint_dimension(joint)
        effort = effort_dimension(joint)
        limit = joint.limit

        def drawn(
            key: str, parameter: JointParameter, urdf: float | None, dimension: Dimension
        ) -> float | None:
            subject = OfJoint(self.robot, joint.name)
            scope = self._scope(dimension, urdf)
            return self.namespace.fields.scalar_or_randomized(
                change, key, parameter, subject, None, dimension=dimension, scope=scope
            )

        def fixed(key: str, urdf: float | None, dimension: Dimension) -> float | None:
            scope = self._scope(dimension, urdf)
            numbers = self.namespace.fields.fixed(
                change, key, dimension=dimension, scope=scope, known=Known.EPISODE
            )
            return urdf if numbers is None else numbers

        damping = drawn("damping", "joint_damping", joint.damping, effort * TIME / position)
        friction = drawn("friction", "joint_friction", joint.friction, effort)
        armature = drawn("armature", "joint_armature", joint.armature, _armature_dimension(joint))
        torque = fixed("max_torque", limit.effort, effort)
        velocity = fixed("max_velocity", limit.velocity, position / TIME)
        limit = replace(limit, effort=torque, velocity=velocity)
        if change.range is not None:
            limit = self._range(joint, limit, change)
        return with_joint(
            model, joint.name, damping=damping, friction=friction, armature=armature, limit=limit
        )

    def _range(self, joint: Joint, limit: Limit, change: JointOverride) -> Limit:
        """Return `limit` with both ends as the scenario gives them."""
        if joint.type == "continuous":
            span = self.values.field(change, "range").span
            self.values.add(
                "DB203",
                span,
                "a continuous joint cannot have a range",
                "remove `range`, or change the type of the joint to revolute in the robot file",
            )
            return limit
        scope = self.namespace.scope(Context.FIELD)
        dimension = joint_dimension(joint)
        ends = self.namespace.fields.ends(
            change, "range", description="the range of a joint", dimension=dimension, scope=scope
        )
        return replace(limit, lower=ends.low[0], upper=ends.high[0]) if ends else limit


def _lacks_mass(link: Link, change: LinkOverride) -> bool:
    """Return whether a change of masses leaves a link out: a pattern means the links that have a mass."""
    return link.inertial is None and link.name != change.path[-1]


@dataclass(frozen=True, eq=False)
class ResolvedRobot:
    """A robot of the scenario: its specification, its body as changed by it, and its named groups."""

    name: str
    path: FilePath
    spec: RobotSpec
    file: RobotFile
    model: RobotModel
    groups: dict[str, NameGroup]

    @property
    def copied_path(self) -> FilePath:
        """The robot file, or the path for the URDF that a xacro file was expanded to: it depends on the
        arguments, too."""
        if self.file.xacro is None:
            return self.path
        stem = self.path.name.partition(".")[0]
        return self.path.with_name(f"{stem}_{self.file.digest[:8]}.urdf")

    @property
    def link_names(self) -> list[str]:
        return [link.name for link in self.model.links]

    def subject(self, part: str, kinds: frozenset[Kind] | None = None) -> Subject | None:
        """Return the joint, link, group or, if it is among `kinds`, sensor called `part`; if several share
        the name, the one of `kinds`."""
        full = f"{self.name}.{part}"
        is_link = part in self.link_names
        if part in self.spec.sensors and kinds and not kinds.isdisjoint({Kind.SENSOR, Kind.CAMERA}):
            return Subject(full, Kind.CAMERA if isinstance(self.spec.sensors[part], Camera) else Kind.SENSOR)
        if part in self.groups:
            kind, members = self.groups[part]
            names = tuple(f"{self.name}.{member}" for member in members)
            if kind is Kind.LINKS:
                return Subject(full, kind, names)
            joints = [self.model.joint(member) for member in members]
            limits = tuple(map(joint_interval, joints))
            return Subject(
                full,
                kind,
                names,
                dimension=joint_dimension(joints[0]),
                interval=intervals.hull(limits),
                intervals=limits,
            )
        if not (is_link and kinds and Kind.LINK in kinds):
            for joint in self.model.moving_joints:
                if joint.name == part:
                    return Subject(
                        full, Kind.JOINT, dimension=joint_dimension(joint), interval=joint_interval(joint)
                    )
        return Subject(full, Kind.LINK, link=full) if is_link else None

    @property
    def drivable_joints(self) -> list[str]:
        """The joints that move and follow no other one."""
        return [joint.name for joint in self.model.moving_joints if joint.name not in self.model.followers]

    def joints_of(self, spec: Section, values: ValueReader) -> tuple[Joint, ...]:
        """Return the joints that `joint` or `joints` of a sensor or actuator names; none after a finding.

        A pattern or a group of an actuator leaves followers out.
        """
        key = "joint" if getattr(spec, "joint", None) is not None else "joints"
        offered = (
            self.drivable_joints
            if isinstance(spec, Actuator)
            else [joint.name for joint in self.model.moving_joints]
        )
        names = self._named(spec, key, offered, values)
        joints = tuple(self.model.joint(name) for name in names)
        if len({joint_dimension(joint) for joint in joints}) > 1:
            values.add(
                "DB404",
                (*spec.path, key),
                "this list contains both turning and sliding joints",
                "use one sensor or actuator for the turning joints, and another one for the sliding joints",
            )
            return ()
        return joints

    def links_of(self, spec: Section, values: ValueReader) -> tuple[str, ...]:
        """Return the links that `link` or `links` of a sensor or actuator names; none after a finding."""
        link = getattr(spec, "link", None)
        if link is None:
            return self._named(spec, "links", self.link_names, values)
        if link not in self.link_names:
            values.report_unknown(values.span((*spec.path, "link")), "link", link, self.link_names)
        return (link,) if link in self.link_names else ()

    def _named(self, spec: Section, key: str, candidates: list[str], values: ValueReader) -> tuple[str, ...]:
        """Return the names that the patterns under a key match; none after a finding."""
        patterns = getattr(spec, key) or ()  # neither key is left where validation had a finding about it
        names, missing = expand_patterns(candidates, patterns, self.groups)
        for index, pattern in enumerate([patterns] if isinstance(patterns, str) else patterns):
            if pattern in missing:
                span = values.span((*spec.path, *((key,) if isinstance(patterns, str) else (key, index))))
                if key == "links":
                    report_unmatched(values, span, pattern, "link", candidates)
                else:
                    self.report_missing_joint(values, span, pattern, candidates)
        return () if missing else names

    def report_missing_joint(
        self, values: ValueReader, span: Span, pattern: str, movable_names: Sequence[str]
    ) -> None:
        """Report a joint or group where one of the `movable_names` is needed; for a group without any of
        them, its first joint is reported."""
        kind, members = self.groups.get(pattern, (None, ()))
        groups = [name for name, (kind_of_group, _) in self.groups.items() if kind_of_group is Kind.JOINTS]
        report_missing_joint(
            values,
            span,
            members[0] if kind is Kind.JOINTS else pattern,
            self.model,
            [*groups, *movable_names],
        )

    @property
    def parts(self) -> list[str]:
        return [
            *self.groups,
            *(joint.name for joint in self.model.moving_joints),
            *self.link_names,
            *self.spec.sensors,
        ]


def load_robot(name: str, spec: RobotSpec, namespace: Namespace) -> ResolvedRobot | None:
    """Read the robot file that `robots.<name>.urdf` names, and apply the overrides; None after a finding."""
    document, values = namespace.document, namespace.values
    nodes = (descend(values.root, path)[0] for path in (spec.path, (*spec.path, "xacro")))
    if any(isinstance(node, MappingNode) and node.partial for node in nodes):
        return None  # a finding took keys away that the rest of the scenario may name
    file_at = locate_file(spec.urdf, values.field(spec, "urdf").span, document, values, robot=True)
    if file_at is None:
        return None
    if file_at.suffix in (".yaml", ".yml"):
        values.add(
            "DB301",
            values.field(spec, "urdf").span,
            f"`{spec.urdf}` is not a robot file",
            "write the path of a URDF file, or the name of a shipped robot, such as `cartpole`",
        )
        return None
    resolve_mesh = packages.mesh_resolver(
        file_at.parent, (*document.roots, *packages.package_folders(spec.urdf))
    )
    findings = Findings()
    file = read(
        file_at,
        files.display_path(file_at),
        findings,
        resolve_mesh=resolve_mesh,
        arguments=xacro_arguments(spec.xacro),
    )
    if file is None:
        _tell(findings, values, {}, ())
        return None
    names = sorted(file.xacro.arguments) if file.xacro else []
    for argument in [argument for argument in spec.xacro if argument not in names]:
        span = values.key_span((*spec.path, "xacro", argument))
        values.report_unknown(span, "xacro argument", argument, names)
    groups = _groups(file.model, spec, values)
    model = Overrides(name, groups, namespace).apply(file.model, spec)
    changed = [
        link.name
        for link in model.links
        if link.density is not None or link.inertial != file.model.link(link.name).inertial
    ]
    _tell(findings, values, file.inertial_links, changed)
    return ResolvedRobot(name, file_at.resolve(), spec, file, model, groups)


def xacro_arguments(values: Mapping[str, Scalar | bool]) -> dict[str, str]:
    """Return the texts of arguments, as `xacro NAME:=TEXT` takes them."""
    return {
        name: str(value).lower() if isinstance(value, bool) else str(value) for name, value in values.items()
    }


def _tell(
    findings: Iterable[Finding],
    values: ValueReader,
    inertial_links: Mapping[Span, tuple[str, ...]],
    changed: Collection[str],
) -> None:
    """Report the findings of a robot file, except for those about inertials that the scenario has `changed`;
    their fixes are those of the robot file alone."""
    for finding in findings:
        links = inertial_links.get(finding.span, ())
        if not links or not set(links) <= set(changed):
            values.findings.append(replace(finding, fix=None))


def locate_file(
    reference: str, span: Span, document: Document, values: ValueReader, *, robot: bool = False
) -> FilePath | None:
    """Return the file that the scenario names at `span`: in the project, in an installed package, or, of a
    `robot`, a shipped one."""
    if reference.startswith("package://"):
        path = packages.locate_file(reference, document.directory_of(span), document.roots)
        if path is None:
            values.add(
                "DB204", span, f"`{reference}` does not exist", _package_help(reference, document, span)
            )
        return path
    located = files.resolve_reference(
        reference, document.directory_of(span), document.roots, shipped.ROBOTS if robot else None
    )
    if isinstance(located, FilePath):
        return located
    library = packages.library_reference(reference)
    fix = Fix.replacing(span, reference, library, safe=False) if library else located.fix(span)
    values.add(
        "DB204",
        span,
        located.headline,
        f"did you mean `{library}`?" if library else located.help,
        notes=located.notes,
        fix=fix,
    )
    return None


def _package_help(reference: str, document: Document, span: Span) -> str:
    """Return why `package://X/rest` names no file, and the path of a file of this name in the project."""
    package, _, inside = reference.removeprefix("package://").partition("/")
    if packages.package_folder(package):
        help = f"the Python package `{package}` is installed, but has no file `{inside}`"
    else:
        help = (
            f"there is no package `{package}`: no installed Python package, and no folder near the scenario that"
            " has this name or whose `package.xml` has it; write the path of the file"
        )
    candidates = (
        files.find_in(document.roots[0], FilePath(inside).name) if document.roots and inside else None
    )
    if candidates is None:
        return help
    return f"{help}: `{FilePath(os.path.relpath(candidates, document.directory_of(span))).as_posix()}`"


def _groups(model: RobotModel, spec: RobotSpec, values: ValueReader) -> dict[str, NameGroup]:
    groups: dict[str, NameGroup] = {}
    joints, links = [joint.name for joint in model.moving_joints], [link.name for link in model.links]
    for name, patterns in spec.groups.items():
        path = (*spec.path, "groups", name)
        if name in joints or name in links:
            noun = "joint" if name in joints else "link"
            values.add_at_key("DB202", path, f"`{name}` is already a {noun}", "choose another name")
        as_joints, not_joints = expand_patterns(joints, patterns, groups)
        as_links, not_links = expand_patterns(links, patterns, groups)
        if not not_joints and len({joint_dimension(model.joint(joint)) for joint in as_joints}) > 1:
            values.add(
                "DB404",
                path,
                "turning and sliding joints in one group",
                "make one group of turning joints, and one of sliding joints",
            )
        elif not not_joints:
            groups[name] = (Kind.JOINTS, as_joints)
            continue
        elif not not_links:
            groups[name] = (Kind.LINKS, as_links)
            continue
        elif odd := [pattern for pattern in not_joints if pattern in not_links]:
            span = values.span((*path, patterns.index(odd[0])))
            if matching_names((joint.name for joint in model.joints), odd[0]):
                report_missing_joint(values, span, odd[0], model, joints)
            else:
                report_unmatched(
                    values, span, odd[0], "joint or link", list(dict.fromkeys([*joints, *links]))
                )
        else:
            values.add(
                "DB203", path, "joints and links in one group", "make one group of joints, and one of links"
            )
        values.mark_invalid(name)
    return groups

"""Figures of a robot that the scenario changes: mass, stretch, friction, damping, limits.

In each of them `urdf` stands for the figure of the robot file.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from deepbots_cli.compiler import variations
from deepbots_cli.compiler.colours import colour
from deepbots_cli.compiler.joints import effort_of, joint_dimension
from deepbots_cli.compiler.matching import Group, expand, motionless, unmatched
from deepbots_cli.compiler.values import Values
from deepbots_cli.document.nodes import Path
from deepbots_cli.expressions.dimensions import LENGTH, MASS, NUMBER, TIME, Dimension
from deepbots_cli.expressions.intervals import exact
from deepbots_cli.expressions.types import SPACE, Context, Kind, Scope, Subject, Symbol, Type
from deepbots_cli.robots import edits
from deepbots_cli.robots.model import Joint, Limit, Link, RobotModel
from deepbots_cli.scenario.robot import JointOverride, LinkOverride
from deepbots_cli.scenario.robot import Robot as RobotSpec

if TYPE_CHECKING:
    from deepbots_cli.compiler.namespace import Namespace

# Keys of an override: what `edits.with_friction` and the table of variations call them.
_CONTACT = {
    "friction": ("lateral", "lateral_friction"),
    "spinning_friction": ("spinning", "spinning_friction"),
    "rolling_friction": ("rolling", "rolling_friction"),
    "restitution": ("restitution", "restitution"),
}


_UNKNOWN = Symbol("urdf", None, refused="the robot file does not say")


@dataclass(frozen=True)
class _WithUrdf:
    """The scope of an override: the scenario's, and `urdf`, the figure of the robot file."""

    outer: Scope
    figure: Symbol

    @property
    def context(self) -> Context:
        return self.outer.context

    def lookup(self, name: str) -> Symbol | None:
        return self.figure if name == "urdf" else self.outer.lookup(name)

    def subject(self, name: str, kinds: frozenset[Kind] | None = None) -> Subject | None:
        return self.outer.subject(name, kinds)

    def names(self) -> Iterable[str]:
        return ["urdf", *self.outer.names()]

    def subjects(self) -> Iterable[str]:
        return self.outer.subjects()


@dataclass(frozen=True)
class Overrides:
    """The changes that stand in the scenario at `path`, the robot's.

    A figure that is drawn is drawn for each link or joint that a pattern means.
    """

    path: Path
    groups: Mapping[str, Group]
    namespace: Namespace
    scope: Scope

    @property
    def values(self) -> Values:
        return self.namespace.values

    def apply(self, model: RobotModel, spec: RobotSpec) -> RobotModel:
        """The model with all changes made that can be made; findings about the others."""
        links, joints = [link.name for link in model.links], [joint.name for joint in model.joints]
        for pattern, change in spec.links.items():
            place: Path = (*self.path, "links", pattern)
            for name in self._members(links, pattern, place, "link"):
                model = self._change_link(model, model.link(name), change, place)
        for pattern, joint_change in spec.joints.items():
            place = (*self.path, "joints", pattern)
            for name in self._members(joints, pattern, place, "joint"):
                joint = model.joint(name)
                if joint.moves:
                    model = self._change_joint(model, joint, joint_change, place)
                elif name == pattern:
                    motionless(self.values, self.values.key_span(place), joint, model)
        return model

    def _members(self, names: list[str], pattern: str, place: Path, what: str) -> tuple[str, ...]:
        members, missing = expand(names, pattern, self.groups)
        if missing:
            unmatched(self.values, self.values.key_span(place), pattern, what, names)
        return members

    def _figure(
        self, place: Path, given: object, urdf: float | None, dimension: Dimension, what: str | None = None, of: str = ""
    ) -> float | None:
        """The SI value of a change; None where none is given, or after a finding.

        `what` is its entry in the table of variations if an episode may draw it, `of` the link or joint.
        """
        figure = Symbol("urdf", Type(dimension, interval=exact(urdf)), (urdf,)) if urdf is not None else _UNKNOWN
        scope = _WithUrdf(self.scope, figure)
        if what is None:
            return self.values.figure(place, given, dimension, scope)
        return variations.figure(self.namespace, place, given, dimension, scope, what, (str(self.path[-1]), of))

    def _change_link(self, model: RobotModel, link: Link, change: LinkOverride, place: Path) -> RobotModel:
        factors = self.values.figures((*place, "stretch"), change.stretch, NUMBER, self.scope, SPACE)
        if factors:
            x, y, z = factors
            model = self._accepted(model, edits.stretch(model, link.name, (x, y, z)), (*place, "stretch"))
        if change.density is not None:
            model = self._change_density(model, link.name, change, place)
        elif change.mass is not None:
            model = self._change_mass(model, model.link(link.name), change.mass, place)
        contact = {
            field: self._figure((*place, key), getattr(change, key), None, NUMBER, what, link.name)
            for key, (field, what) in _CONTACT.items()
        }
        paint = colour(self.namespace, (*place, "colour"), change.colour, (str(self.path[-1]), link.name))
        model = edits.with_friction(model, link.name, **contact)
        return edits.with_colour(model, link.name, paint) if paint else model

    def _change_density(self, model: RobotModel, link: str, change: LinkOverride, place: Path) -> RobotModel:
        if change.mass is not None:
            span = self.values.key_span((*place, "density"))
            self.values.findings.add("DB202", span, "`mass` and `density` both set the mass", help="give one of the two")
            return model
        density = self._figure((*place, "density"), change.density, None, MASS / LENGTH**3)
        return self._accepted(model, edits.with_density(model, link, density), (*place, "density")) if density else model

    def _change_mass(self, model: RobotModel, link: Link, given: object, place: Path) -> RobotModel:
        if link.inertial is None and link.name != place[-1]:
            return model  # a pattern means the links that have a mass
        mass = self._figure((*place, "mass"), given, link.inertial.mass if link.inertial else None, MASS, "mass", link.name)
        if mass == 0 and not self.namespace.varies("mass", (str(self.path[-1]), link.name)):
            self.values.findings.add("DB105", self.values.span((*place, "mass")), "`mass` is 0 kg", help="give more than 0 kg")
        return self._accepted(model, edits.with_mass(model, link.name, mass), (*place, "mass")) if mass else model

    def _accepted(self, old: RobotModel, new: RobotModel | str, place: Path) -> RobotModel:
        """The changed model, or the old one and a finding that says why it cannot be changed so."""
        if isinstance(new, str):
            self.values.findings.add("DB105", self.values.span(place), new)
            return old
        return new

    def _change_joint(self, model: RobotModel, joint: Joint, change: JointOverride, place: Path) -> RobotModel:
        position, effort, limit = joint_dimension(joint), effort_of(joint), joint.limit
        damping = self._figure((*place, "damping"), change.damping, joint.damping, effort * TIME / position, "joint_damping", joint.name)
        friction = self._figure((*place, "friction"), change.friction, joint.friction, effort, "joint_friction", joint.name)
        torque = self._figure((*place, "max_torque"), change.max_torque, limit.effort, effort)
        velocity = self._figure((*place, "max_velocity"), change.max_velocity, limit.velocity, position / TIME)
        limit = replace(
            limit,
            effort=limit.effort if torque is None else torque,
            velocity=limit.velocity if velocity is None else velocity,
        )
        if change.range is not None:
            limit = self._range(joint, limit, change.range, (*place, "range"))
        return edits.with_joint(model, joint.name, damping=damping, friction=friction, limit=limit)

    def _range(self, joint: Joint, limit: Limit, given: str, place: Path) -> Limit:
        """`limit` with both ends as the scenario gives them."""
        if joint.type == "continuous":
            headline = "a range for a joint that the robot file calls continuous"
            self.values.findings.add("DB203", self.values.span(place), headline, help="make it revolute in the robot file")
            return limit
        ends = self.values.ends(self.values.text(place, given), "the range of a joint", self.scope, dimension=joint_dimension(joint))
        return replace(limit, lower=ends.low[0], upper=ends.high[0]) if ends else limit

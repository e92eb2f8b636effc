"""Robot files into the scenario: found, read, changed as the scenario asks, and their parts named."""

from __future__ import annotations

import os
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from deepbots_cli.compile.values import Values
from deepbots_cli.diagnostics import Findings
from deepbots_cli.lang.dimensions import ANGLE, LENGTH, MASS, NUMBER, TIME, TORQUE, Dimension
from deepbots_cli.lang.intervals import EVERYTHING, Interval
from deepbots_cli.lang.lower import constant
from deepbots_cli.lang.types import SPACE, Components, Context, Kind, Scope, Stage, Subject, Symbol, Type, shown
from deepbots_cli.schema.robot import JointOverride, LinkOverride
from deepbots_cli.schema.robot import Robot as RobotSpec
from deepbots_cli.source import Document, roots, shipped
from deepbots_cli.source.nodes import Path as NodePath
from deepbots_cli.urdf import mesh, override
from deepbots_cli.urdf.kinematics import match
from deepbots_cli.urdf.model import Joint, RobotModel
from deepbots_cli.urdf.reader import RobotFile, read


@dataclass(frozen=True, eq=False)
class RobotScene:
    """A robot of the scenario: its specification, its body as changed by it, and its named groups.

    `groups` maps a name to the kind (joints or links) and the short names of its members.
    """

    name: str
    spec: RobotSpec
    file: RobotFile
    model: RobotModel
    groups: dict[str, tuple[Kind, tuple[str, ...]]]

    @property
    def joint_names(self) -> list[str]:
        return [joint.name for joint in self.model.joints]

    @property
    def link_names(self) -> list[str]:
        return [link.name for link in self.model.links]

    def subject(self, part: str) -> Subject | None:
        """The joint, link or group called `part`."""
        full = f"{self.name}.{part}"
        if part in self.groups:
            kind, members = self.groups[part]
            names = tuple(f"{self.name}.{member}" for member in members)
            if kind is Kind.LINKS:
                return Subject(full, kind, names)
            joints = [self.model.joint(member) for member in members]
            return Subject(full, kind, names, dimension=joint_dimension(joints[0]), interval=_hull(joints))
        for joint in self.model.joints:
            if joint.name == part and joint.moves:
                return Subject(full, Kind.JOINT, dimension=joint_dimension(joint), interval=joint_interval(joint))
        if part in self.link_names:
            return Subject(full, Kind.LINK, link=full)
        return None

    @property
    def parts(self) -> list[str]:
        return [*self.groups, *(joint.name for joint in self.model.joints if joint.moves), *self.link_names]


def joint_dimension(joint: Joint) -> Dimension:
    """Of a joint's position: a length where it slides, else an angle."""
    return LENGTH if joint.type == "prismatic" else ANGLE


def joint_interval(joint: Joint) -> Interval:
    """The positions that the limits of the joint leave."""
    if joint.limit.lower is None or joint.limit.upper is None:
        return EVERYTHING
    return Interval(joint.limit.lower, joint.limit.upper)


def _hull(joints: Iterable[Joint]) -> Interval:
    intervals = [joint_interval(joint) for joint in joints]
    return Interval(min(i.low for i in intervals), max(i.high for i in intervals))


def load_robot(name: str, spec: RobotSpec, document: Document, values: Values, scope: Scope) -> RobotScene | None:
    """Read the robot file that `robots.<name>.urdf` names, and apply the overrides; None after a finding."""
    path: NodePath = ("robots", name)
    located = _locate(spec.urdf, (*path, "urdf"), document, values)
    if located is None:
        return None
    file = read(located, _display(located), values.findings, resolve_mesh=_mesh_resolver(located.parent, document.roots))
    if file is None:
        return None
    model = _override_links(file.model, spec.links, path, values, scope)
    model = _override_joints(model, spec.joints, path, values, scope)
    groups = _groups(model, spec, path, values)
    return RobotScene(name, spec, file, model, groups)


def _locate(reference: str, path: NodePath, document: Document, values: Values) -> Path | None:
    span = values.span(path)
    if reference.startswith("package://"):
        found = mesh.locate(reference, document.directory_of(span))
        if isinstance(found, Path) and found.is_file() and mesh.package_folder(reference.removeprefix("package://").partition("/")[0]):
            return found
        values.findings.add("DB204", span, f"`{reference}` does not exist", help="the package must be installed, and hold such a file")
        return None
    beside = roots.resolve(reference, document.directory_of(span), document.roots)
    if isinstance(beside, Path):
        return beside
    by_name = shipped.robot_path(reference)
    if by_name is not None:
        return by_name
    names = shown(shipped.robot_names())
    values.findings.add("DB204", span, beside.headline, help=beside.help, notes=(f"shipped robots are: {names}",))
    return None


def _display(path: Path) -> str:
    here = Path.cwd()
    return os.path.relpath(path, here) if path.is_relative_to(here) else str(path)


def _mesh_resolver(folder: Path, allowed: tuple[Path, ...]) -> mesh.ResolveMesh:
    """Meshes may lie in the robot's folder, in the project, or in the package that their name says."""
    nearby = mesh.beside(folder)

    def resolve(reference: str) -> Path | mesh.Refusal:
        path = nearby(reference)
        if isinstance(path, Path):
            return path
        elsewhere = mesh.locate(reference, folder)
        return elsewhere if isinstance(elsewhere, Path) and any(elsewhere.is_relative_to(root) for root in allowed) else path

    return resolve


# Groups


def expand(
    names: list[str], patterns: str | Iterable[str], groups: dict[str, tuple[Kind, tuple[str, ...]]]
) -> tuple[tuple[str, ...], list[str]]:
    """The names that patterns and groups stand for, in order, without repeats; and what stood for nothing."""
    listed = [patterns] if isinstance(patterns, str) else list(patterns)
    found: dict[str, None] = {}
    missing = []
    for pattern in listed:
        matched = groups[pattern][1] if pattern in groups else match(names, pattern)
        if not matched:
            missing.append(pattern)
        found.update(dict.fromkeys(matched))
    return tuple(found), missing


def _groups(model: RobotModel, spec: RobotSpec, path: NodePath, values: Values) -> dict[str, tuple[Kind, tuple[str, ...]]]:
    groups: dict[str, tuple[Kind, tuple[str, ...]]] = {}
    moving = [joint.name for joint in model.joints if joint.moves]
    links = [link.name for link in model.links]
    for name, patterns in spec.groups.items():
        place = (*path, "groups", name)
        joints, not_joints = expand(moving, patterns, groups)
        if joints and not not_joints:
            if len({joint_dimension(model.joint(joint)) for joint in joints}) > 1:
                values.findings.add("DB404", values.span(place), "turning and sliding joints in one group", help="make a group of each")
                continue
            groups[name] = (Kind.JOINTS, joints)
            continue
        members, missing = expand(links, patterns, groups)
        if missing or not members:
            empty_match(values.findings, values, place, missing[0] if missing else name, "joint or link", [*moving, *links])
            continue
        groups[name] = (Kind.LINKS, members)
    return groups


def empty_match(findings: Findings, values: Values, place: NodePath, pattern: str, what: str, names: list[str]) -> None:
    """DB206 for a pattern, DB302 or DB201 for a plain name, with what there is."""
    from difflib import get_close_matches  # only on the way to a finding

    code = "DB206" if set(pattern) & set("*?[") else ("DB302" if what == "joint" else "DB201")
    close = get_close_matches(pattern, names, n=1)
    near = f"did you mean `{close[0]}`? " if close else ""
    headline = f"`{pattern}` matches no {what}" if code == "DB206" else f"there is no {what} `{pattern}`"
    findings.add(code, values.span(place), headline, help=f"{near}there are: {shown(names, 20)}")


# Overrides


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

    def subject(self, name: str) -> Subject | None:
        return self.outer.subject(name)

    def names(self) -> Iterable[str]:
        return ["urdf", *self.outer.names()]

    def subjects(self) -> Iterable[str]:
        return self.outer.subjects()


def _figure(
    place: NodePath,
    given: object,
    urdf: float | None,
    dimension: Dimension,
    values: Values,
    scope: Scope,
    components: Components | None = None,
) -> tuple[float, ...] | None:
    """The fixed SI values of an override; a drawn one is reported as not supported yet."""
    known = Symbol("urdf", Type(dimension), (urdf,)) if urdf is not None else Symbol("urdf", None, refused="the robot file does not say")
    text = values.text(place, given)
    typed = values.quantity(text, f"`{place[-1]}`", _WithUrdf(scope, known), dimension, components, Stage.EPISODE)
    if typed is None:
        return None
    fixed = constant(typed)
    if fixed is None:
        values.findings.add("DB108", text.span, "a figure of the robot that is drawn anew is not supported yet", help="give a fixed figure")
        return None
    return tuple(float(value) for value in fixed)


def _override_links(model: RobotModel, overrides: dict[str, LinkOverride], path: NodePath, values: Values, scope: Scope) -> RobotModel:
    names = [link.name for link in model.links]
    for pattern, change in overrides.items():
        place = (*path, "links", pattern)
        links, missing = expand(names, pattern, {})
        if missing:
            empty_match(values.findings, values, place, pattern, "link", names)
        for link in links:
            model = _override_link(model, link, change, place, values, scope)
    return model


def _override_link(model: RobotModel, link: str, change: LinkOverride, place: NodePath, values: Values, scope: Scope) -> RobotModel:
    if change.stretch is not None:
        factors = _figure((*place, "stretch"), change.stretch, None, NUMBER, values, scope, SPACE)
        model = (
            _accept(model, override.stretch(model, link, (factors[0], factors[1], factors[2])), (*place, "stretch"), values)
            if factors
            else model
        )
    if change.mass is not None:
        inertial = model.link(link).inertial
        mass = _figure((*place, "mass"), change.mass, inertial.mass if inertial else None, MASS, values, scope)
        model = _accept(model, override.with_mass(model, link, mass[0]), (*place, "mass"), values) if mass else model
    contact = {}
    for key, field in (
        ("friction", "lateral"),
        ("spinning_friction", "spinning"),
        ("rolling_friction", "rolling"),
        ("restitution", "restitution"),
    ):
        given = getattr(change, key)
        figure = _figure((*place, key), given, None, NUMBER, values, scope) if given is not None else None
        if figure:
            contact[field] = figure[0]
    return override.with_friction(model, link, **contact) if contact else model


def _accept(old: RobotModel, new: RobotModel | str, place: NodePath, values: Values) -> RobotModel:
    if isinstance(new, str):
        values.findings.add("DB105", values.span(place), new)
        return old
    return new


def _override_joints(model: RobotModel, overrides: dict[str, JointOverride], path: NodePath, values: Values, scope: Scope) -> RobotModel:
    names = [joint.name for joint in model.joints]
    for pattern, change in overrides.items():
        place = (*path, "joints", pattern)
        joints, missing = expand(names, pattern, {})
        if missing:
            empty_match(values.findings, values, place, pattern, "joint", names)
        for name in joints:
            model = _override_joint(model, model.joint(name), change, place, values, scope)
    return model


def _override_joint(model: RobotModel, joint: Joint, change: JointOverride, place: NodePath, values: Values, scope: Scope) -> RobotModel:
    if not joint.moves:
        return model
    effort = TORQUE if joint_dimension(joint) == ANGLE else TORQUE / LENGTH
    changed: dict[str, float] = {}
    if change.damping is not None:
        damping = _figure((*place, "damping"), change.damping, joint.damping, effort * TIME / joint_dimension(joint), values, scope)
        changed |= {"damping": damping[0]} if damping else {}
    if change.friction is not None:
        friction = _figure((*place, "friction"), change.friction, joint.friction, effort, values, scope)
        changed |= {"friction": friction[0]} if friction else {}
    for key in ("range", "max_torque", "max_velocity"):
        if getattr(change, key) is not None:
            values.findings.add(
                "DB108", values.key_span((*place, key)), f"`{key}` of a joint is not supported yet", help="change it in the robot file"
            )
    return override.with_joint(model, joint.name, **changed) if changed else model

"""Robot files into the scenario: found, read, changed as the scenario asks, and their parts named."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from deepbots_cli.compiler.joints import hull, joint_dimension, joint_interval
from deepbots_cli.compiler.matching import Group, expand, unmatched
from deepbots_cli.compiler.overrides import Overrides
from deepbots_cli.compiler.values import Values
from deepbots_cli.diagnostics import Findings, Fix, Span
from deepbots_cli.document import Document, files, shipped
from deepbots_cli.document.nodes import Path as NodePath
from deepbots_cli.expressions.types import Kind, Scope, Subject, shown
from deepbots_cli.robots import meshes
from deepbots_cli.robots.model import RobotModel
from deepbots_cli.robots.reader import RobotFile, read
from deepbots_cli.scenario.robot import Robot as RobotSpec

if TYPE_CHECKING:
    from deepbots_cli.compiler.namespace import Namespace


@dataclass(frozen=True, eq=False)
class RobotScene:
    """A robot of the scenario: its specification, its body as changed by it, and its named groups."""

    name: str
    path: Path
    spec: RobotSpec
    file: RobotFile
    model: RobotModel
    groups: dict[str, Group]

    @property
    def link_names(self) -> list[str]:
        return [link.name for link in self.model.links]

    def subject(self, part: str, kinds: frozenset[Kind] | None = None) -> Subject | None:
        """The joint, link, group or, where `kinds` asks for one, sensor called `part`; where several share the name, the one of `kinds`."""
        full = f"{self.name}.{part}"
        is_link = part in self.link_names
        if part in self.spec.sensors and kinds and not kinds.isdisjoint({Kind.SENSOR, Kind.CAMERA}):
            return Subject(full, Kind.CAMERA if self.spec.sensors[part].type == "camera" else Kind.SENSOR)
        if part in self.groups:
            kind, members = self.groups[part]
            names = tuple(f"{self.name}.{member}" for member in members)
            if kind is Kind.LINKS:
                return Subject(full, kind, names)
            joints = [self.model.joint(member) for member in members]
            return Subject(full, kind, names, dimension=joint_dimension(joints[0]), interval=hull(joints))
        if not (is_link and kinds and Kind.LINK in kinds):
            for joint in self.model.moving_joints:
                if joint.name == part:
                    return Subject(full, Kind.JOINT, dimension=joint_dimension(joint), interval=joint_interval(joint))
        return Subject(full, Kind.LINK, link=full) if is_link else None

    @property
    def parts(self) -> list[str]:
        return [*self.groups, *(joint.name for joint in self.model.moving_joints), *self.link_names, *self.spec.sensors]


def load_robot(name: str, spec: RobotSpec, document: Document, namespace: Namespace, scope: Scope) -> RobotScene | None:
    """Read the robot file that `robots.<name>.urdf` names, and apply the overrides; None after a finding."""
    path: NodePath = ("robots", name)
    values = namespace.values
    located = _locate(spec.urdf, (*path, "urdf"), document, values)
    if located is None:
        return None
    resolve_mesh = meshes.beside(located.parent, (*document.roots, *meshes.package_of(spec.urdf)))
    found = Findings()
    file = read(located, files.display(located), found, resolve_mesh=resolve_mesh)
    if file is None:
        _tell(found, values, ())
        return None
    groups = _groups(file.model, spec, path, values)
    model = Overrides(path, groups, namespace, scope).apply(file.model, spec)
    has_mass = [file.link_spans[link.name] for link in model.links if link.inertial or link.density is not None]
    _tell(found, values, has_mass)
    return RobotScene(name, located.resolve(), spec, file, model, groups)


def _tell(found: Findings, values: Values, has_mass: Sequence[Span]) -> None:
    """Pass on what was found in a robot file, but not that a link has no inertial where the scenario gives it one."""
    for finding in found:
        if finding.code != "DB305" or finding.notes or finding.span not in has_mass:
            values.findings.append(finding)


def _locate(reference: str, path: NodePath, document: Document, values: Values) -> Path | None:
    span = values.span(path)
    if reference.startswith("package://"):
        found = meshes.in_package(reference)
        if found is not None:
            return found
        values.findings.add("DB204", span, f"`{reference}` does not exist", help="the package must be installed, and hold such a file")
        return None
    beside = files.resolve(reference, document.directory_of(span), document.roots)
    if isinstance(beside, Path):
        return beside
    by_name = shipped.robot_path(reference)
    if by_name is not None:
        return by_name
    notes = (f"shipped robots are {shown(shipped.robot_names())}",)
    library = meshes.library_reference(reference)
    fix = Fix.replacing(span, reference, library, safe=False) if library else None
    help = f"did you mean `{library}`?" if library else beside.help
    values.findings.add("DB204", span, beside.headline, help=help, notes=notes, fix=fix)
    return None


def _groups(model: RobotModel, spec: RobotSpec, path: NodePath, values: Values) -> dict[str, Group]:
    groups: dict[str, Group] = {}
    joints, links = [joint.name for joint in model.moving_joints], [link.name for link in model.links]
    for name, patterns in spec.groups.items():
        place = (*path, "groups", name)
        if name in joints or name in links:
            what = "joint" if name in joints else "link"
            values.findings.add("DB202", values.key_span(place), f"`{name}` is already a {what}", help="choose another name")
        as_joints, not_joints = expand(joints, patterns, groups)
        as_links, not_links = expand(links, patterns, groups)
        if not not_joints and len({joint_dimension(model.joint(joint)) for joint in as_joints}) > 1:
            values.findings.add("DB404", values.span(place), "turning and sliding joints in one group", help="make a group of each")
        elif not not_joints:
            groups[name] = (Kind.JOINTS, as_joints)
            continue
        elif not not_links:
            groups[name] = (Kind.LINKS, as_links)
            continue
        elif odd := [pattern for pattern in not_joints if pattern in not_links]:
            span = values.span((*place, patterns.index(odd[0])))
            unmatched(values, span, odd[0], "joint or link", list(dict.fromkeys([*joints, *links])))
        else:
            values.findings.add("DB203", values.span(place), "joints and links in one group", help="make a group of each")
        values.lose(name)
    return groups

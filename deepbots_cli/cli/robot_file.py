"""A robot file as tables: what `inspect` shows of a URDF, with or without a scenario around it."""

from __future__ import annotations

import json
from contextlib import closing
from pathlib import Path

from deepbots_cli.cli.anatomy import Sections
from deepbots_cli.cli.tables import Row
from deepbots_cli.diagnostics import Finding, Findings
from deepbots_cli.diagnostics.nearest import nearest
from deepbots_cli.diagnostics.render import render
from deepbots_cli.document import files, shipped
from deepbots_cli.errors import ScenarioError, UsageError
from deepbots_cli.footprint import bounds, resting
from deepbots_cli.frames import add
from deepbots_cli.program.world import RobotBody, WorldModel
from deepbots_cli.robots import meshes
from deepbots_cli.robots.model import Box, Capsule, Cylinder, Geometry, Joint, Link, Mesh, Pose, RobotModel, Sphere
from deepbots_cli.robots.reader import RobotFile, read


def named(reference: str) -> bool:
    """Whether this is a robot file, or a shipped robot's name that is no scenario's."""
    if reference.startswith("package://") or reference.lower().endswith((".urdf", ".xacro")):
        return True
    return shipped.robot_path(reference) is not None and shipped.scenario_path(reference) is None and not Path(reference).exists()


def opened(reference: str) -> tuple[RobotFile, list[Finding]]:
    """The robot, and what is odd in its file.

    Raises:
        UsageError: There is no such file.
        ScenarioError: It cannot be read as a robot; says why.
    """
    found = meshes.locate(reference, Path.cwd()) if reference.startswith("package://") else shipped.robot_path(reference) or Path(reference)
    if isinstance(found, meshes.Refusal) or not found.is_file():
        names = shipped.robot_names()
        near = meshes.library_reference(reference) or nearest(reference, names)
        hint = f" (did you mean {near}?)" if near else ""
        raise UsageError(f"there is no robot file {reference}{hint}; shipped robots are: {', '.join(names)}")
    findings = Findings()
    resolve_mesh = meshes.beside(found.absolute().parent, meshes.package_of(reference))
    file = read(found, files.display(found.resolve()), findings, resolve_mesh=resolve_mesh)
    if file is None or findings.errors:
        raise ScenarioError(list(findings))
    return file, list(findings)


def sections(file: RobotFile, findings: list[Finding]) -> Sections:
    """Tables of the whole, of links and joints, and of the findings; figures in SI units, the joints at 0."""
    model = file.model
    tables: dict[str, Row | list[Row]] = {
        "robot": _whole(file),
        "links": [_link(link, model) for link in model.links],
        "joints": [_joint(joint) for joint in model.joints],
        "findings": [{key: row[key] for key in ("code", "severity", "file", "line", "message") if key in row} for row in _listed(findings)],
    }
    return {name: rows for name, rows in tables.items() if rows}


def _whole(file: RobotFile) -> Row:
    model = file.model
    low, high = bounds(model)
    return {
        "name": model.name,
        "file": file.source.name,
        "digest": file.digest,
        "root": model.root,
        "links": len(model.links),
        "joints": len(model.joints),
        "joints_that_move": len(model.moving_joints),
        "mass_kg": sum(link.inertial.mass for link in model.links if link.inertial),
        "size_m": [round(b - a, 6) for a, b in zip(low, high, strict=True)],
        "root_above_ground_m": round(resting(model), 6) + 0.0,  # no -0
        "meshes": len(file.meshes),
    }


def _link(link: Link, model: RobotModel) -> Row:
    joint = next((joint for joint in model.joints if joint.child == link.name), None)
    return {
        "link": link.name,
        "joint": joint.name if joint else "",
        "mass_kg": link.inertial.mass if link.inertial else None,
        "collides_as": [_shape(part) for part in link.collisions],
        "seen_as": [_shape(part) for part in link.visuals],
        "friction": link.friction.lateral,
    }


def _shape(part: Geometry) -> str:
    match part.shape:
        case Box(size):
            return f"box {_figures(size)}"
        case Sphere(radius):
            return f"sphere r {radius:.4g}"
        case Cylinder(radius, length):
            return f"cylinder r {radius:.4g} l {length:.4g}"
        case Capsule(radius, length):
            return f"capsule r {radius:.4g} l {length:.4g}"
        case Mesh(path=path):
            return f"mesh {Path(path).name}"


def _joint(joint: Joint) -> Row:
    limit = joint.limit
    return {
        "joint": joint.name,
        "type": joint.type,
        "parent": joint.parent,
        "child": joint.child,
        "origin_m": _figures(joint.origin.xyz),
        "axis": _figures(joint.axis) if joint.moves else "",
        "unit": ("m" if joint.type == "prismatic" else "rad") if joint.moves else "",
        "lower": limit.lower,
        "upper": limit.upper,
        "max_velocity": limit.velocity,
        "max_effort": limit.effort,
        "damping": joint.damping or None,
        "friction": joint.friction or None,
        "follows": joint.mimic.joint if joint.mimic else "",
    }


def _figures(values: tuple[float, ...]) -> str:
    return " ".join(f"{value:.4g}" for value in values)


def _listed(findings: list[Finding]) -> list[dict[str, object]]:
    listed = json.loads(render(findings, "json"))
    return list(listed["findings"] if isinstance(listed, dict) else listed)


def photograph(model: RobotModel) -> bytes:
    """A PNG of the robot on a floor, its joints at 0."""
    from deepbots_cli import engines
    from deepbots_cli.cli.picture import png
    from deepbots_cli.runtime.view import around

    pose = Pose((0.0, 0.0, resting(model)))
    world = WorldModel(0.01, 1, robots=(RobotBody("robot", model, fixed_base=True, pose=pose),))
    low, high = bounds(model)
    view = around([(add(low, pose.xyz), add(high, pose.xyz))])
    with closing(engines.create("pybullet", world)) as engine:
        return png(engine.render(view))

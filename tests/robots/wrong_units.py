"""Robots whose numbers are in other units, made from right ones."""

from __future__ import annotations

from dataclasses import replace

from deepbots_cli.robots.model import (
    Box,
    Capsule,
    Cylinder,
    Geometry,
    Inertial,
    Joint,
    Link,
    Mesh,
    Pose,
    RobotModel,
    Shape,
    Sphere,
    Vector,
)


def with_lengths(model: RobotModel, factor: float) -> RobotModel:
    """The robot with all lengths of its shapes, joints and centers of mass times a factor."""

    def link(old: Link) -> Link:
        return replace(
            old,
            inertial=old.inertial and replace(old.inertial, origin=_pose(old.inertial.origin, factor)),
            visuals=tuple(_geometry(part, factor) for part in old.visuals),
            collisions=tuple(_geometry(part, factor) for part in old.collisions),
        )

    def joint(old: Joint) -> Joint:
        return replace(old, origin=_pose(old.origin, factor))

    return replace(model, links=tuple(map(link, model.links)), joints=tuple(map(joint, model.joints)))


def with_visuals(model: RobotModel, factor: float) -> RobotModel:
    """The robot with the lengths of its visuals times a factor."""
    links = tuple(
        replace(link, visuals=tuple(_geometry(part, factor) for part in link.visuals or link.collisions))
        for link in model.links
    )
    return replace(model, links=links)


def with_masses(model: RobotModel, mass: float, inertia: float) -> RobotModel:
    """The robot with all masses and inertias times factors."""
    links = tuple(
        replace(link, inertial=link.inertial and _inertial(link.inertial, mass, inertia))
        for link in model.links
    )
    return replace(model, links=links)


def with_identities(model: RobotModel) -> RobotModel:
    """The robot with an inertia of 1 of each link."""
    links = tuple(
        replace(link, inertial=Inertial(link.mass, link.inertial.origin, ixx=1.0, iyy=1.0, izz=1.0))
        if link.inertial
        else link
        for link in model.links
    )
    return replace(model, links=links)


def _inertial(old: Inertial, mass: float, inertia: float) -> Inertial:
    return Inertial(
        old.mass * mass,
        old.origin,
        *(inertia * moment for moment in (old.ixx, old.ixy, old.ixz, old.iyy, old.iyz, old.izz)),
    )


def _vector(old: Vector, factor: float) -> Vector:
    x, y, z = old
    return factor * x, factor * y, factor * z


def _pose(old: Pose, factor: float) -> Pose:
    return replace(old, xyz=_vector(old.xyz, factor))


def _geometry(old: Geometry, factor: float) -> Geometry:
    return replace(old, shape=_shape(old.shape, factor), origin=_pose(old.origin, factor))


def _shape(old: Shape, factor: float) -> Shape:
    match old:
        case Box(size):
            return Box(_vector(size, factor))
        case Sphere(radius):
            return Sphere(factor * radius)
        case Cylinder(radius, length):
            return Cylinder(factor * radius, factor * length)
        case Capsule(radius, length):
            return Capsule(factor * radius, factor * length)
        case Mesh(scale=scale):
            return replace(old, scale=_vector(scale, factor))

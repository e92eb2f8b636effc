"""Objects: their shapes, and what they are made of."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from deepbots_cli.compiler.colours import colour
from deepbots_cli.compiler.files import mesh
from deepbots_cli.compiler.namespace import Namespace
from deepbots_cli.compiler.scopes import ParameterScope
from deepbots_cli.compiler.variations import figure
from deepbots_cli.document.nodes import Path
from deepbots_cli.expressions.dimensions import LENGTH, MASS, NUMBER
from deepbots_cli.expressions.types import SPACE, Context
from deepbots_cli.program.world import Colour, ObjectBody, Variant
from deepbots_cli.robots.inertia import volume
from deepbots_cli.robots.model import Box, Capsule, Cylinder, Mesh, Shape, Sphere
from deepbots_cli.scenario import world as spec
from deepbots_cli.scenario.fields import COLOURS

_WATER = 1000.0  # kg/m^3, the default density of objects
_GREY: Colour = (*COLOURS["grey"], 1.0)
_OF_ALL = ("solid", "spinning_friction", "rolling_friction", "restitution")


class Bodies:
    """Makes the bodies of the objects; figures that are drawn become variations."""

    def __init__(self, namespace: Namespace) -> None:
        self._namespace = namespace
        self._values = namespace.values
        self._scope = ParameterScope(namespace, Context.FIXED)
        self._drawn = ParameterScope(namespace, Context.FIELD)

    def bodies(self, name: str, thing: spec.Placed) -> list[ObjectBody]:
        """The object, or every copy of a group; none after a finding about its shape."""
        path: Path = ("objects", name)
        group = self._namespace.groups.get(name)
        if isinstance(thing, spec.VariedObject):
            variants = tuple(self._variant(kind, given, thing, (*path, "one_of", kind)) for kind, given in thing.one_of.items())
            if None in variants or not variants:  # none is left where each of them has a finding
                return []
            forms = tuple(variant for variant in variants if variant is not None)
            return [self._body(copy, thing, forms[0].shape, path, forms) for copy in (group.copies if group else (name,))]
        shape = self.shape(thing, path)
        if shape is None:
            return []
        bodies = [self._body(copy, thing, shape, path) for copy in (group.copies if group else (name,))]
        return [replace(body, pooled=True) for body in bodies] if group else bodies

    def _body(self, name: str, thing: spec.Placed, shape: Shape, path: Path, variants: tuple[Variant, ...] = ()) -> ObjectBody:
        made_of, of = thing if isinstance(thing, spec.Material) else spec.Material(), (name, "")
        return ObjectBody(
            name,
            shape,
            mass=variants[0].mass if variants else self._mass((*path, "mass"), made_of, shape, of),
            colour=(None if variants else colour(self._namespace, (*path, "colour"), made_of.colour, of)) or _GREY,
            fixed=bool(made_of.fixed),
            solid=made_of.solid is not False,
            friction=1.0 if variants else self._number((*path, "friction"), made_of.friction, 1.0, "lateral_friction", of),
            spinning_friction=self._number((*path, "spinning_friction"), made_of.spinning_friction, 0.0, "spinning_friction", of),
            rolling_friction=self._number((*path, "rolling_friction"), made_of.rolling_friction, 0.0, "rolling_friction", of),
            restitution=self._number((*path, "restitution"), made_of.restitution, 0.0, "restitution", of),
            pooled=bool(variants),
            variants=variants,
        )

    def _variant(self, kind: str, given: spec.Shaped, thing: spec.VariedObject, path: Path) -> Variant | None:
        """A form that a body may take: what it does not say of itself, the object says for all; its figures are fixed."""
        for key in _OF_ALL:
            if getattr(given, key) is not None:
                help = f"give `{key}` for all variants, beside `one_of`"
                self._values.findings.add(
                    "DB108", self._values.key_span((*path, key)), f"`{key}` of one variant is not supported yet", help=help
                )
        shape = self.shape(given, path)
        if shape is None:
            return None
        (mass_at, mass), (friction_at, friction), (colour_at, paint), (_, fixed) = (
            _said(key, given, thing, path) for key in ("mass", "friction", "colour", "fixed")
        )
        weight = self._values.figure(mass_at, mass, MASS, self._drawn)
        grip = self._values.figure(friction_at, friction, NUMBER, self._drawn)
        return Variant(
            kind,
            shape,
            mass=self._usual_mass(shape, path, still=bool(fixed) or thing.solid is False) if mass is None else weight or 0.0,
            colour=colour(self._namespace, colour_at, paint) or _GREY,
            friction=1.0 if grip is None else grip,
            fixed=bool(fixed),
        )

    def shape(self, thing: object, path: Path) -> Shape | None:
        """The shape of an object or of a variant at `path`; None after a finding."""
        if isinstance(thing, spec.Box):
            size = self._values.numbers((*path, "size"), thing.size, LENGTH, SPACE, self._scope)
            return Box((size[0], size[1], size[2])) if size else None
        if isinstance(thing, spec.Sphere):
            radius = self._length((*path, "radius"), thing.radius)
            return Sphere(radius) if radius else None
        if isinstance(thing, (spec.Cylinder, spec.Capsule)):
            radius, height = self._length((*path, "radius"), thing.radius), self._length((*path, "height"), thing.height)
            kind = Cylinder if isinstance(thing, spec.Cylinder) else Capsule
            return kind(radius, height) if radius and height else None
        return mesh(self._namespace, path, thing.file, thing.scale) if isinstance(thing, spec.Mesh) else None

    def _mass(self, path: Path, made_of: spec.Material, shape: Shape, of: tuple[str, str]) -> float:
        """In kg."""
        still = bool(made_of.fixed) or made_of.solid is False
        if made_of.mass is not None:
            if still:  # there is nothing that a drawn mass would change
                return self._values.figure(path, made_of.mass, MASS, self._drawn) or 0.0
            return figure(self._namespace, path, made_of.mass, MASS, self._drawn, "mass", of) or 0.0
        return self._usual_mass(shape, path[:-1], still=still)

    def _usual_mass(self, shape: Shape, path: Path, *, still: bool) -> float:
        """That of as much water, in kg; a mesh that can move has to say its own."""
        if isinstance(shape, Mesh) and not still:
            help = "give its `mass`, or write `fixed: true`"
            self._values.findings.add("DB102", self._values.key_span(path), "a mesh that can move has no `mass`", help=help)
        return _WATER * (volume(shape) or 0.0)

    def _number(self, path: Path, given: object, default: float, what: str, of: tuple[str, str]) -> float:
        number = figure(self._namespace, path, given, NUMBER, self._drawn, what, of)
        return default if number is None else number

    def _length(self, path: Path, given: object) -> float | None:
        return self._values.number(path, given, LENGTH, self._scope)


def _said(key: str, given: spec.Shaped, thing: spec.VariedObject, path: Path) -> tuple[Path, Any]:
    """What a variant at `path` or, for all variants, the object says under `key`, and where."""
    own = getattr(given, key)
    return ((*path, key), own) if own is not None else ((*path[:2], key), getattr(thing, key))

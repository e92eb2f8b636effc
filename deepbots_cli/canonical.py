"""The compiled scenario as canonical JSON, and its digest.

Canonical means: keys sorted, no spaces, floats by their shortest exact form. Every record is an
object whose key `is` holds the class name, so that reading needs no look at the field types' order;
reading checks names and types and never constructs a class outside the table below.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import PurePath
from types import UnionType
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

from deepbots_cli import ir
from deepbots_cli.errors import DeepbotsError
from deepbots_cli.expressions import scalar
from deepbots_cli.ir.records import is_record_class, members, with_members
from deepbots_cli.robots import model

_CLASSES: dict[str, type] = {cls.__name__: cls for module in (model, scalar, ir) for cls in vars(module).values() if is_record_class(cls)}


class CanonicalError(DeepbotsError):
    """The text is no compiled scenario of this version."""


def to_json(scenario: ir.CompiledScenario) -> str:
    """Canonical JSON; equal scenarios give equal text."""
    return json.dumps(_plain(scenario), sort_keys=True, separators=(",", ":"), allow_nan=False)


def digest(scenario: ir.CompiledScenario) -> str:
    """SHA-256 of the canonical JSON, in hexadecimal; a file counts for what it holds, not for where it lies."""
    placeless = with_files(scenario, lambda file: replace(file, path=PurePath(file.path).suffix))
    return hashlib.sha256(to_json(placeless).encode()).hexdigest()


def task_digest(scenario: ir.CompiledScenario) -> str:
    """The digest of what makes an episode: the same for scenarios that differ in their names, training, evaluation or scripts alone."""
    nameless = replace(scenario, name="", summary="", scripts=())
    return digest(replace(nameless, training=None, curriculum=(), evaluation=ir.Evaluation(), cases=(), solved=None))


Filed = model.Mesh | ir.Picture
"""What has the path and the digest of a file."""


def with_files(scenario: ir.CompiledScenario, change: Callable[[Filed], Filed]) -> ir.CompiledScenario:
    """The scenario with each mesh and picture of its world changed."""
    world = _with_files(scenario.world, change)
    assert isinstance(world, ir.WorldModel)  # as it was
    if not (scenario.cases or scenario.curriculum):
        return replace(scenario, world=world)
    cases = tuple(replace(case, scenario=with_files(case.scenario, change)) for case in scenario.cases)
    curriculum = tuple(replace(stage, scenario=with_files(stage.scenario, change)) for stage in scenario.curriculum)
    return replace(scenario, world=world, cases=cases, curriculum=curriculum)


def _with_files(value: object, change: Callable[[Filed], Filed]) -> object:
    if isinstance(value, Filed):
        return change(value)
    inside = members(value)
    if inside is not None:
        return with_members(value, {name: _with_files(member, change) for name, member in inside.items()})
    return tuple(_with_files(item, change) for item in value) if isinstance(value, tuple) else value


def from_json(text: str) -> ir.CompiledScenario:
    """The inverse of `to_json`.

    Raises:
        CanonicalError: The text is not JSON, or not of the form of this version; says where.
    """
    try:
        data = json.loads(text, parse_constant=_refuse)
        version = data.get("version") if isinstance(data, dict) else None
        if version != ir.IR_VERSION:
            raise CanonicalError(
                f"compiled scenario has format {version!r}, this deepbots reads {ir.IR_VERSION}; compile the scenario again"
            )
        result = _build(data, ir.CompiledScenario, "scenario")
    except (ValueError, OverflowError, RecursionError) as error:  # no JSON, or a number of thousands of digits
        raise CanonicalError(f"not a compiled scenario: {error}") from None
    assert isinstance(result, ir.CompiledScenario)  # _build returns what its second argument says
    return result


def _refuse(word: str) -> float:
    raise ValueError(f"{word} is no JSON")  # Python's reader would take it


def _plain(value: object) -> object:
    inside = members(value)
    if inside is not None:
        return {"is": type(value).__name__, **{name: _plain(member) for name, member in inside.items()}}
    if isinstance(value, tuple):
        return [_plain(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return {"is": "float", "value": repr(value)}
    return value


@cache
def _hints(cls: type) -> dict[str, Any]:
    return get_type_hints(cls)


def _build(data: object, kind: Any, where: str) -> object:
    """A value of type `kind` out of JSON data."""
    origin = get_origin(kind)
    if origin in (Union, UnionType):
        return _build_union(data, get_args(kind), where)
    if origin is tuple:
        return _build_tuple(data, get_args(kind), where)
    if origin is Literal:
        if data in get_args(kind):
            return data
    elif is_record_class(kind):
        return _build_object(data, kind, where)
    elif kind is float:
        if isinstance(data, dict) and data.get("is") == "float" and data.get("value") in ("inf", "-inf"):
            return float(data["value"])
        if isinstance(data, (int, float)) and not isinstance(data, bool):
            return float(data)
    elif (kind is type(None) and data is None) or (isinstance(kind, type) and type(data) is kind):
        return data
    raise CanonicalError(f"{where}: {str(data)[:40]!r} does not fit")


def _build_object(data: object, kind: Any, where: str) -> object:
    if not isinstance(data, dict) or data.get("is") != kind.__name__:
        raise CanonicalError(f"{where}: expected an object of kind {kind.__name__}")
    hints = _hints(kind)
    if set(data) - {"is"} != set(hints):
        raise CanonicalError(f"{where}: the keys of {kind.__name__} do not fit")
    return kind(**{name: _build(data[name], hint, f"{where}.{name}") for name, hint in hints.items()})


def _build_tuple(data: object, items: tuple[Any, ...], where: str) -> object:
    if not isinstance(data, list):
        raise CanonicalError(f"{where}: expected a list")
    if len(items) == 2 and items[1] is Ellipsis:
        return tuple(_build(item, items[0], f"{where}[{i}]") for i, item in enumerate(data))
    if len(items) != len(data):
        raise CanonicalError(f"{where}: expected {len(items)} items, found {len(data)}")
    return tuple(_build(item, kind, f"{where}[{i}]") for i, (item, kind) in enumerate(zip(data, items, strict=True)))


def _build_union(data: object, kinds: tuple[Any, ...], where: str) -> object:
    if isinstance(data, dict) and data.get("is") != "float":
        for kind in kinds:
            if is_record_class(kind) and kind is _CLASSES.get(str(data.get("is"))):
                return _build(data, kind, where)
        raise CanonicalError(f"{where}: {str(data.get('is'))[:40]!r} is no kind that belongs here")
    for kind in kinds:  # exact types first, so that an int stays an int where both are allowed
        if not is_record_class(kind) and type(data) is kind:
            return data
    for kind in kinds:
        if kind in (float, type(None)) or get_origin(kind):
            try:
                return _build(data, kind, where)
            except CanonicalError:
                continue
    raise CanonicalError(f"{where}: {str(data)[:40]!r} does not fit")

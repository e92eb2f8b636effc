"""A program as canonical JSON, and its digest.

Canonical means: keys sorted, no spaces, floats by their shortest exact form. Every record is an object whose key `is` holds the
class name. Texts and places in files are left out: of an expression stand its name and its scalar trees. It is written and never read
back: what is loaded is a scenario, which is compiled.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass, replace
from pathlib import PurePath
from typing import Any

from deepbots_cli.expressions.scalar import Scalar
from deepbots_cli.program import Program
from deepbots_cli.program.task import Evaluation
from deepbots_cli.program.world import Picture, WorldModel
from deepbots_cli.robots.model import Mesh


def to_json(program: Program) -> str:
    """Canonical JSON; equal programs give equal text."""
    return json.dumps(_plain(program), sort_keys=True, separators=(",", ":"), allow_nan=False)


def digest(program: Program) -> str:
    """SHA-256 of the canonical JSON, in hexadecimal; a file counts for its content, not for its path."""
    placeless = with_files(program, lambda file: replace(file, path=PurePath(file.path).suffix))
    return hashlib.sha256(to_json(placeless).encode()).hexdigest()


def task_digest(program: Program) -> str:
    """The digest of what makes an episode: the same for scenarios that differ in their names, training, evaluation or scripts alone."""
    nameless = replace(program.with_policies(scripts=(), training=None), name="", summary="")
    return digest(replace(nameless, curriculum=(), evaluation=Evaluation(), cases=(), solved=None))


File = Mesh | Picture
"""What has the path and the digest of a file."""


def with_files(program: Program, change: Callable[[File], File]) -> Program:
    """The program with each mesh and picture of its world changed."""
    world = _with_files(program.world, change)
    assert isinstance(world, WorldModel)  # as it was
    if not (program.cases or program.curriculum):
        return replace(program, world=world)
    cases = tuple(replace(case, program=with_files(case.program, change)) for case in program.cases)
    curriculum = tuple(replace(stage, program=with_files(stage.program, change)) for stage in program.curriculum)
    return replace(program, world=world, cases=cases, curriculum=curriculum)


def _with_files(value: Any, change: Callable[[File], File]) -> Any:
    if isinstance(value, File):
        return change(value)
    if is_dataclass(value) and not isinstance(value, type):
        inside = {field.name: getattr(value, field.name) for field in fields(value)}
        changed = {name: _with_files(member, change) for name, member in inside.items()}
        return replace(value, **changed) if any(changed[name] is not inside[name] for name in inside) else value
    if isinstance(value, tuple) and not isinstance(value, Scalar):
        items = tuple(_with_files(item, change) for item in value)
        return items if any(new is not old for new, old in zip(items, value, strict=True)) else value
    return value


def members(part: object) -> dict[str, Any] | None:
    """The members of a record by name, as they count for the digest; None for what is no record."""
    if isinstance(part, Scalar):
        return part._asdict()
    if hasattr(part, "projection"):
        return part.projection()  # type: ignore[no-any-return]
    if is_dataclass(part) and not isinstance(part, type):
        return {field.name: getattr(part, field.name) for field in fields(part)}
    return None


def _plain(value: object) -> object:
    inside = members(value)
    if inside is not None:
        return {"is": type(value).__name__, **{name: _plain(member) for name, member in inside.items()}}
    if isinstance(value, tuple):
        return [_plain(item) for item in value]
    if isinstance(value, Mapping):
        return {name: _plain(item) for name, item in value.items()}
    if isinstance(value, float) and not math.isfinite(value):
        return {"is": "float", "value": repr(value)}
    return value
